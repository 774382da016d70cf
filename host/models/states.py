"""A flight on a regular grid: smoothed states, rotor thrusts and controller memory over its tracking phase.

Position and velocity come from the camera alone, attitude from gyro and camera together, body rate from the
gyro. Nothing here knows an effect; a camera that is late makes states that are late.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from firmware_model.law import step as law_step
from firmware_model.law.allocation import command_to_thrust
from host.log import Control, Estimate, Flight, Observer
from host.models.bias import accelerometer_bias, standing_errors
from host.models.phi import INTEGRAL, Phi, flight_constants
from host.models.reference import block
from host.models.smoothing import Series, Smoothed, smooth
from host.vehicle import Vehicle, to_parameters
from protocol.blobs import FeedForward, Reference
from protocol.parameters import DEFAULTS

STEP_S = 0.02
PLAUSIBLE_VOLTAGE = (0.5, 1.3)
"""Of the full voltage: what lies outside is no measurement."""
_JERK_DENSITY = 20.0
"""(m/s^3)^2/Hz: follows flights of some 20 m/s^3; 1 mm at 100 Hz becomes 0.3 mm and 7 mm/s."""
_DRIFT_DENSITY = 0.1
"""rad^2/s^5, of the turn between gyro and camera: gyro bias and little else."""
_RATE_SIGMA = 0.01
"""rad/s: a gyro of 0.02 averaged over 10 ms and more, and what averaging over a step costs."""
_LEAST_SIGMA = (2e-4, 3e-3, 1e-3)
"""m, m/s, rad: no smoother is better than its model of the motion."""


class TooLittleData(ValueError):
    """A log lacks what its flight is rebuilt from, or the logs are too little to judge; the message says
    what.
    """

    exit_code = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class States:
    """A flight's tracking phase at t_s (n,), seconds since the reference's start, every `step_s`.

    x (n, 12): p, v (NED), Theta, body rate (FRD); sigma (12,) of each. thrust (n, 4): lagged nominal rotor
    thrusts, N. integral (n, 3): the law's. voltage_ratio (n,). constants (16,): `flight_constants`.
    observer (n, 3): the disturbance observed on board, m/s^2, NED; None where none was logged.
    """

    flight_id: str
    reference_id: str
    vehicle: Vehicle
    reference: Reference
    feedforward: FeedForward | None
    parameters: Mapping[str, float] | None
    step_s: float
    t_s: np.ndarray
    x: np.ndarray
    sigma: np.ndarray
    thrust: np.ndarray
    integral: np.ndarray
    voltage_ratio: np.ndarray
    constants: np.ndarray
    observer: np.ndarray | None = None

    def initial(self, phi: Phi, k: int = 0) -> np.ndarray:
        """phi's state (size,) at sample k; the estimator's errors are what the accelerometer's bias makes."""
        x = np.zeros(phi.size)
        x[0:12], x[12:16] = self.x[k], self.thrust[k]
        if phi.drive != "inputs":
            x[INTEGRAL] = self.integral[k]
            if phi.rate_filter:
                x[INTEGRAL.stop : INTEGRAL.stop + 3] = self.x[k, 9:12]
            if phi.errors.stop <= phi.size:
                R = Rotation.from_euler("ZYX", self.x[k, 8:5:-1]).as_matrix()
                gains = law_step.estimator_gains(phi.firmware)
                excess = R @ self.constants[7:10]
                for i, per_bias in enumerate(standing_errors(gains, *self.constants[4:6])):
                    x[phi.errors.start + 3 * i : phi.errors.start + 3 * i + 3] = per_bias * excess
            if phi.observes:
                d_hat = np.zeros(3) if self.observer is None else self.observer[k]
                x[phi.observer] = [*d_hat, self.constants[0] * self.thrust[k].sum()]
            if phi.commands.stop > phi.commands.start:
                x[phi.commands] = self.thrust[k]
        x[phi.memory] = phi.at_rest(x)
        return x


def flight_states(
    flights: Sequence[Flight], *, step_s: float = STEP_S, latency_s: float = 0.0
) -> list[States]:
    """The states of the flights' tracking phases; poses are taken to be `latency_s` older than stamped.

    Together they cost less than one by one. Raises TooLittleData where a log has no poses, no telemetry of
    the control law, no reference or no tracking phase.
    """
    measured = [_measured(flight, step_s, latency_s) for flight in flights]
    if not measured:
        return []
    smoothed = smooth([each for m in measured for each in (m.path, m.turned)])
    pairs = zip(smoothed[0::2], smoothed[1::2], strict=True)
    return [_states(m, path, turned, step_s) for m, (path, turned) in zip(measured, pairs, strict=True)]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Measured:
    """What of a flight is smoothed: `path`, positions; `turned`, the camera's turn from `gyro` and `base`.

    start_s of the tracking phase, which the grid begins at; interval_s between poses. base: the first of
    those turns; gyro: the gyro's attitudes on the grid.
    """

    flight: Flight
    start_s: float
    interval_s: float
    path: Series
    turned: Series
    base: Any
    gyro: Any


