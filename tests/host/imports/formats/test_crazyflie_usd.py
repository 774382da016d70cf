"""uSD logs of both versions: values, frames, and every way of being cut or damaged."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.narrowing import not_none
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats.crazyflie_usd import POSITION, UNKNOWN, read
from trimtab.host.imports.formats.usd_events import decode

SMALL = (("a", "h"), ("b", "f"))


@pytest.mark.parametrize("version", [1, 2])
def test_usd_flight_is_told_in_ned_and_frd(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any, version: int
) -> None:
    path = tmp_path / "log07"
    path.write_bytes(foreign.usd_flight(made_up, version=version))
    found = read(path)
    np.testing.assert_array_equal(found.input_us, np.round(1e6 * made_up.t))
    assert found.epoch_us == 4_321_000
    new = np.searchsorted(not_none(found.input_us), found.pose_us)
    np.testing.assert_allclose(found.p_ned, made_up.p[new], atol=0.6e-3)  # whole millimetres
    apart = Rotation.from_quat(found.q_ned_frd, scalar_first=True).inv() * made_up.turn[new]
    assert apart.magnitude().max() < 1e-6
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-6)
    np.testing.assert_allclose(not_none(found.thrust_n), made_up.thrust, atol=1e-6)
    k = np.arange(len(made_up.t))
    np.testing.assert_array_equal(found.torque_n_m, np.column_stack([k, -2 * k, -3 * k]))
    np.testing.assert_allclose(not_none(found.p_ref_ned), made_up.p, atol=0.6e-3)
    np.testing.assert_allclose(not_none(found.v_ref_ned), np.tile([1e-3, -2e-3, -3e-3], (len(k), 1)))
    assert found.specific_force is None
    assert found.motor_command is None
    assert found.unknown == UNKNOWN
    assert found.mass_kg is None


def test_usd_pose_that_the_filter_held_is_dropped_and_inputs_stay(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any
) -> None:
    rows = foreign.usd_rows(made_up)
    poses = (0, 1, 2, 9, 10, 11)
    for k in range(1, len(rows)):
        if k % 3:
            for i in poses:
                rows[k][i] = rows[k - k % 3][i]
    records = [(7, 10_000 * k, row) for k, row in enumerate(rows)]
    path = tmp_path / "log07"
    path.write_bytes(foreign.usd_bytes([(7, "fixed", foreign.USD_VARIABLES)], records, version=2))
    found = read(path)
    assert len(not_none(found.input_us)) == len(rows)
    assert set(np.diff(found.pose_us)) <= {30_000 * n for n in range(1, 60)}
    assert len(found.pose_us) > len(rows) / 5


def test_usd_older_name_of_the_thrust_is_found(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any
) -> None:
    older = [("ctrlLee.thrustSi" if n == "ctrlLee.thrustSI" else n, f) for n, f in foreign.USD_VARIABLES]
    path = tmp_path / "log07"
    path.write_bytes(foreign.usd_flight(made_up, version=1, variables=older))
    np.testing.assert_allclose(not_none(read(path).thrust_n), made_up.thrust, atol=1e-6)


def test_usd_without_variables_names_all_of_them(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any
) -> None:
    path = tmp_path / "log07"
    path.write_bytes(foreign.usd_bytes([(1, "few", SMALL)], [(1, k, (0, 0.0)) for k in range(9)], version=2))
    with pytest.raises(ImportFormatError) as caught:
        read(path)
    assert all(name in str(caught.value) for source in POSITION for name in source.variables)


@pytest.mark.parametrize("version", [1, 2])
def test_usd_cut_after_any_byte_is_one_clear_line(foreign: SimpleNamespace, version: int) -> None:
    records = [(3, 10 * k, (k, 0.5 * k)) for k in range(5)]
    whole = foreign.usd_bytes([(3, "fixedFrequency", SMALL)], records, version=version)
    (event,) = decode(whole, "log07")
    assert event.columns["a"].tolist() == [0, 1, 2, 3, 4]
    assert event.columns["b"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    for length in range(len(whole)):
        with pytest.raises(ImportFormatError) as caught:
            decode(whole[:length], "log07")
        assert str(caught.value).startswith("log07: ")
        assert "\n" not in str(caught.value)
        # Cut, with a check sum that fits what is left: the length must tell. A cut between records may pass.
        try:
            (part,) = decode(foreign.with_sum(whole[: max(1, length - 4)]), "log07")
        except ImportFormatError as error:
            assert "\n" not in str(error)  # noqa: PT017 (either outcome is good)
        else:
            assert len(part.times) < 5


@pytest.mark.parametrize("version", [1, 2])
def test_usd_with_any_byte_changed_is_refused(foreign: SimpleNamespace, version: int) -> None:
    whole = foreign.usd_bytes([(3, "fixedFrequency", SMALL)], [(3, 10, (1, 2.0))] * 3, version=version)
    for at in range(len(whole)):
        with pytest.raises(ImportFormatError):
            decode(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :], "log07")


def test_usd_with_wrong_sum_says_so(foreign: SimpleNamespace) -> None:
    whole = foreign.usd_bytes([(3, "x", SMALL)], [(3, 10, (1, 2.0))] * 3, version=1)
    with pytest.raises(ImportFormatError, match=r"checksum is wrong.*copy it from the card again"):
        decode(whole[:-1] + bytes([whole[-1] ^ 1]), "log07")


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"", "does not begin with 0xBC"),
        (b"\xbb" + struct.pack("<HH", 1, 1), "does not begin with 0xBC"),
        (b"\xbc" + struct.pack("<HH", 3, 1), "format version 3 is not supported, only versions 1 and 2"),
        (b"\xbc" + struct.pack("<HH", 1, 0), "no event type"),
        (b"\xbc" + struct.pack("<HHH", 1, 1, 1) + b"name", "a text without an end"),
        (b"\xbc" + struct.pack("<HHH", 1, 1, 1) + b"n\xff\0" + struct.pack("<H", 0), "header or records"),
        (b"\xbc" + struct.pack("<HHH", 1, 1, 1) + b"n\0" + struct.pack("<H", 1) + b"a(z)\0", "'a(z)'"),
        (b"\xbc" + struct.pack("<HHH", 1, 1, 1) + b"n\0" + struct.pack("<H", 1) + b"a[f)\0", "'a[f)'"),
        (b"\xbc" + struct.pack("<HHH", 1, 1, 1) + b"n\0" + struct.pack("<H", 1) + b"a(ff)\0", "'a(ff)'"),
        (b"\xbc" + struct.pack("<HHH", 1, 1, 1) + b"n\0" + struct.pack("<H", 1) + b"\0", "format letter"),
        (
            b"\xbc" + struct.pack("<HHH", 1, 1, 1) + b"n\0" + struct.pack("<HHI", 0, 2, 0),
            "record of unknown type 2 at byte 11",
        ),
        (
            b"\xbc" + struct.pack("<HH", 1, 2) + 2 * (struct.pack("<H", 1) + b"n\0" + struct.pack("<H", 0)),
            "event type 1 is declared twice",
        ),
    ],
)
def test_usd_of_another_make_is_named(foreign: SimpleNamespace, body: bytes, said: str) -> None:
    with pytest.raises(ImportFormatError) as caught:
        decode(foreign.with_sum(body), "log07")
    assert said in str(caught.value)


@pytest.mark.parametrize("letter", list("bBhHiIqQefd"))
def test_usd_format_letter_keeps_its_value(foreign: SimpleNamespace, letter: str) -> None:
    log = foreign.usd_bytes([(3, "x", [("v", letter)])], [(3, 10, [5]), (3, 20, [7])], version=2)
    assert decode(log, "log07")[0].columns["v"].tolist() == [5.0, 7.0]


def test_usd_of_a_single_record_is_refused(tmp_path: Path, foreign: SimpleNamespace, made_up: Any) -> None:
    path = tmp_path / "log07"
    path.write_bytes(foreign.usd_flight(made_up.cut(slice(0, 1)), version=2))
    with pytest.raises(ImportFormatError, match="fewer than two records"):
        read(path)


@pytest.mark.parametrize("clock", [2**64 - 10, 2**63])
def test_usd_clock_at_the_end_of_its_range_is_refused_or_read(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any, clock: int
) -> None:
    row = foreign.usd_rows(made_up)[0]
    log = foreign.usd_bytes([(7, "x", foreign.USD_VARIABLES)], [(7, 0, row), (7, clock, row)], version=2)
    path = tmp_path / "log07"
    path.write_bytes(log)
    with pytest.raises(ImportFormatError, match="longer than a day"):
        read(path)


def test_usd_mass_comes_from_the_info_file_beside_the_log(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "info").mkdir()
    (tmp_path / "logs" / "log07").write_bytes(foreign.usd_flight(made_up, version=2))
    info = tmp_path / "info" / "info07.yaml"
    info.write_text("experiment: 7\nmass: 0.0345 # kg\n")
    monkeypatch.chdir(tmp_path / "logs")
    assert read(Path("log07")).mass_kg == 0.0345
    assert read(tmp_path / "logs" / "log07").mass_kg == 0.0345
    info.write_text("mass: heavy\n")
    with pytest.raises(ImportFormatError, match=r"info07.yaml: mass 'heavy' is not a number"):
        read(Path("log07"))
    info.write_text("mass: -1\n")
    with pytest.raises(ImportFormatError, match=r"mass -1.0 kg"):
        read(Path("log07"))
    info.write_text("experiment: 7\n")
    assert read(Path("log07")).mass_kg is None


def test_usd_log_of_another_controller_with_several_rates_is_read(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any
) -> None:
    f = foreign.in_axes(made_up, "nwu", "flu")
    q = f.turn.as_quat(scalar_first=True)
    slow = (("pm.vbat", "f"), ("locSrv.x", "f"))
    pose = tuple((f"stateEstimate.{name}", "f") for name in ("x", "y", "z", "qw", "qx", "qy", "qz"))
    fast = tuple((f"{name}", "f") for name in ("gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z"))
    motors = tuple((f"motor.m{k}", "H") for k in (1, 2, 3, 4))
    records: list[tuple[int, int, Any]] = []
    for k, t in enumerate(np.round(1e6 * f.t).astype(int).tolist()):
        row = [*np.degrees(f.gyro[k]), *(f.force[k] / foreign.G), *np.round(65535 * f.motor[k]).astype(int)]
        records.append((3, t + 700, row))
        if k % 2 == 0:
            records.append((2, t, [*f.p[k], *q[k]]))
        if k % 10 == 0:
            records.append((1, t + 200, [f.volt[k], 0.0]))
    path = tmp_path / "log00"
    events = [(1, "slow", slow), (2, "pose", pose), (3, "fast", (*fast, *motors))]
    path.write_bytes(foreign.usd_bytes(events, records, version=2))
    found = read(path)
    np.testing.assert_array_equal(found.pose_us, np.round(1e6 * made_up.t[::2]))
    np.testing.assert_array_equal(not_none(found.imu_us), np.round(1e6 * made_up.t) + 700)
    np.testing.assert_allclose(found.p_ned, made_up.p[::2], atol=1e-6)
    apart = Rotation.from_quat(found.q_ned_frd, scalar_first=True).inv() * made_up.turn[::2]
    assert apart.magnitude().max() < 1e-6
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-5)
    np.testing.assert_allclose(not_none(found.specific_force), made_up.force, atol=1e-5)
    np.testing.assert_allclose(not_none(found.motor_command), made_up.motor, atol=1e-5)
    assert found.motor_corners == ("front-right", "rear-right", "rear-left", "front-left")
    assert len(not_none(found.battery_us)) == len(made_up.t[::10])
    assert found.thrust_n is None


def _without_pitch(f: Any, foreign: SimpleNamespace, a_nwu: np.ndarray | None) -> bytes:
    """A log of a flight in NWU and FLU with roll and yaw, and with these accelerations, m/s^2, if any."""
    yaw, _, roll = np.degrees(f.turn.as_euler("ZYX")).T
    names = ["x", "y", "z", "roll", "yaw"] + ([] if a_nwu is None else ["ax", "ay", "az"])
    columns = np.column_stack([f.p, roll, yaw] + ([] if a_nwu is None else [a_nwu / foreign.G]))
    records = [(7, round(1e6 * t), row) for t, row in zip(f.t, columns.tolist(), strict=True)]
    return foreign.usd_bytes(
        [(7, "x", [(f"stateEstimate.{name}", "f") for name in names])], records, version=2
    )


@pytest.mark.parametrize("source", ["accelerations", "positions"])
def test_pitch_that_was_not_logged_is_rebuilt_with_the_error_that_roll_shows(
    tmp_path: Path, made_up: Any, foreign: SimpleNamespace, source: str
) -> None:
    f = foreign.in_axes(made_up, "nwu", "flu")
    a_nwu = f.turn.apply(f.force) - [0.0, 0.0, foreign.G]
    a_nwu += np.random.default_rng(4).normal(0.0, 0.3, a_nwu.shape)  # the rotors' vibration
    a_nwu[:, 0] += 0.3  # the accelerometer's bias
    path = tmp_path / "log07"
    path.write_bytes(_without_pitch(f, foreign, a_nwu if source == "accelerations" else None))
    found = read(path)
    rebuilt = not_none(found.rebuilt)
    assert (rebuilt.part, rebuilt.source) == ("pitch", source)
    turn = Rotation.from_quat(found.q_ned_frd, scalar_first=True)
    new = np.searchsorted(np.round(1e6 * f.t), found.pose_us)
    yaw, pitch, roll = turn.as_euler("ZYX").T
    logged_yaw, true_pitch, logged_roll = made_up.turn[new].as_euler("ZYX").T
    np.testing.assert_allclose(roll, logged_roll, atol=1e-5)
    np.testing.assert_allclose(yaw, logged_yaw, atol=1e-5)
    flying = (f.t[new] > 3.0) & (f.t[new] < 9.0)
    error = float(np.std((pitch - true_pitch)[flying]))
    assert np.std(true_pitch[flying]) > 0.05
    assert error < 0.2 * np.std(true_pitch[flying])
    assert 0.5 * error < rebuilt.sd_rad < 2.0 * error


def test_measured_pitch_is_not_rebuilt(tmp_path: Path, foreign: SimpleNamespace, made_up: Any) -> None:
    path = tmp_path / "log07"
    path.write_bytes(foreign.usd_flight(made_up, version=2))
    assert read(path).rebuilt is None
