"""ULog files, packed here message by message and read by pyulog."""

from __future__ import annotations

import gc
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.foreign.hostile import nested_ulog
from tests.foreign.ulog import START_US, Topics, message, topics_of, ulog_bytes
from tests.narrowing import not_none
from trimtab.host.base.bounds import ULOG_ALL_FIELDS, ULOG_DEPTH
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats import recognise, ulog
from trimtab.host.imports.formats.ulog import read

pytest.importorskip("pyulog", reason="pyulog is not installed; pip install -e '.[logs]'")

FLIGHTS = Path(__file__).parents[5] / "shared" / "data"


@pytest.fixture
def topics(made_up: Any) -> Topics:
    return topics_of(made_up)


def test_ulog_flight_is_read_at_the_rates_of_its_topics(tmp_path: Path, made_up: Any, topics: Any) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_bytes(topics, {}))
    assert recognise(path) == "ulog"
    found = read(path)
    np.testing.assert_array_equal(found.pose_us, np.round(1e6 * made_up.t[::4]))
    np.testing.assert_allclose(found.p_ned, made_up.p[::4], atol=1e-6)
    apart = Rotation.from_quat(found.q_ned_frd, scalar_first=True).inv() * made_up.turn[::4]
    assert apart.magnitude()[1:].max() < 4e-3  # between the attitudes beside it
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-5)
    np.testing.assert_allclose(not_none(found.specific_force), made_up.force, atol=1e-5)
    order = [
        ("front-right", "rear-right", "rear-left", "front-left").index(c)
        for c in not_none(found.motor_corners)
    ]
    np.testing.assert_allclose(not_none(found.motor_command), made_up.motor[:, order], atol=1e-6)
    held = ulog.contents(path)
    rates = {topic.name: topic.rate_hz for topic in held.topics}
    assert rates["vehicle_local_position"] == pytest.approx(25.0)
    assert rates["sensor_combined"] == pytest.approx(100.0)


def test_pulses_are_scaled_by_the_vehicles_own_range_and_motors_placed_by_its_parameters(
    tmp_path: Path, made_up: Any, topics: Any
) -> None:
    fields, t_us, commands = topics.pop("actuator_motors")
    fields = [field.replace("control", "output") for field in fields]
    topics["actuator_outputs"] = (fields, t_us, 1100.0 + 800.0 * commands)
    corners = {"front-right": (1, 1), "rear-right": (-1, 1), "rear-left": (-1, -1), "front-left": (1, -1)}
    order = ("rear-right", "front-right", "rear-left", "front-left")
    places = {
        f"CA_ROTOR{k}_P{axis}": float(corners[c][i])
        for k, c in enumerate(order)
        for i, axis in enumerate("XY")
    }
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_bytes(topics, {"PWM_MIN": 1100.0, "PWM_MAX": 1900.0, **places}))
    found = read(path)
    assert found.motor_corners == order
    np.testing.assert_allclose(not_none(found.motor_command), commands, atol=1e-6)


def test_motion_capture_is_preferred_to_the_estimator(tmp_path: Path, made_up: Any, topics: Any) -> None:
    t_us = START_US + np.round(1e6 * made_up.t).astype(int)
    q = made_up.turn.as_quat(scalar_first=True)
    fields = [*(f"position[{k}]" for k in range(3)), *(f"q[{k}]" for k in range(4))]
    topics["vehicle_mocap_odometry"] = (fields, t_us, np.column_stack([made_up.p + 1.0, q]))
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_bytes(topics, {}))
    np.testing.assert_allclose(read(path).p_ned, made_up.p + 1.0, atol=1e-6)


def test_topics_that_are_missing_are_named(tmp_path: Path, topics: Any) -> None:
    path = tmp_path / "flight.ulg"
    del topics["vehicle_local_position"]
    path.write_bytes(ulog_bytes(topics, {}))
    with pytest.raises(
        ImportFormatError, match=r"no topic vehicle_mocap_odometry or .*vehicle_local_position"
    ):
        read(path)
    assert {topic.name for topic in ulog.contents(path).topics} == set(topics)