def _measured(flight: Flight, step_s: float, latency_s: float) -> _Measured:
    """What of a flight is smoothed. Raises TooLittleData."""
    needed = {
        "poses": flight.mocap,
        "control telemetry": flight.control,
        "on-board estimates": flight.estimate,
        "reference": flight.reference,
        "tracking phase": flight.tracking,
    }
    missing = [name for name, value in needed.items() if value is None]
    if missing:
        raise TooLittleData(
            f"{flight.path.name}: no {', no '.join(missing)}; use a flight tracked to its end"
        )
    mocap, control, tracking = flight.mocap, flight.control, flight.tracking
    assert mocap is not None
    assert control is not None
    assert tracking is not None
    start_s, end_s = (t * 1e-6 for t in tracking)
    steps = int((end_s - start_s) / step_s + 1e-6)
    at = start_s + step_s * np.arange(steps + 1)
    taken_s = mocap.t_us * 1e-6 - latency_s
    inside = (taken_s > start_s - 1.0) & (taken_s < end_s + 1.0)
    if steps < 25 or inside.sum() < 50:
        raise TooLittleData(f"{flight.path.name}: less than half a second of tracking with poses")
    pose_s, p = taken_s[inside], mocap.p[inside]
    path = Series(t_s=pose_s, samples=p, sigma=_noise(p), at_s=at, jerk_density=_JERK_DENSITY)
    turned, base, gyro = _attitude(pose_s, mocap.q[inside], control, at)
    return _Measured(
        flight=flight,
        start_s=start_s,
        interval_s=float(np.median(np.diff(pose_s))),
        path=path,
        turned=turned,
        base=base,
        gyro=gyro,
    )


def _states(measured: _Measured, path: Smoothed, turned: Smoothed, step_s: float) -> States:
    """The states of a flight from what was measured and that smoothed."""
    flight, start_s, at = measured.flight, measured.start_s, measured.path.at_s
    control, estimate = flight.control, flight.estimate
    reference, tracking = flight.reference, flight.tracking
    assert control is not None
    assert estimate is not None
    assert reference is not None
    assert tracking is not None
    theta = (Rotation.from_rotvec(turned.p) * measured.base * measured.gyro).as_euler("ZYX")[:, ::-1].copy()
    theta[:, 2] = np.unwrap(theta[:, 2])
    sigma_theta = float(np.median(turned.sigma_p))
    rate = _gyro(control, estimate, at, step_s)
    least_p, least_v, least_theta = _LEAST_SIGMA
    sigma = np.repeat(
        [
            max(float(np.median(path.sigma_p)), least_p),
            max(float(np.median(path.sigma_v)), least_v),
            max(sigma_theta, least_theta),
            _RATE_SIGMA,
        ],
        3,
    )
    # A tick's errors are integrated over the tick after it: in the mean, what is logged is half a tick ahead.
    integral_s = control.sensed_us[:, 1] * 1e-6
    integral = np.column_stack([np.interp(at, integral_s, control.rate_integral[:, i]) for i in range(3)])
    tracked = (estimate.t_us >= tracking[0]) & (estimate.t_us <= tracking[1])
    # The telemetry's age grows from a pose's use to the next one's; at its use it is half an interval less.
    age_s = (
        float(np.mean(estimate.mocap_age_s[tracked])) - 0.5 * measured.interval_s if tracked.any() else 0.0
    )
    gains = law_step.estimator_gains(law_step.parameter_vector(_parameters(flight)))
    estimated = np.column_stack([np.interp(at, estimate.t_us * 1e-6, estimate.p[:, i]) for i in range(3)])
    R = Rotation.from_euler("ZYX", theta[:, ::-1]).as_matrix()
    imu_bias, per_gravity = accelerometer_bias(
        estimated - path.p,
        R,
        path.v,
        np.gradient(path.v, step_s, axis=0),
        rate,
        gains=gains,
        age_s=max(age_s, 0.0),
        interval_s=measured.interval_s,
        step_s=step_s,
    )
    return States(
        flight_id=flight.id,
        reference_id=flight.reference_id or reference.id,
        vehicle=flight.vehicle,
        reference=reference,
        feedforward=flight.feedforward,
        parameters=flight.firmware_parameters,
        step_s=step_s,
        t_s=at - start_s,
        x=np.column_stack([path.p, path.v, theta, rate]),
        sigma=sigma,
        thrust=_thrusts(flight.vehicle, control, at),
        integral=integral,
        voltage_ratio=np.interp(at, *battery_of(flight)),
        constants=flight_constants(
            block(flight.feedforward),
            mocap_age_s=max(age_s, 0.0),
            mocap_interval_s=measured.interval_s,
            accelerometer_bias=imu_bias,
            bias_per_gravity=per_gravity,
        ),
        observer=_observed(flight.observer, at),
    )


def _observed(observer: Observer | None, at: np.ndarray) -> np.ndarray | None:
    """The disturbance observed (n, 3) at times (n,) s, None where none was logged."""
    if observer is None:
        return None
    t_s = observer.t_us * 1e-6
    return np.column_stack([np.interp(at, t_s, observer.disturbance[:, i]) for i in range(3)])


