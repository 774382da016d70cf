"""Segments from logs: averages over steps, logs of only poses, and logs with too little data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.host.log import Battery, Mocap, Rebuilt, RecordedInputs, read_flight, write_imported
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.signals import FlightData, averaged, noise, signals, unknowns
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")


def log(
    path: Path,
    *,
    seconds: float = 6.0,
    every_us: int = 10_000,
    holes: bool = False,
    inputs: RecordedInputs | None = None,
    battery: Battery | None = None,
    unknown: str = "",
) -> Path:
    """Write a log of a vehicle that yaws at 0.4 rad/s and swings north; `holes` removes most poses."""
    t_us = np.arange(0, round(seconds * 1e6), every_us)
    t_us = t_us[t_us % 500_000 < 150_000] if holes else t_us
    t = t_us * 1e-6
    p = np.column_stack([np.sin(t), np.zeros_like(t), np.full(len(t), -1.5)])
    q = Rotation.from_euler("z", 0.4 * t[:, None]).as_quat(scalar_first=True)
    write_imported(
        path,
        vehicle=VEHICLE,
        mocap=Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=q),
        inputs=inputs,
        battery=battery,
        session={"unknown": unknown},
    )
    return path


def test_averages_over_steps_hold_the_area_under_intervals() -> None:
    intervals = np.array([[0.0, 0.1], [0.1, 0.3], [0.5, 0.6]])
    values = np.array([[1.0], [3.0], [5.0]])
    means, share = averaged(np.array([0.0, 0.2, 0.4, 0.6]), intervals, values)
    np.testing.assert_allclose(means[:, 0], [2.0, 3.0, 5.0])
    np.testing.assert_allclose(share, [1.0, 0.5, 0.5])


def test_signals_of_poses_alone_take_hover_thrust_and_the_poses_body_rate(tmp_path: Path) -> None:
    flight = read_flight(log(tmp_path / "poses.mcap"))
    flight_signals = signals(flight)
    assert flight_signals.in_newton
    assert flight_signals.command.sum() == pytest.approx(VEHICLE.mass_kg * 9.81, rel=1e-3)
    np.testing.assert_allclose(
        flight_signals.rate_frd, np.tile([0.0, 0.0, 0.4], (len(flight_signals.rate_frd), 1)), atol=1e-6
    )
    assert {"thrust", "torque"} <= unknowns([flight])


def test_signals_of_a_reference_alone_are_those_of_poses_alone(tmp_path: Path) -> None:
    t_us = np.arange(0, 6_000_000, 10_000)
    reference = RecordedInputs(t_us=t_us, level="reference", p_ref=np.zeros((len(t_us), 3)))
    flight = read_flight(log(tmp_path / "reference.mcap", inputs=reference))
    assert "thrust" in unknowns([flight])
    data, (audit,) = segments_of([FlightData.of(flight)], rate_driven="torque" in unknowns([flight]))
    assert data.rate_driven
    assert Code.NO_INPUTS in {finding.code for finding in audit.findings}


def test_noise_of_a_rebuilt_attitude_is_at_least_its_error(tmp_path: Path) -> None:
    flight = read_flight(log(tmp_path / "poses.mcap"))
    rebuilt = replace(flight, rebuilt=Rebuilt(part="pitch", source="positions", sd_rad=0.02))
    measured, less = noise(signals(flight)), noise(signals(rebuilt))
    assert measured[1] < 0.01
    assert less[1] == 0.02
    np.testing.assert_array_equal(np.delete(less, 1), np.delete(measured, 1))


def test_segments_of_a_short_log_are_refused(tmp_path: Path) -> None:
    flight = read_flight(log(tmp_path / "short.mcap", seconds=2.0))
    with pytest.raises(LogsRefused, match=r"^short\.mcap: only \d usable segments") as refusal:
        segments_of([FlightData.of(flight)], rate_driven=True)
    assert refusal.value.details == {"code": Code.TOO_FEW_SEGMENTS}


def test_segments_leave_out_a_gap_with_a_finding(tmp_path: Path) -> None:
    t_us = np.arange(0, 8_000_000, 10_000)
    t_us = t_us[(t_us < 3_000_000) | (t_us > 4_000_000)]
    p = np.zeros((len(t_us), 3))
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1))
    path = tmp_path / "gap.mcap"
    write_imported(path, vehicle=VEHICLE, mocap=Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=q))
    _, (audit,) = segments_of([FlightData.of(read_flight(path))], rate_driven=True)
    assert audit.left_out >= 1
    assert audit.largest_gap_s == pytest.approx(1.01, abs=0.02)
    assert Code.SEGMENTS_LEFT_OUT in {finding.code for finding in audit.findings}


def test_segments_of_slow_poses_need_fewer_poses(tmp_path: Path) -> None:
    flight = read_flight(log(tmp_path / "slow.mcap", every_us=20_000))
    _, (audit,) = segments_of([FlightData.of(flight)], rate_driven=True)
    assert audit.segments >= 8
    assert audit.left_out == 0


def test_steps_between_slow_poses_hold_a_pose_of_their_time(tmp_path: Path) -> None:
    """The attitude turns the disturbance at every step, so it must not be that of another time."""
    flight = FlightData.of(read_flight(log(tmp_path / "slow.mcap", every_us=20_000)))
    data, _ = segments_of([flight], rate_driven=True)
    t_s = flight.signals.span_s[0] + data.start_s[:, None] + data.dt_s * np.arange(data.steps)
    assert (data.pose_weight == 0.0).mean() == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(data.p_ned[..., 0], np.sin(t_s + data.shift_s), atol=1e-4)
    yaw = np.arctan2(data.R_ned_frd[..., 3], data.R_ned_frd[..., 0])
    np.testing.assert_allclose(yaw, 0.4 * t_s, atol=0.4 * 0.011)


def test_refusal_of_too_few_segments_names_what_was_left_out(tmp_path: Path) -> None:
    flight = read_flight(log(tmp_path / "holes.mcap", holes=True))
    with pytest.raises(LogsRefused, match=r"holes\.mcap: \d+ segments with gaps"):
        segments_of([FlightData.of(flight)], rate_driven=True)


def test_a_dead_battery_reading_is_no_measurement(tmp_path: Path) -> None:
    t_us = np.arange(0, 6_000_000, 100_000)
    for volts, ratio in ((0.0, 1.0), (0.9 * VEHICLE.battery.full_v, 0.9)):
        battery = Battery(t_us=t_us, battery_v=np.full(len(t_us), volts))
        flight_signals = signals(read_flight(log(tmp_path / f"{volts:.0f}.mcap", battery=battery)))
        np.testing.assert_allclose(flight_signals.voltage_ratio, ratio)


def test_segment_without_a_gyro_starts_with_the_rate_of_the_poses(tmp_path: Path) -> None:
    t_us = np.arange(0, 6_000_000, 10_000)
    inputs = RecordedInputs(t_us=t_us, level="motor", motor=np.full((len(t_us), 4), 0.5))
    data, _ = segments_of(
        [FlightData.of(read_flight(log(tmp_path / "deaf.mcap", inputs=inputs)))],
        rate_driven=False,
    )
    assert not data.rate_driven
    np.testing.assert_allclose(data.x0[:, 9:], np.tile([0.0, 0.0, 0.4], (len(data.flight), 1)), atol=1e-6)