def test_truncated_file_gives_what_is_whole(tmp_path: Path, topics: Any) -> None:
    whole = ulog_bytes(topics, {})
    path = tmp_path / "flight.ulg"
    path.write_bytes(whole[: len(whole) * 3 // 4])
    found = read(path)
    assert 0.6 * 13e6 < found.pose_us[-1] < 0.9 * 13e6


def test_damaged_file_is_told_without_the_librarys_own_words_and_closed(
    tmp_path: Path, topics: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = ulog_bytes(topics, {})
    path = tmp_path / "flight.ulg"
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        path.write_bytes(whole[:12])
        with pytest.raises(ImportFormatError, match=r"flight\.ulg: not a whole ULog"):
            read(path)
        at = whole.index(b"A\0\x03\0actuator_motors") + 4
        path.write_bytes(whole[:at] + b"X" + whole[at + 1 :])  # no format of this name
        assert any("damaged" in note for note in ulog.contents(path).notes)
        gc.collect()
    assert warned == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "definition",
    [b"uint64_t timestamq;", b"double timestamp;", b"float[2] timestamp;", b"uint8_t[8] timestamp;"],
)
def test_topic_whose_definition_has_no_times_is_left_out(
    tmp_path: Path, topics: Any, definition: bytes
) -> None:
    whole = ulog_bytes(topics, {})
    old = message("F", b"battery_status:uint64_t timestamp;float voltage_v;")
    new = message("F", b"battery_status:" + definition + b"float voltage_v;")
    assert whole.count(old) == 1
    path = tmp_path / "flight.ulg"
    path.write_bytes(whole.replace(old, new))
    assert "battery_status" not in {topic.name for topic in ulog.contents(path).topics}


@pytest.mark.parametrize(
    ("kind", "value"),
    [(b"char[4]", b"1\0\0\0"), (b"uint9_t", b"\0\0\0\0"), (b"float", b"\0\0\xc0\x7f")],
)
def test_parameter_that_is_no_finite_number_is_as_if_missing(
    tmp_path: Path, topics: Any, kind: bytes, value: bytes
) -> None:
    places = {"PX": (1.0, -1.0, -1.0, 1.0), "PY": (1.0, 1.0, -1.0, -1.0)}
    parameters = {f"CA_ROTOR{k}_{axis}": at[k] for axis, at in places.items() for k in range(4)}
    whole = ulog_bytes(topics, parameters)
    path = tmp_path / "flight.ulg"
    path.write_bytes(whole)
    assert read(path).motor_corners == ("front-right", "rear-right", "rear-left", "front-left")
    old = message("P", b"\x12float CA_ROTOR0_PX" + struct.pack("<f", 1.0))
    key = kind + b" CA_ROTOR0_PX"
    assert whole.count(old) == 1
    path.write_bytes(whole.replace(old, message("P", bytes([len(key)]) + key + value)))
    assert read(path).motor_corners == ulog.CORNERS


def test_file_that_ends_within_a_damaged_definition_is_not_read_for_ever(tmp_path: Path, topics: Any) -> None:
    whole = ulog_bytes(topics, {})
    at = whole.index(b"F", 60) - 2
    path = tmp_path / "flight.ulg"
    # pyulog goes back by the length of a damaged message, also if fewer bytes follow: here by two messages.
    end = 2 * message("\1", bytes(10)) + struct.pack("<HB", 31, 0) + bytes(4)
    path.write_bytes(whole[:at] + end)
    with pytest.raises(ImportFormatError, match=r"flight\.ulg: not a whole ULog"):
        read(path)


def test_start_beyond_the_range_of_times_is_refused(tmp_path: Path, topics: Any) -> None:
    whole = ulog_bytes(topics, {})
    path = tmp_path / "flight.ulg"
    path.write_bytes(whole[:8] + struct.pack("<Q", 1 << 63) + whole[16:])
    with pytest.raises(ImportFormatError, match="start is damaged"):
        read(path)


def test_recorded_ulog_of_others_tells_that_its_motors_never_ran(
    require: Callable[[str], None],
) -> None:
    require("flights")
    for name in ("sample.ulg", "sample_appended_multiple.ulg"):
        found = read(FLIGHTS / "px4" / name)
        assert not_none(found.motor_command).max() == 0.0


def test_definitions_of_too_many_values_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ulg"
    data = nested_ulog(1, 60_000)
    subscription = message("A", struct.pack("<BH", 0, 0) + b"f0")
    path.write_bytes(data + subscription * 3)
    with pytest.raises(ImportFormatError, match=rf"a\.ulg: {ULOG_ALL_FIELDS.what}"):
        ulog.contents(path)
    path.write_bytes(nested_ulog(17, 1))
    with pytest.raises(ImportFormatError, match=rf"a\.ulg: f17: {ULOG_DEPTH.what}"):
        ulog.contents(path)
