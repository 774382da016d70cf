"""Bags of setpoints, read by rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.host.export.test_tables import REFERENCE
from trimtab.host.base.errors import UsageError
from trimtab.host.export.ros2 import TOPICS, write_bag
from trimtab.host.export.samples import at_rate

pytest.importorskip("rosbags", reason="rosbags is not installed; pip install -e '.[logs]'")


def test_bag_holds_the_reference_in_enu(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    assert write_bag(REFERENCE, 20.0, tmp_path / "bag") == 22
    read: dict[str, list[Any]] = {}
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, t_ns, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == t_ns
            read.setdefault(connection.topic, []).append(message)
    assert {topic: len(messages) for topic, messages in read.items()} == dict.fromkeys(TOPICS, 22)
    held = at_rate(REFERENCE, 20.0)
    pose = [message.pose for message in read["/setpoint/pose"]]
    np.testing.assert_allclose([each.position.x for each in pose], held.p_ned[:, 1])
    np.testing.assert_allclose([each.position.y for each in pose], held.p_ned[:, 0])
    np.testing.assert_allclose([each.position.z for each in pose], -held.p_ned[:, 2])
    turn = [2.0 * np.arctan2(each.orientation.z, each.orientation.w) for each in pose]
    np.testing.assert_allclose(turn, 0.5 * np.pi - held.yaw)
    twist = [message.twist for message in read["/setpoint/velocity"]]
    np.testing.assert_allclose([each.linear.y for each in twist], held.v_ned[:, 0])
    np.testing.assert_allclose([each.angular.z for each in twist], -held.yaw_rate)
    accel = [message.accel.linear.y for message in read["/setpoint/acceleration"]]
    np.testing.assert_allclose(accel, held.a_ned[:, 0])


def test_bag_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rosbags.typesys.store import Typestore

    def interrupted(*_: object) -> bytes:
        raise KeyboardInterrupt

    with pytest.raises(UsageError, match="nowhere/bag: its folder does not exist"):
        write_bag(REFERENCE, 20.0, tmp_path / "nowhere" / "bag")
    monkeypatch.setattr(Typestore, "serialize_cdr", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bag(REFERENCE, 20.0, tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "bag").mkdir()
    with pytest.raises(UsageError, match="bag: exists; choose another name"):
        write_bag(REFERENCE, 20.0, tmp_path / "bag")


def test_bag_names_its_file_as_its_folder(tmp_path: Path) -> None:
    write_bag(REFERENCE, 20.0, tmp_path / "bag")
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag.mcap", "metadata.yaml"]
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