def _parameters(flight: Flight) -> Mapping[str, float]:
    table = flight.firmware_parameters
    return to_parameters(flight.vehicle) if table is None else {**DEFAULTS, **table}


def _noise(samples: np.ndarray) -> float:
    """Sigma of white noise, from third differences: motion hardly enters them."""
    third = np.diff(samples, 3, axis=0)
    return max(float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)), 1e-5)


def _attitude(pose_s: np.ndarray, q: np.ndarray, control: Control, at: np.ndarray) -> tuple[Series, Any, Any]:
    """What attitude comes from: the turn from gyro to camera, which the gyro's drift makes, beyond the first;
    that first turn; and the gyro's attitudes at times `at`.
    """
    length = 1e-6 * (control.t1_us - control.t0_us)
    gap = np.diff(control.t1_us * 1e-6, prepend=control.t0_us[0] * 1e-6)
    covered = np.where(np.abs(gap - length) < 1e-4, length, gap)  # an invalid interval: the next one's mean
    turns = Rotation.from_rotvec(control.gyro_mean * covered[:, None])
    knots_s = _knots_s(control)
    gyro = _cumulated(turns)
    camera = Rotation.from_quat(q[:, [1, 2, 3, 0]])
    drift = camera * _between(knots_s, gyro, turns, pose_s).inv()
    base = drift[0]
    offset = (drift * base.inv()).as_rotvec()
    series = Series(t_s=pose_s, samples=offset, sigma=_noise(offset), at_s=at, jerk_density=_DRIFT_DENSITY)
    return series, base, _between(knots_s, gyro, turns, at)


def _cumulated(turns: Any) -> Any:
    """Products of the first 0, 1, .. n of n turns; in twice the reach at every pass."""
    products = Rotation.concatenate([Rotation.identity(), turns])
    reach = 1
    while reach < len(products):
        products = Rotation.concatenate([products[:reach], products[:-reach] * products[reach:]])
        reach *= 2
    return products


def _knots_s(control: Control) -> np.ndarray:
    """(n + 1,) s: begin of what the first gyro mean stands for, then the end of each."""
    sensed_us = control.sensed_us
    return np.concatenate([sensed_us[:1, 0], sensed_us[:, 1]]) * 1e-6


def _between(knots_s: np.ndarray, gyro: Any, turns: Any, at: np.ndarray) -> Any:
    """The gyro's attitude at times `at`, at a constant rate between knots."""
    k = np.clip(np.searchsorted(knots_s, at, side="right") - 1, 0, len(knots_s) - 2)
    share = np.clip((at - knots_s[k]) / np.maximum(knots_s[k + 1] - knots_s[k], 1e-9), 0.0, 1.0)
    return gyro[k] * Rotation.from_rotvec(turns[k].as_rotvec() * share[:, None])


def _gyro(control: Control, estimate: Estimate, at: np.ndarray, step_s: float) -> np.ndarray:
    """Body rate (n, 3): the gyro's mean over the step around each time, less the bias estimated on board."""
    edges = _knots_s(control)
    turned = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(control.gyro_mean * np.diff(edges)[:, None], axis=0)]
    )
    half = 0.5 * step_s
    rate = np.column_stack(
        [
            (np.interp(at + half, edges, turned[:, i]) - np.interp(at - half, edges, turned[:, i])) / step_s
            for i in range(3)
        ]
    )
    bias = np.column_stack([np.interp(at, estimate.t_us * 1e-6, estimate.gyro_bias[:, i]) for i in range(3)])
    return rate - bias


def _thrusts(vehicle: Vehicle, control: Control, at: np.ndarray) -> np.ndarray:
    """Nominal rotor thrusts (n, 4), N: what was commanded, behind the vehicle file's lag."""
    commanded = command_to_thrust(control.motor_mean, vehicle.thrust_max_n, *vehicle.thrust_curve)
    edges = np.concatenate([control.t0_us[:1], control.t1_us]) * 1e-6
    stay = np.exp(-np.diff(edges) / vehicle.motor_lag_s)
    thrust = np.empty((len(edges), 4))
    thrust[0] = commanded[0]
    for k, share in enumerate(stay):
        thrust[k + 1] = commanded[k] + share * (thrust[k] - commanded[k])
    return np.column_stack([np.interp(at, edges, thrust[:, i]) for i in range(4)])


def battery_of(flight: Flight) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) s and battery voltage over full voltage (n,); what no battery of this vehicle can show is
    left out. One pair of 0 s and 1 where nothing was logged.
    """
    if flight.battery is not None:
        ratio = flight.battery.battery_v / flight.vehicle.battery.full_v
        measured = (ratio > PLAUSIBLE_VOLTAGE[0]) & (ratio < PLAUSIBLE_VOLTAGE[1])
        if measured.any():
            return flight.battery.t_us[measured] * 1e-6, ratio[measured]
    return np.zeros(1), np.ones(1)
