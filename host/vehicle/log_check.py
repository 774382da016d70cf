"""Check of a vehicle file against a flight log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.allocation import command_to_thrust
from trimtab.host.base.errors import UsageError
from trimtab.host.vehicle.check import AXES, RULES, Check, Figure, Rules, Verdict, decide
from trimtab.host.vehicle.fit import thrust_figures, torque_figures
from trimtab.host.vehicle.model import Vehicle
from trimtab.host.vehicle.motion import Motion, Tracks, motion

if TYPE_CHECKING:
    from trimtab.host.log import Flight


def check_flight(flight: Flight, vehicle: Vehicle | None = None, rules: Rules = RULES) -> Check:
    """Return how a vehicle file fits a flight; by default the file in its log.

    Of a log with several flights, the longest is checked.

    Raises UsageError if the log has less than two seconds in the air with inputs, rates and forces.
    """
    chosen = vehicle or flight.vehicle
    tracks = flight_tracks(flight)
    moved = None
    if tracks is not None and flight.tracking_parts:
        longest = max(flight.tracking_parts, key=lambda part: part[1] - part[0])
        moved = motion(tracks, chosen, longest)
    thrust = None if moved is None else thrust_figures(moved, chosen.mass_kg)
    torque = None if moved is None else torque_figures(moved, chosen)
    if tracks is None or moved is None or (thrust is None and torque is None):
        raise UsageError(
            f"{flight.path}: less than two seconds in the air with motor commands or thrust, and "
            "with poses or inertial measurements; check another log"
        )
    return decide(
        thrust,
        torque,
        chosen,
        limits=_limit_figures(flight, tracks, moved, chosen),
        logged=flight.vehicle,
        unknown=flight.metadata.get("unknown", "").split(),
        voltage=None if flight.battery is None else float(np.median(flight.battery.battery_v)),
        rules=rules,
    )


def flight_tracks(flight: Flight) -> Tracks | None:
    """Return the tracks of a flight for `fit`; None without motor commands or thrust."""
    control, recorded, imu, mocap = flight.control, flight.recorded_inputs, flight.recorded_imu, flight.mocap
    if control is not None and len(control) > 1:
        sensed_us = control.sensed_us.mean(axis=1)
        return Tracks(
            input_us=0.5 * (control.t0_us + control.t1_us),
            motor_command=control.motor_mean,
            rate_us=sensed_us,
            rate_frd=control.gyro_mean,
            force_us=sensed_us,
            specific_force_frd=control.force_mean,
        )
    if recorded is None or len(recorded) < 2 or recorded.level == "reference":
        return None
    has_torque = "torque" not in flight.metadata.get("unknown", "").split()
    return Tracks(
        input_us=recorded.t_us + 0.5 * float(np.median(np.diff(recorded.t_us))),
        motor_command=recorded.motor,
        thrust_n=recorded.thrust_n,
        torque_n_m=recorded.torque_n_m if has_torque else None,
        rate_us=None if imu is None or imu.gyro is None else imu.t_us,
        rate_frd=None if imu is None else imu.gyro,
        force_us=None if imu is None or imu.specific_force is None else imu.t_us,
        specific_force_frd=None if imu is None else imu.specific_force,
        pose_us=None if mocap is None else mocap.t_us,
        p_ned=None if mocap is None else mocap.p,
        q_ned_frd=None if mocap is None else mocap.q,
    )


def _limit_figures(flight: Flight, tracks: Tracks, moved: Motion, vehicle: Vehicle) -> list[Figure]:
    """Return the greatest thrust, speed, tilt and body rates of a flight against the file's limits."""
    limits = vehicle.limits
    inside = (tracks.input_us >= moved.t_us[0]) & (tracks.input_us <= moved.t_us[-1])
    if tracks.motor_command is not None:
        share = float(command_to_thrust(tracks.motor_command[inside].max(), 1.0, *vehicle.thrust_curve))
    else:
        assert tracks.thrust_n is not None
        share = float(tracks.thrust_n[inside].max()) / (4.0 * vehicle.thrust_max_n)
    thrust = _limit("thrust-share", share, limits.thrust_headroom[1])
    if share > 1.0 + 1e-3:  # more than the file says there is
        thrust = Figure(name="thrust-share", value=share, low=0.0, high=1.0, verdict=Verdict.DIFFERS)
    speed, tilt = _speed_and_tilt(flight)
    rates = np.abs(moved.rate_frd).max(axis=0)
    return [
        thrust,
        _limit("speed-m-s", speed, limits.speed_max_m_s),
        _limit("tilt-deg", tilt, limits.tilt_max_deg),
        *(
            _limit(f"rate-{axis}-rad-s", float(rate), limit)
            for axis, rate, limit in zip(AXES, rates, limits.body_rate_max_rad_s, strict=True)
        ),
    ]


def _limit(name: str, value: float | None, high: float) -> Figure:
    verdict = Verdict.UNKNOWN if value is None else Verdict.FITS if value <= high else Verdict.BEYOND
    return Figure(name=name, value=value, low=0.0, high=high, verdict=verdict)


def _speed_and_tilt(flight: Flight) -> tuple[float | None, float | None]:
    """Return greatest speed (m/s, over 0.2 s) and tilt (deg) of the tracking phase, from the poses."""
    mocap = flight.mocap
    if mocap is None or flight.tracking is None:
        return None, None
    inside = (mocap.t_us >= flight.tracking[0]) & (mocap.t_us <= flight.tracking[1])
    if inside.sum() < 2:
        return None, None
    t_us, p = mocap.t_us[inside], mocap.p[inside]
    at_us = np.arange(t_us[0], t_us[-1] - 200_000, 50_000)
    shifted = [np.column_stack([np.interp(at_us + d, t_us, p[:, k]) for k in range(3)]) for d in (0, 200_000)]
    moved = np.linalg.norm(shifted[1] - shifted[0], axis=1) / 0.2
    up = Rotation.from_quat(mocap.q[inside], scalar_first=True).as_matrix()[:, 2, 2]
    tilt = float(np.rad2deg(np.arccos(np.clip(up.min(), -1.0, 1.0))))
    return float(moved.max()) if len(moved) else None, tilt
