"""Bags that rosbags wrote: ROS 1, ROS 2 with SQLite and MCAP."""

from __future__ import annotations

import dataclasses
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.foreign.bag import write_bag
from tests.foreign.flight import in_axes
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.contents import topic
from trimtab.host.imports.formats.rosbag import contents, read

pytest.importorskip("rosbags", reason="rosbags is not installed; pip install -e '.[logs]'")


@pytest.fixture
def file_of(tmp_path: Path, made_up: Any) -> Any:
    """Writes a bag of a kind and returns its file."""

    def write(kind: str) -> Path:
        target = tmp_path / ("a.bag" if kind == "ros1" else kind)
        write_bag(in_axes(made_up.cut(slice(400, 500, 10)), "nwu", "flu"), target, kind)
        return target if kind == "ros1" else next(p for p in target.iterdir() if p.suffix != ".yaml")

    return write


@pytest.mark.parametrize("count", [0, 3])
def test_bag_without_four_motor_commands_is_read_without_them_and_says_so(
    tmp_path: Path, made_up: Any, count: int
) -> None:
    flight = in_axes(made_up.cut(slice(400, 500)), "nwu", "flu")
    flight = dataclasses.replace(flight, motor=flight.motor[:, :count])
    write_bag(flight, tmp_path / "a.bag", "ros1")
    recording = read(tmp_path / "a.bag")
    assert recording.motor_command is None
    assert recording.input_us is None
    (note,) = contents(tmp_path / "a.bag").notes
    assert f"/cf0/motors: {count} motor commands" in note


def test_bag_without_a_known_topic_says_which_to_record(tmp_path: Path) -> None:
    from rosbags import rosbag1, typesys

    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    text = "std_msgs/msg/String"
    with rosbag1.Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/said", text, typestore=store)
        for k in range(3):
            writer.write(connection, k, store.serialize_ros1(store.types[text](data="x"), text))
    with pytest.raises(ImportFormatError, match="no topic with poses"):
        read(tmp_path / "a.bag")


@pytest.mark.parametrize(
    ("kind", "repair"),
    [("ros1", "rosbag reindex"), ("mcap", "mcap recover"), ("sqlite3", "ros2 bag reindex")],
)
def test_truncated_bag_names_the_command_that_repairs_it(file_of: Any, kind: str, repair: str) -> None:
    path: Path = file_of(kind)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    for act in (read, contents):
        with pytest.raises(
            ImportFormatError, match=rf"{path.name}: not a whole bag .*; repair it with {repair}$"
        ):
            act(path)


def test_topic_whose_name_is_no_text_is_damage(file_of: Any) -> None:
    path: Path = file_of("sqlite3")
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE topics SET name = x'00' WHERE name = '/cf0/imu'")
    with pytest.raises(ImportFormatError, match="not a whole bag"):
        contents(path)


@pytest.mark.parametrize(("count", "rate_hz"), [(0, 0.0), (1, 0.0), (5, 2.0)])
def test_topic_without_messages_has_no_rate(count: int, rate_hz: float) -> None:
    assert topic("/imu", count, 2.0).rate_hz == rate_hz
