"""DataFlash logs, packed here message by message and read by pymavlink."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.foreign.dataflash import HEAD, definitions, log_bytes, packed
from tests.narrowing import not_none
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats import dataflash, recognise
from trimtab.host.imports.formats.dataflash import read

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path, made_up: Any) -> Write:
    def make(**parameters: float) -> Path:
        path = tmp_path / "flight.bin"
        path.write_bytes(log_bytes(made_up, parameters))
        return path

    return make


def test_dataflash_flight_is_read_from_the_first_instances(write: Write, made_up: Any) -> None:
    path = write(FRAME_CLASS=1.0, FRAME_TYPE=1.0)
    assert recognise(path) == "dataflash"
    found = read(path)
    np.testing.assert_array_equal(found.pose_us, np.round(1e6 * made_up.t[::4]))
    np.testing.assert_allclose(found.p_ned, made_up.p[::4], atol=1e-6)
    apart = Rotation.from_quat(found.q_ned_frd, scalar_first=True).inv() * made_up.turn[::4]
    assert apart.magnitude().max() < 1e-6
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-5)
    np.testing.assert_allclose(not_none(found.specific_force), made_up.force, atol=1e-5)
    assert found.motor_corners == ("front-right", "rear-left", "front-left", "rear-right")
    np.testing.assert_allclose(not_none(found.motor_command), made_up.motor[:, [0, 2, 3, 1]], atol=6e-4)
    np.testing.assert_allclose(not_none(found.battery_v), made_up.volt[::4], rtol=1e-6)
    rates = {topic.name: topic.rate_hz for topic in dataflash.contents(path).topics}
    assert rates["IMU"] == pytest.approx(100.0)
    assert rates["XKF1"] == pytest.approx(25.0, rel=0.01)


def test_pulse_range_and_frame_of_the_vehicle_are_used(write: Write) -> None:
    found = read(write(FRAME_TYPE=14.0, MOT_PWM_MIN=1100.0, MOT_PWM_MAX=1900.0))
    plain = read(write())
    assert found.motor_corners == ("front-right", "rear-right", "rear-left", "front-left")
    expected = np.maximum((1000.0 * not_none(plain.motor_command) - 100.0) / 800.0, 0.0)
    np.testing.assert_allclose(not_none(found.motor_command), expected, atol=1e-9)


@pytest.mark.parametrize("parameters", [{"FRAME_CLASS": 2.0}, {"FRAME_TYPE": 0.0}])
def test_frame_that_is_no_quadrotor_in_x_is_refused(write: Write, parameters: dict[str, float]) -> None:
    with pytest.raises(ImportFormatError, match=r"flight\.bin: FRAME_CLASS .* FRAME_TYPE"):
        read(write(**parameters))


def test_log_without_positions_names_the_messages(tmp_path: Path, made_up: Any) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(definitions() + packed("ATT", 1, 0.0, 0.0, 0.0) + packed("ATT", 2, 0.0, 0.0, 0.0))
    with pytest.raises(ImportFormatError, match="no topic XKF1 or NKF1 or EKF1"):
        read(path)


def test_truncated_log_gives_what_is_whole(tmp_path: Path, write: Write) -> None:
    whole = write().read_bytes()
    path = tmp_path / "cut.bin"
    path.write_bytes(whole[: len(whole) * 3 // 4])
    assert 0.6 * 13e6 < read(path).pose_us[-1] < 0.9 * 13e6


def test_damaged_log_is_told_without_the_librarys_own_words(
    tmp_path: Path, write: Write, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = write().read_bytes()
    path = tmp_path / "hurt.bin"
    at = whole.index(HEAD + bytes([65])) + 200
    # A letter of a format that does not fit its length, and zeros between messages.
    data = whole.replace(b"QBffffff", b"QBfffffB", 1)
    path.write_bytes(data[:at] + bytes(300) + data[at:])
    assert "IMU" not in {topic.name for topic in dataflash.contents(path).topics}
    assert capfd.readouterr() == ("", "")


def test_frame_that_is_no_number_is_as_if_missing(write: Write) -> None:
    found = read(write(FRAME_CLASS=math.nan, FRAME_TYPE=math.inf))
    assert found.motor_corners == read(write()).motor_corners


def test_message_of_no_length_is_not_read_for_ever(tmp_path: Path, write: Write) -> None:
    path = tmp_path / "hurt.bin"
    whole = write().read_bytes()
    empty = struct.pack("<BB4s16s64s", 99, 0, b"NONE", b"", b"")
    path.write_bytes(definitions() + HEAD + bytes([0x80]) + empty + HEAD + bytes([99]) + whole)
    with pytest.raises(ImportFormatError, match=r"hurt\.bin: not a whole DataFlash log"):
        read(path)
