"""Measurements and inputs of a flight on one clock, and their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.effects import Effect
from trimtab.host.effects.effect import Signal
from trimtab.host.effects.unknowns import TORQUE, undetermined
from trimtab.host.log import Flight
from trimtab.host.models.states import States, battery_of, flight_states
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.sentences import no_tracking, too_few_poses, too_few_tracking_poses
from trimtab.host.vehicle import Vehicle
from trimtab.host.vehicle.allocation import allocation_inverse


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Measurements and inputs of one flight on one clock, in seconds since arming.

    Attributes
    ----------
    pose_s, p_ned, R_ned_frd
        Times, positions in m and attitudes of the poses.
    input_s, command
        Begin and end of each command interval, and the commands in it.
    in_newton
        Whether commands are rotor thrusts in N, not motor commands.
    imu_s, rate_frd, force_frd
        Begin and end of each IMU interval, and the mean body rate in rad/s and specific force in m/s^2 in it.
        Quantities that were not logged are empty.
    voltage_s, voltage_ratio
        Times, and battery voltage over full voltage.
    span_s
        Begin and end of the tracking phase.
    rebuilt_sd
        Standard deviation, rad, of the part of the attitude that an import rebuilt; 0 if all was measured.
    """

    pose_s: Annotated[np.ndarray, "poses"]
    p_ned: Annotated[np.ndarray, "poses 3"]
    R_ned_frd: Annotated[np.ndarray, "poses 3 3"]
    input_s: Annotated[np.ndarray, "inputs 2"]
    command: Annotated[np.ndarray, "inputs 4"]
    in_newton: bool
    imu_s: Annotated[np.ndarray, "intervals 2"]
    rate_frd: Annotated[np.ndarray, "_ 3"]
    force_frd: Annotated[np.ndarray, "_ 3"]
    voltage_s: Annotated[np.ndarray, "voltages"]
    voltage_ratio: Annotated[np.ndarray, "voltages"]
    span_s: tuple[float, float]
    rebuilt_sd: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightData:
    """A flight with its signals and its states, which are computed once for a trace.

    states: smoothed states by the latency of the poses in s, filled by `states_of`.
    """

    flight: Flight
    signals: Signals
    states: dict[float, States] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, flight: Flight) -> FlightData:
        """Return the data of `flight`; raises LogsRefused as `signals` does."""
        return cls(flight=flight, signals=signals(flight))


def states_of(flights: Sequence[FlightData], latency_s: float) -> list[States]:
    """Return the states of the flights, with poses `latency_s` older than stamped.

    Raises TooLittleData if a log lacks a required topic.
    """
    fresh = [data for data in flights if latency_s not in data.states]
    for data, states in zip(
        fresh, flight_states([each.flight for each in fresh], latency_s=latency_s), strict=True
    ):
        data.states[latency_s] = states
    return [data.states[latency_s] for data in flights]


def signals(flight: Flight) -> Signals:
    """Return the signals of a flight.

    If no inputs were recorded, the commands are constant at hover thrust, and the process disturbance absorbs
    the error. If the torque is unknown and no gyro was logged, the body rate comes from the attitudes of the
    poses. Raises LogsRefused if the log has too few poses or no tracking phase.
    """
    if flight.mocap is None or len(flight.mocap) < RULES.min_poses:
        raise LogsRefused(Code.TOO_FEW_POSES, too_few_poses(flight.path))
    vehicle = flight.vehicle
    pose_s = flight.mocap.t_us * 1e-6
    R = Rotation.from_quat(flight.mocap.q[:, [1, 2, 3, 0]]).as_matrix()
    if flight.control is not None:
        c = flight.control
        input_s = np.column_stack([c.t0_us, c.t1_us]) * 1e-6
        command, in_newton = c.motor_mean, False
        imu_s, gyro, force = c.sensed_us * 1e-6, c.gyro_mean, c.force_mean
    elif flight.recorded_inputs is not None and flight.recorded_inputs.level != "reference":
        r = flight.recorded_inputs
        input_s = _intervals(r.t_us)
        imu_s, gyro, force = _recorded_imu(flight)
        if r.motor is not None:
            command, in_newton = r.motor, False
        else:
            assert r.thrust_n is not None
            assert r.torque_n_m is not None
            command, in_newton = _rotor_thrusts(vehicle, r.thrust_n, r.torque_n_m), True
    else:
        # No input, or only a reference without the control law: the poses show only lateral forces.
        hover_n = vehicle.mass_kg * GRAVITY / 4.0
        input_s, command, in_newton = pose_s[[0, -1]][None, :], np.full((1, 4), hover_n), True
        imu_s, gyro, force = _recorded_imu(flight)
    if TORQUE in unknowns([flight]) and not len(gyro):
        imu_s, gyro = _rate_from_poses(pose_s, R)
    voltage_s, voltage_ratio = battery_of(flight)
    if flight.tracking is None:
        raise LogsRefused(Code.NO_TRACKING, no_tracking(flight.path))
    span_s = (flight.tracking[0] * 1e-6, flight.tracking[1] * 1e-6)
    if np.count_nonzero((pose_s >= span_s[0]) & (pose_s <= span_s[1])) < RULES.min_tracking_poses:
        raise LogsRefused(Code.TOO_FEW_POSES, too_few_tracking_poses(flight.path))
    return Signals(
        pose_s=pose_s,
        p_ned=flight.mocap.p,
        R_ned_frd=R,
        input_s=input_s,
        command=command,
        in_newton=in_newton,
        imu_s=imu_s,
        rate_frd=gyro,
        force_frd=force,
        voltage_s=voltage_s,
        voltage_ratio=voltage_ratio,
        span_s=span_s,
        rebuilt_sd=0.0 if flight.rebuilt is None else flight.rebuilt.sd_rad,
    )


