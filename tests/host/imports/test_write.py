"""Recordings become logs that read back as what was recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.imports import ImportFormatError, Recording
from trimtab.host.imports.formats.nanobench import CORNERS, read
from trimtab.host.imports.write import write
from trimtab.host.log import read_flight
from trimtab.host.vehicle import ConfigurationError, Vehicle, load_vehicle


@pytest.fixture(scope="session")
def nano() -> Vehicle:
    return load_vehicle("nano")


@pytest.fixture
def recording(nanobench_file: Callable[..., Path]) -> Recording:
    return read(nanobench_file())


def test_recording_reads_back_as_a_flight(tmp_path: Path, recording: Recording, nano: Vehicle) -> None:
    path = tmp_path / "f.mcap"
    counts, _ = write(recording, nano, path, format="nanobench", provenance={"source_id": "abc"})
    flight = read_flight(path)
    assert flight.kind == "imported"
    assert flight.vehicle == nano
    assert flight.metadata["source_format"] == "nanobench"
    assert flight.metadata["source_file"] == "flight.csv"
    assert flight.metadata["source_id"] == "abc"
    assert flight.metadata["epoch_us"] == str(recording.epoch_us)
    assert flight.metadata["unknown"].split() == list(recording.unknown)
    assert flight.mocap is not None
    np.testing.assert_array_equal(flight.mocap.p, recording.p_ned)
    np.testing.assert_array_equal(flight.mocap.q, recording.q_ned_frd)
    inputs, imu = flight.recorded_inputs, flight.recorded_imu
    assert inputs is not None
    assert imu is not None
    assert inputs.level == "motor"
    np.testing.assert_array_equal(inputs.motor, recording.motor_command)  # the nano keeps the same order
    np.testing.assert_array_equal(imu.gyro, recording.gyro)
    np.testing.assert_array_equal(imu.specific_force, recording.specific_force)
    assert flight.battery is not None
    np.testing.assert_array_equal(flight.battery.battery_v, recording.battery_v)
    assert counts["/recorded/inputs"] == len(inputs)
    assert flight.tracking is not None
    assert flight.tracking_whole
    begin, end = flight.tracking
    inside = (flight.mocap.t_us >= begin) & (flight.mocap.t_us <= end)
    assert flight.mocap.p[inside, 2].max() < -0.15


def test_same_recording_gives_the_same_bytes(tmp_path: Path, recording: Recording, nano: Vehicle) -> None:
    for name in ("a.mcap", "b.mcap"):
        write(recording, nano, tmp_path / name, format="nanobench")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_motors_are_matched_to_rotors_by_corner(tmp_path: Path, recording: Recording) -> None:
    research = load_vehicle("research")  # 1 front right, 2 rear left, 3 front left, 4 rear right
    write(recording, research, tmp_path / "f.mcap", format="nanobench")
    inputs = read_flight(tmp_path / "f.mcap").recorded_inputs
    assert inputs is not None
    assert inputs.motor is not None
    assert recording.motor_command is not None
    for rotor, motor in zip(research.rotors, inputs.motor.T, strict=True):
        x, y, _ = rotor.position_m
        corner = f"{'front' if x > 0 else 'rear'}-{'right' if y > 0 else 'left'}"
        np.testing.assert_array_equal(motor, recording.motor_command[:, CORNERS.index(corner)])


def test_vehicle_without_a_rotor_at_each_corner_is_refused(
    tmp_path: Path, recording: Recording, nano: Vehicle
) -> None:
    size = 0.04
    places = ((size, 0.0, 0.0), (0.0, size, 0.0), (-size, 0.0, 0.0), (0.0, -size, 0.0))
    plus = nano.replace(
        rotors=tuple(
            {"position_m": place, "spin": rotor.spin}
            for rotor, place in zip(nano.rotors, places, strict=True)
        )
    )
    with pytest.raises(ConfigurationError, match=r"its rotors are not at the corners.*--vehicle"):
        write(recording, plus, tmp_path / "f.mcap", format="nanobench")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flight.csv"]


def test_declared_mass_becomes_the_vehicles(tmp_path: Path, recording: Recording, nano: Vehicle) -> None:
    write(replace(recording, mass_kg=0.0345), nano, tmp_path / "f.mcap", format="nanobench")
    flown = read_flight(tmp_path / "f.mcap").vehicle
    assert flown.mass_kg == 0.0345
    assert flown.tolerances["mass.factor"] == 0.005  # better known than the file's, and still not weighed
    assert flown.id != nano.id
    with pytest.raises(ConfigurationError, match=r"flight.csv declares 3 kg: nano: cannot hover"):
        write(replace(recording, mass_kg=3.0), nano, tmp_path / "g.mcap", format="nanobench")


def test_thrust_without_torque_is_kept_at_its_level(
    tmp_path: Path, recording: Recording, nano: Vehicle
) -> None:
    assert recording.motor_command is not None
    thrust = 0.3 * recording.motor_command[:, 0]
    changed = replace(recording, motor_command=None, motor_corners=None, thrust_n=thrust)
    write(changed, nano, tmp_path / "f.mcap", format="csv")
    inputs = read_flight(tmp_path / "f.mcap").recorded_inputs
    assert inputs is not None
    assert inputs.level == "thrust-torque"
    np.testing.assert_array_equal(inputs.thrust_n, thrust)
    assert not np.any(inputs.torque_n_m)


def test_reference_alone_is_the_lowest_level(tmp_path: Path, recording: Recording, nano: Vehicle) -> None:
    fields: dict[str, Any] = dict.fromkeys(("input_us", "motor_command", "motor_corners"))
    changed = replace(
        recording,
        **fields,
        reference_us=recording.pose_us,
        p_ref_ned=recording.p_ned,
        v_ref_ned=recording.gyro,
    )
    write(changed, nano, tmp_path / "f.mcap", format="csv")
    inputs = read_flight(tmp_path / "f.mcap").recorded_inputs
    assert inputs is not None
    assert inputs.level == "reference"
    np.testing.assert_array_equal(inputs.p_ref, recording.p_ned)
    assert inputs.a_ref is None


def test_recording_without_any_input_has_none(tmp_path: Path, recording: Recording, nano: Vehicle) -> None:
    changed = replace(recording, input_us=None, motor_command=None, motor_corners=None)
    write(changed, nano, tmp_path / "f.mcap", format="csv")
    assert read_flight(tmp_path / "f.mcap").recorded_inputs is None


def test_recording_that_contradicts_itself_leaves_nothing(
    tmp_path: Path, recording: Recording, nano: Vehicle
) -> None:
    assert recording.specific_force is not None
    with pytest.raises(ImportFormatError, match="accelerometer"):
        write(
            replace(recording, specific_force=-recording.specific_force),
            nano,
            tmp_path / "f.mcap",
            format="nanobench",
        )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flight.csv"]


def test_both_flights_of_a_recording_are_tracked_and_the_ground_is_not(tmp_path: Path, nano: Vehicle) -> None:
    t_us = np.arange(0, 12_000_000, 10_000, dtype=np.int64)
    height = np.interp(
        t_us * 1e-6, [0.0, 0.5, 1.0, 4.5, 5.0, 6.0, 6.5, 11.0, 11.5], [0, 0, 1, 1, 0, 0, 1, 1, 0]
    )
    recording = Recording(
        source="two",
        pose_us=t_us,
        p_ned=np.column_stack([np.zeros((len(t_us), 2)), -height]),
        q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1)),
        unknown=(),
    )
    write(recording, nano, tmp_path / "f.mcap", format="csv")
    flight = read_flight(tmp_path / "f.mcap")
    inside = [(t_us >= a) & (t_us <= b) for a, b in flight.tracking_parts]
    assert len(inside) == 2
    assert all(height[part].min() > 0.5 for part in inside)
    assert all(part.sum() > 250 for part in inside)
