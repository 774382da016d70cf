"""Foreign flights come in as the same kind of log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trimtab.host.log import (
    Battery,
    LogError,
    Mocap,
    Rebuilt,
    RecordedImu,
    RecordedInputs,
    read_flight,
    to_lines,
    write_imported,
)
from trimtab.host.vehicle import Vehicle

T_US = np.arange(0, 1_000_000, 10_000, dtype=np.int64)


def _mocap(t_us: np.ndarray = T_US) -> Mocap:
    p = np.stack([np.sin(t_us * 1e-6), np.cos(t_us * 1e-6), -np.ones(len(t_us))], axis=1)
    return Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1)))


def test_imported_flight_reads_back(tmp_path: Path, vehicle: Vehicle) -> None:
    path = tmp_path / "foreign.mcap"
    imu_us = np.arange(0, 1_000_000, 2_000, dtype=np.int64)
    motor = np.linspace(0.2, 0.8, 4 * len(T_US)).reshape(-1, 4)
    counts = write_imported(
        path,
        vehicle=vehicle,
        mocap=_mocap(),
        inputs=RecordedInputs(t_us=T_US + 3, level="motor", motor=motor),
        imu=RecordedImu(t_us=imu_us, gyro=np.ones((len(imu_us), 3)), specific_force=None),
        battery=Battery(t_us=T_US[::10], battery_v=np.full(10, 15.5)),
        tracking_us=(100_000, 900_000),
        session={"source": "bench"},
    )
    assert counts["/mocap/pose"] == 100
    flight = read_flight(path)
    assert flight.kind == "imported"
    assert flight.tracking == (100_000, 900_000)
    assert flight.metadata["source"] == "bench"
    assert flight.reference is None
    assert flight.estimate is None
    assert flight.control is None
    assert flight.mocap is not None
    np.testing.assert_array_equal(flight.mocap.t_us, T_US)
    np.testing.assert_array_equal(flight.mocap.p, _mocap().p)
    inputs = flight.recorded_inputs
    assert inputs is not None
    assert inputs.level == "motor"
    assert inputs.thrust_n is None
    np.testing.assert_array_equal(inputs.t_us, T_US + 3)
    np.testing.assert_array_equal(inputs.motor, motor)
    assert flight.recorded_imu is not None
    assert flight.recorded_imu.specific_force is None
    np.testing.assert_array_equal(flight.recorded_imu.t_us, imu_us)
    assert flight.battery is not None
    np.testing.assert_array_equal(flight.battery.battery_v, 15.5)
    assert read_flight(path).to_dict()["topics"]["/recorded/imu"]["messages"] == 500


@pytest.mark.parametrize("level", ["thrust-torque", "reference"])
def test_imported_lower_levels_read_back(tmp_path: Path, vehicle: Vehicle, level: str) -> None:
    three, one = np.ones((len(T_US), 3)), np.ones(len(T_US))
    write_imported(
        tmp_path / "x.mcap",
        vehicle=vehicle,
        mocap=_mocap(),
        inputs=RecordedInputs(t_us=T_US, level=level, thrust_n=one, torque_n_m=three, p_ref=three),
    )
    inputs = read_flight(tmp_path / "x.mcap").recorded_inputs
    assert inputs is not None
    assert inputs.level == level
    assert inputs.motor is None
    np.testing.assert_array_equal(inputs.thrust_n, one)
    np.testing.assert_array_equal(inputs.p_ref, three)


def test_imported_level_without_its_values_is_refused() -> None:
    with pytest.raises(ValueError, match="motor"):
        RecordedInputs(t_us=T_US, level="motor", thrust_n=np.ones(len(T_US)))


def test_imported_log_of_two_flights_leaves_the_ground_between_them_out(
    tmp_path: Path, vehicle: Vehicle
) -> None:
    path = tmp_path / "two.mcap"
    whole, ground = (100_000, 900_000), (300_000, 600_000)
    rebuilt = Rebuilt(part="pitch", source="positions", sd_rad=0.0123)
    write_imported(
        path,
        vehicle=vehicle,
        mocap=_mocap(),
        tracking_us=whole,
        unused_us=[ground],
        session=rebuilt.metadata(),
    )
    flight = read_flight(path)
    assert flight.tracking == whole
    assert flight.unused == (ground,)
    assert flight.tracking_parts == ((100_000, 300_000), (600_000, 900_000))
    assert flight.rebuilt == rebuilt
    lines = to_lines(flight.to_dict())
    assert "not used from 0.30 to 0.60 s" in lines
    assert "rebuilt by the import: pitch from positions, to 0.7 deg" in lines


def test_imported_log_of_one_measured_flight_leaves_nothing_out(tmp_path: Path, vehicle: Vehicle) -> None:
    write_imported(tmp_path / "x.mcap", vehicle=vehicle, mocap=_mocap())
    flight = read_flight(tmp_path / "x.mcap")
    assert flight.unused == ()
    assert flight.tracking_parts == (flight.tracking,)
    assert flight.rebuilt is None


@pytest.mark.parametrize("ground", [(50_000, 200_000), (800_000, 900_000), (400_000, 300_000)])
def test_imported_part_that_is_not_inside_the_tracking_phase_is_refused(
    tmp_path: Path, vehicle: Vehicle, ground: tuple[int, int]
) -> None:
    with pytest.raises(ValueError, match="are not parts, in order, of tracking from 100000 to 900000 us"):
        write_imported(
            tmp_path / "x.mcap",
            vehicle=vehicle,
            mocap=_mocap(),
            tracking_us=(100_000, 900_000),
            unused_us=[ground],
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("entry", [{"unused_us": "1 2 3"}, {"rebuilt": "pitch dreams 0.1"}, {"rebuilt": "x"}])
def test_imported_log_with_a_damaged_entry_is_refused(
    tmp_path: Path, vehicle: Vehicle, entry: dict[str, str]
) -> None:
    write_imported(tmp_path / "x.mcap", vehicle=vehicle, mocap=_mocap(), session=entry)
    with pytest.raises(LogError, match="damaged"):
        read_flight(tmp_path / "x.mcap")


def test_imported_sample_before_the_start_is_refused_and_nothing_written(
    tmp_path: Path, vehicle: Vehicle
) -> None:
    with pytest.raises(ValueError, match="before the start"):
        write_imported(tmp_path / "x.mcap", vehicle=vehicle, mocap=_mocap(T_US - 5), tracking_us=(0, 5))
    assert not list(tmp_path.iterdir())


def test_tracks_times_that_run_back_are_refused() -> None:
    with pytest.raises(ValueError, match="times decrease"):
        _mocap(T_US[::-1])