def _rate_from_poses(pose_s: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the intervals (n - 1, 2) between poses, and the mean body rate (n - 1, 3), rad/s, in each."""
    attitude = Rotation.from_matrix(R)
    step = np.diff(pose_s)
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / step[:, None]
    return np.column_stack([pose_s[:-1], pose_s[1:]]), rate


def _recorded_imu(flight: Flight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return intervals (k, 2), body rate and specific force of an imported log; empty if not recorded."""
    imu, empty = flight.recorded_imu, np.zeros((0, 3))
    if imu is None:
        return np.zeros((0, 2)), empty, empty
    gyro = empty if imu.gyro is None else imu.gyro
    return _intervals(imu.t_us), gyro, empty if imu.specific_force is None else imu.specific_force


def _intervals(t_us: np.ndarray) -> np.ndarray:
    """Return begin and end (n, 2) in s of the interval from each sample to the next; t_us (n,)."""
    t = t_us * 1e-6
    return np.column_stack([t, np.append(t[1:], t[-1] + np.median(np.diff(t)))])


def _rotor_thrusts(vehicle: Vehicle, thrust_n: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Return the rotor thrusts (n, 4) in N of a collective thrust (n,) and a torque (n, 3), N m."""
    return np.column_stack([thrust_n, torque]) @ allocation_inverse(vehicle).T


def nominal_thrust(vehicle: Vehicle, command: np.ndarray, *, in_newton: bool) -> np.ndarray:
    """Return the rotor thrust in N of commands before the motor lag; commands in N stay as they are."""
    c1, c2 = vehicle.thrust_curve
    return command if in_newton else vehicle.thrust_max_n * command * (c1 + c2 * command)


def pose_interval_s(s: Signals) -> float:
    """Return the median interval between poses in s."""
    return float(np.median(np.diff(s.pose_s)))


def local_quadratics(
    s: Signals,
    t_s: Annotated[np.ndarray, "times"],
    low: Annotated[np.ndarray, "times"],
    high: Annotated[np.ndarray, "times"],
    half_s: float,
) -> Annotated[np.ndarray, "times 3 3"]:
    """Return position, velocity and half the acceleration at each time, NED, by quadratics through the poses.

    low, high: index of the first pose of the window around each time, and of the first pose after it. half_s:
    half the length of a window, the unit of time in which the normal equations are well conditioned.
    """
    near = low[:, None] + np.arange((high - low).max())
    inside = near < high[:, None]
    near = np.minimum(near, len(s.pose_s) - 1)
    x = (s.pose_s[near] - t_s[:, None]) / half_s
    powers = np.stack([np.ones_like(x), x, x * x], axis=2) * inside[:, :, None]
    normal = np.swapaxes(powers, 1, 2) @ powers + 1e-12 * np.eye(3)  # stamps of poses may be equal
    fit = np.linalg.solve(normal, np.swapaxes(powers, 1, 2) @ s.p_ned[near])
    return fit / half_s ** np.arange(3)[:, None]


def noise(s: Signals) -> Annotated[np.ndarray, "4"]:
    """Return the noise of position (m), attitude (rad), body rate (rad/s) and specific force (m/s^2).

    Standard deviations come from third differences of the signals, but are at least the floors of RULES. That
    of the attitude is at least the error of a part that was rebuilt, which is too smooth to show it.
    """
    inside = (s.pose_s >= s.span_s[0]) & (s.pose_s <= s.span_s[1])
    attitude = Rotation.from_matrix(s.R_ned_frd[inside])
    rotation = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    flying = (s.imu_s[:, 0] >= s.span_s[0]) & (s.imu_s[:, 1] <= s.span_s[1])
    spread = (
        _robust(np.diff(s.p_ned[inside], 3, axis=0)) / np.sqrt(20.0),
        _robust(np.diff(rotation, 2, axis=0)) / np.sqrt(20.0),
        *(
            _robust(np.diff(x[flying], 3, axis=0)) / np.sqrt(20.0) if len(x) > 20 else 0.0
            for x in (s.rate_frd, s.force_frd)
        ),
    )
    floor = (
        RULES.position_sigma_floor_m,
        max(RULES.attitude_sigma_floor_rad, s.rebuilt_sd),
        RULES.rate_sigma_floor_rad_s,
        RULES.force_sigma_floor_m_s2,
    )
    return np.maximum(spread, floor)


def _robust(x: np.ndarray) -> float:
    """Return the standard deviation of zero-mean values, estimated by the median absolute value."""
    return float(1.4826 * np.median(np.abs(x)))


def averaged(
    edges_s: Annotated[np.ndarray, "edges"],
    interval_s: Annotated[np.ndarray, "intervals 2"],
    value: Annotated[np.ndarray, "intervals columns"],
) -> tuple[Annotated[np.ndarray, "steps columns"], Annotated[np.ndarray, "steps"]]:
    """Return the means of interval data in the steps of a grid, and the covered share of each step.

    edges_s: edges of the steps. interval_s: begin and end of the intervals, in order. value: data of the
    intervals.
    """
    length = np.maximum(interval_s[:, 1] - interval_s[:, 0], 1e-9)
    knots = np.ravel(interval_s)
    order = np.argsort(knots, kind="stable")
    area = np.ravel(np.column_stack([np.zeros(len(length)), length]))
    covered = np.interp(edges_s, knots[order], np.cumsum(area)[order])
    share = np.clip(np.diff(covered) / np.diff(edges_s), 0.0, 1.0)
    out = np.empty((len(edges_s) - 1, value.shape[1]))
    for i in range(value.shape[1]):
        steps = np.ravel(np.column_stack([np.zeros(len(length)), length * value[:, i]]))
        total = np.interp(edges_s, knots[order], np.cumsum(steps)[order])
        out[:, i] = np.diff(total) / np.maximum(np.diff(covered), 1e-9)
    return out, share


def unknowns(flights: Sequence[Flight]) -> frozenset[str]:
    """Return what at least one of the logs declares unknown or does not determine by its recorded inputs."""
    declared = {word for flight in flights for word in flight.metadata.get("unknown", "").split()}
    return frozenset(declared).union(*(_undetermined(flight) for flight in flights))


def _undetermined(flight: Flight) -> frozenset[str]:
    """Return what the recorded inputs of a flight do not determine; control telemetry determines all."""
    if flight.control is not None:
        return frozenset()
    recorded = None if without_inputs(flight) else flight.recorded_inputs
    return undetermined(None if recorded is None else recorded.t_us, flight.vehicle.motor_lag_s)


def without_inputs(flight: Flight) -> bool:
    """Return whether the log holds neither control telemetry nor recorded motor commands or thrusts."""
    recorded = flight.recorded_inputs
    return flight.control is None and (recorded is None or recorded.level == "reference")


def departure(flight: Flight, signal: Signal) -> float:
    """Return the greatest deviation of a signal from its value at rest.

    At rest, battery voltage over full voltage is 1 and the body rate of the gyro is 0 rad/s. The deviation of
    a signal that was not logged is 0.
    """
    if signal == "voltage_ratio":
        return float(np.abs(battery_of(flight)[1] - 1.0).max())
    gyro = _recorded_imu(flight)[1] if flight.control is None else flight.control.gyro_mean
    return float(np.abs(gyro).max(initial=0.0))


def has_signals(effect: Effect, flights: Sequence[Flight]) -> bool:
    """Return whether the flights have the signals that the effect needs.

    Every one deviates enough from rest in one of the flights. Sampled commands lack most of their noise, so
    an effect that depends on it needs control telemetry, whose commands are means.
    """
    if effect.noise_dependent and all(flight.control is None for flight in flights):
        return False
    return all(
        any(departure(flight, signal) > bound for flight in flights)
        for signal, bound in effect.needs_signals.items()
    )
