"""Command-driven segments: roll-outs of the library form from free initial states, linearised by lanes.

A lane is one column of the Jacobian of one segment: the base roll-out, one initial-state direction, one
scaled parameter, one local nuisance or one disturbance bin. All lanes advance together as numpy arrays
(columns, segments) through the one source of the dynamics, `host.models.dynamics`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from firmware_model.law.constants import GRAVITY
from firmware_model.law.rotations import euler_to_matrix, mat_t_vec
from host.codegen.ops import NUMPY
from host.models import dynamics
from host.trace.evidence import Linearisation
from host.trace.parameters import Space
from host.vehicle import Vehicle

STATES = 12
LOCALS = 9
"""Nuisances of one flight: mounting tilt of the markers (3, rad); a constant angular acceleration (3,
rad/s^2) or, where the measured body rate drives the attitude, a constant gyro bias (3, rad/s); accelerometer
bias (3, m/s^2)."""

CHANNELS = 12
"""Residuals a step: position, attitude, body rate, specific force, three each."""

BIN_S = 0.1
_LANES = 2500
_X_STEP = np.full(STATES, 1e-6)
_LOCAL_STEP = np.full(LOCALS, 1e-5)
_BIN_STEP = np.full(6, 1e-5)
_Z_STEP = 1e-5
"""Steps of the difference quotients are small: attitude answers torque so strongly that columns of coarse
steps are no longer parallel where the effects are, and what should cancel looks like information."""


@dataclass(frozen=True, kw_only=True)
class Segments:
    """S segments of H steps with what was measured and commanded in them.

    flight (S,); start_s (S,) since arm; x0 (S, 12) p, v, Theta, rate; position (S, H, 3) NED; attitude (S,
    H, 9) R_ned_frd; shift_s (S, H) time of the pose after its grid point; pose_weight and rate_weight (S, H)
    0 or 1; rate and force (S, H, 3) FRD means over the step, force_weight (S, H); command (S, pre + H, 4)
    motor command, or rotor thrust in N where `in_newton`; voltage_ratio (S, H). sigma (S, 4): position m,
    attitude rad, body rate rad/s, specific force m/s^2. `rate_driven`: the measured body rate is an input
    instead of the commanded torque, for logs that declare the torque unknown. w (S, bins, 6): disturbance the
    roll-outs are linearised at, so that they stay near what was measured whatever the parameters lack.
    """

    dt_s: float
    flight: np.ndarray
    start_s: np.ndarray
    x0: np.ndarray
    position: np.ndarray
    attitude: np.ndarray
    shift_s: np.ndarray
    pose_weight: np.ndarray
    rate: np.ndarray
    rate_weight: np.ndarray
    force: np.ndarray
    force_weight: np.ndarray
    command: np.ndarray
    voltage_ratio: np.ndarray
    sigma: np.ndarray
    w: np.ndarray
    in_newton: bool
    rate_driven: bool

    def __post_init__(self) -> None:
        steps = self.position.shape[1]
        per_bin = BIN_S / self.dt_s
        if abs(per_bin - round(per_bin)) > 1e-9 or steps % round(per_bin):
            raise ValueError(f"{steps} steps of {self.dt_s} s do not fill whole bins of {BIN_S} s")
        if self.command.shape[1] <= steps:
            raise ValueError("the command must begin before the segment: the rotors' lag needs a run-up")

    @property
    def steps(self) -> int:
        """Steps H of a segment."""
        return self.position.shape[1]

    @property
    def bins(self) -> int:
        """Disturbance bins of a segment."""
        return round(self.steps * self.dt_s / BIN_S)

    def with_x0(self, x0: np.ndarray) -> Segments:
        """The same segments starting from other initial states (S, 12)."""
        return replace(self, x0=x0)

    def with_w(self, w: np.ndarray) -> Segments:
        """The same segments linearised at another disturbance (S, bins, 6)."""
        return replace(self, w=w)

    def take(self, index: Any) -> Segments:
        """The segments at `index` (slice, mask or integers)."""
        shared = ("dt_s", "in_newton", "rate_driven")
        return replace(self, **{k: v[index] for k, v in vars(self).items() if k not in shared})


class Airframe:
    """A vehicle as the dynamics read it, with the adjustments of a lane in place of the file's constants."""

    def __init__(self, vehicle: Vehicle, theta: dict[str, tuple[Any, ...]]) -> None:
        logs = theta["inertia"]
        self.inertia_kg_m2 = tuple(
            j * np.exp(log) for j, log in zip(vehicle.inertia_kg_m2, logs, strict=True)
        )
        self.motor_lag_s = vehicle.motor_lag_s + theta.get("motor-lag-unknown", (0.0,))[0]
        self.mass_kg = vehicle.mass_kg
        self.rotors = vehicle.rotors
        self.thrust_max_n = vehicle.thrust_max_n
        self.thrust_curve = vehicle.thrust_curve
        self.torque_per_thrust_m = vehicle.torque_per_thrust_m
        log_gain, linear = theta.get("thrust-curve", (0.0, 0.0))
        self._gain = vehicle.thrust_max_n * np.exp(log_gain)
        self._linear = vehicle.thrust_curve[0] + linear
        self._scale = np.exp(log_gain)

    def commanded_thrust(self, command: np.ndarray, in_newton: bool) -> Any:
        """Rotor thrust in N that a command asks for, before the lag."""
        if in_newton:
            return self._scale * command
        return self._gain * command * (self._linear + (1.0 - self._linear) * command)


def roll_out(
    vehicle: Vehicle,
    space: Space,
    data: Segments,
    x0: np.ndarray,
    z: np.ndarray,
    local: np.ndarray,
    bins: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Predicted measurements of lanes: position (H, 3, C, S), R_ned_frd (H, 9, C, S), mean rate and specific
    force (H, 3, C, S).

    x0 (12, C, S); z (P, C); local (9, C, S); bins (bins, 6, C) disturbance, specific force m/s^2 then angular
    acceleration rad/s^2, both FRD. Motors start at the lagged command of the run-up.
    """
    dt, steps, pre = data.dt_s, data.steps, data.command.shape[1] - data.steps
    theta = space.theta(list(space.values(z)[:, :, None]))
    effects = [(space.effects[name], theta[name]) for name in space.parts]
    airframe = Airframe(vehicle, theta)
    lag = dynamics.motor_lag_s(NUMPY, airframe, effects)
    full, half = np.exp(-dt / lag), np.exp(-0.5 * dt / lag)
    latency = dynamics.mocap_latency_s(NUMPY, effects) + theta.get("pose-latency", (0.0,))[0]
    tilt_x, tilt_y = theta["frame-tilt"]
    gravity = (GRAVITY * tilt_y, -GRAVITY * tilt_x, 0.0 * tilt_x)

    shape = x0.shape[1:]
    x = [np.broadcast_to(x0[i], shape) for i in range(STATES)]
    thrust = [
        np.broadcast_to(airframe.commanded_thrust(data.command[:, 0, i], data.in_newton), shape)
        for i in range(4)
    ]
    position, matrix, rate, force = (np.empty((steps, n, *shape)) for n in (3, 9, 3, 3))
    per_bin = round(BIN_S / dt)
    for k in range(-pre, steps):
        target = [airframe.commanded_thrust(data.command[:, pre + k, i], data.in_newton) for i in range(4)]
        after = [t + (now - t) * full for t, now in zip(target, thrust, strict=True)]
        if k < 0:
            thrust = after
            continue
        middle = [t + (now - t) * half for t, now in zip(target, thrust, strict=True)]
        index = min(k // per_bin, data.bins - 1)
        w = [data.w[:, index, i] for i in range(6)]
        if bins is not None:
            w = [a + b for a, b in zip(w, bins[index][:, :, None], strict=True)]
        R = [data.attitude[:, k, i] for i in range(9)]
        push = [
            g + R[3 * i] * w[0] + R[3 * i + 1] * w[1] + R[3 * i + 2] * w[2] for i, g in enumerate(gravity)
        ]
        turn = [local[3 + i] + w[3 + i] for i in range(3)]
        if data.rate_driven:
            x = [*x[:9], *(data.rate[:, k, i] + turn[i] for i in range(3))]
        voltage, t_s = data.voltage_ratio[:, k], data.start_s + k * dt

        def rates(
            x: list,
            thrust: list,
            push: list = push,
            turn: list = turn,
            voltage: Any = voltage,
            t_s: Any = t_s,
        ):
            out = dynamics.rigid_body(NUMPY, airframe, effects, [*x, *thrust], voltage, t_s, push, turn)
            return [*out[:9], 0.0, 0.0, 0.0] if data.rate_driven else out

        k1 = rates(x, thrust)
        s = data.shift_s[:, k] - latency
        for i in range(3):
            position[k, i] = x[i] + s * (x[3 + i] + 0.5 * s * k1[3 + i])
        turned = [local[i] + s * x[9 + i] for i in range(3)]
        matrix[k] = _turn(euler_to_matrix(NUMPY, x[6:9]), turned)
        x_middle = [a + 0.5 * dt * b for a, b in zip(x, k1, strict=True)]
        k2 = rates(x_middle, middle)
        for i in range(3):
            rate[k, i] = x[9 + i] + 0.5 * dt * k2[9 + i]
        felt = (k2[3] - gravity[0], k2[4] - gravity[1], k2[5] - GRAVITY)
        for i, f in enumerate(mat_t_vec(euler_to_matrix(NUMPY, x_middle[6:9]), felt)):
            force[k, i] = f + local[6 + i]
        x = [a + dt * b for a, b in zip(x, k2, strict=True)]
        thrust = after
    return position, matrix, rate, force


def _turn(R: Any, phi: list) -> list:
    """R exp(phi) to second order in the small rotation vector phi (rad), nine entries."""
    a, b, c = phi
    aa, bb, cc = a * a, b * b, c * c
    E = (
        1 - 0.5 * (bb + cc), 0.5 * a * b - c, 0.5 * a * c + b,
        0.5 * a * b + c, 1 - 0.5 * (aa + cc), 0.5 * b * c - a,
        0.5 * a * c - b, 0.5 * b * c + a, 1 - 0.5 * (aa + bb),
    )  # fmt: skip
    return [
        R[3 * i] * E[j] + R[3 * i + 1] * E[3 + j] + R[3 * i + 2] * E[6 + j]
        for i in range(3)
        for j in range(3)
    ]


def residuals(
    data: Segments, position: np.ndarray, matrix: np.ndarray, rate: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Measured minus predicted in units of their sigma, (C, S, 12 H): position, attitude vector, rate,
    force.
    """
    steps, _, lanes, segments = position.shape
    out = np.empty((lanes, segments, steps, CHANNELS))
    pose, gyro = data.pose_weight[:, :, None], data.rate_weight[:, :, None]
    for_pose = pose / data.sigma[:, None, 0:1]
    out[..., 0:3] = (data.position - np.transpose(position, (2, 3, 0, 1))) * for_pose
    m = np.transpose(matrix, (2, 3, 0, 1)).reshape(lanes, segments, steps, 3, 3)
    y = data.attitude.reshape(segments, steps, 3, 3)
    error = np.einsum("cshki,shkj->cshij", m, y, optimize=True)
    for i, (row, column) in enumerate(((2, 1), (0, 2), (1, 0))):
        out[..., 3 + i] = 0.5 * (error[..., row, column] - error[..., column, row])
    out[..., 3:6] *= pose / data.sigma[:, None, 1:2]
    out[..., 6:9] = (data.rate - np.transpose(rate, (2, 3, 0, 1))) * (gyro / data.sigma[:, None, 2:3])
    felt = data.force_weight[:, :, None] / data.sigma[:, None, 3:4]
    out[..., 9:12] = (data.force - np.transpose(force, (2, 3, 0, 1))) * felt
    return out.reshape(lanes, segments, steps * CHANNELS)


@dataclass(frozen=True, kw_only=True)
class Basis:
    """Columns of the Jacobian that hardly depend on the parameters, whitened by sigma: kept between refits.

    x (S, 12, n) initial state, local (S, 9, n) flight nuisances, bins (S, 6 bins, n) disturbance; n = 12 H.
    """

    x: np.ndarray
    local: np.ndarray
    bins: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Grams:
    """Unprojected Grams (S, m, m) of [r | X 12 | S P | L 9 | Z 6 bins], and the initial states (S, 12) they
    hold at.
    """

    gram: np.ndarray
    x0: np.ndarray


class _Lanes:
    """Lanes of perturbed roll-outs, all starting from one point of every segment."""

    def __init__(self, data: Segments, x0: np.ndarray, z: np.ndarray, local: np.ndarray, count: int) -> None:
        self.x0 = np.repeat(x0.T[:, None, :], count, axis=1)
        self.z = np.repeat(z[:, None], count, axis=1)
        self.local = np.repeat(local[data.flight].T[:, None, :], count, axis=1)
        self.bins = np.zeros((data.bins, 6, count))
        self.steps = np.ones(count)

    def jacobian(self, vehicle: Vehicle, space: Space, data: Segments, *, bins: bool) -> np.ndarray:
        """(S, lanes, n): the residual in lane 0, in the others its negative slope along the perturbation."""
        pushed = self.bins if bins else None
        r = residuals(data, *roll_out(vehicle, space, data, self.x0, self.z, self.local, pushed))
        A = (r[0] - r) / self.steps[:, None, None]
        A[0] = r[0]
        return np.swapaxes(A, 0, 1)


def _chunks(data: Segments, lanes: int) -> list[slice]:
    size = max(1, _LANES // lanes)
    return [slice(i, i + size) for i in range(0, len(data.flight), size)]


def basis(vehicle: Vehicle, space: Space, data: Segments, z: np.ndarray, local: np.ndarray) -> Basis:
    """The basis at scaled parameters z (P,) and flight nuisances `local` (flights, 9)."""
    count = 1 + STATES + LOCALS + 6 * data.bins
    parts = []
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, part.x0, z, local, count)
        for i in range(STATES):
            lanes.steps[1 + i] = _X_STEP[i]
            lanes.x0[i, 1 + i] += _X_STEP[i]
        first = 1 + STATES
        for i in range(LOCALS):
            lanes.steps[first + i] = _LOCAL_STEP[i]
            lanes.local[i, first + i] += lanes.steps[first + i]
        first += LOCALS
        for b in range(data.bins):
            for i in range(6):
                lanes.steps[first + 6 * b + i] = _BIN_STEP[i]
                lanes.bins[b, i, first + 6 * b + i] = lanes.steps[first + 6 * b + i]
        parts.append(lanes.jacobian(vehicle, space, part, bins=True)[:, 1:])
    whole = np.concatenate(parts)
    cuts = np.cumsum([STATES, LOCALS])
    return Basis(x=whole[:, : cuts[0]], local=whole[:, cuts[0] : cuts[1]], bins=whole[:, cuts[1] :])


def measured_turn(vehicle: Vehicle, space: Space, data: Segments) -> np.ndarray:
    """Disturbance (S, bins, 6) with the angular acceleration that the nominal model lacks along the
    measurements.

    Read off the measured body rate; the force part is zero, errors of force turn nothing.
    """
    w = np.zeros((len(data.flight), data.bins, 6))
    if data.rate_driven:
        return w
    pre, per_bin = data.command.shape[1] - data.steps, round(BIN_S / data.dt_s)
    airframe = Airframe(vehicle, space.theta(list(space.values(np.zeros(len(space.columns))))))
    share = 1.0 - np.exp(-data.dt_s / vehicle.motor_lag_s)
    thrust = airframe.commanded_thrust(data.command[:, 0], data.in_newton)
    modelled = np.empty((len(data.flight), data.steps, 3))
    j = np.array(vehicle.inertia_kg_m2)
    for k in range(-pre, data.steps):
        target = airframe.commanded_thrust(data.command[:, pre + k], data.in_newton)
        thrust = thrust + (target - thrust) * share
        if k >= 0:
            torque = np.stack(dynamics.rotor_torque(vehicle, list(thrust.T)), axis=1)
            rate = data.rate[:, k]
            modelled[:, k] = (torque - np.cross(rate, j * rate)) / j
    for b in range(data.bins):
        a, e = b * per_bin, min((b + 1) * per_bin, data.steps - 1)
        known = (data.rate_weight[:, a] * data.rate_weight[:, e])[:, None]
        gained = (data.rate[:, e] - data.rate[:, a]) / ((e - a) * data.dt_s)
        w[:, b, 3:] = known * (gained - modelled[:, a:e].mean(1))
    return w


def fitted_x0(
    vehicle: Vehicle,
    space: Space,
    data: Segments,
    z: np.ndarray,
    local: np.ndarray,
    kept: Basis,
    iterations: int = 1,
) -> np.ndarray:
    """Initial states (S, 12) that fit each segment's own measurements best; the rest is given."""
    x0 = data.x0
    normal = kept.x @ np.swapaxes(kept.x, 1, 2) + 1e-9 * np.eye(STATES)
    for _ in range(iterations):
        residual = []
        for chunk in _chunks(data, 1):
            part = data.take(chunk)
            lanes = _Lanes(part, x0[chunk], z, local, 1)
            residual.append(lanes.jacobian(vehicle, space, part, bins=False)[:, 0])
        x0 = x0 + np.linalg.solve(normal, kept.x @ np.concatenate(residual)[:, :, None])[:, :, 0]
    return x0


def linearise(
    vehicle: Vehicle, space: Space, data: Segments, z: np.ndarray, local: np.ndarray, kept: Basis
) -> Grams:
    """Grams of all segments at scaled parameters z (P,) and flight nuisances `local` (flights, 9).

    Initial states take one Gauss-Newton step towards their own segment first.
    """
    x0 = fitted_x0(vehicle, space, data, z, local, kept)
    count = 1 + len(z)
    grams = []
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, x0[chunk], z, local, count)
        for i in range(len(z)):
            lanes.steps[1 + i] = _Z_STEP
            lanes.z[i, 1 + i] += _Z_STEP
        A = lanes.jacobian(vehicle, space, part, bins=False)
        A[:, 0] += np.einsum("szn,sz->sn", kept.bins[chunk], part.w.reshape(len(part.w), -1))
        A = np.concatenate([A[:, :1], kept.x[chunk], A[:, 1:], kept.local[chunk], kept.bins[chunk]], axis=1)
        grams.append(A @ np.swapaxes(A, 1, 2))
    return Grams(gram=np.concatenate(grams), x0=x0)


def project(grams: Grams, data: Segments, z: np.ndarray, local: np.ndarray) -> Linearisation:
    """The linearisation left when every segment's initial state is free."""
    gram = grams.gram
    head, rest = np.arange(1, 1 + STATES), np.r_[0, 1 + STATES : gram.shape[1]]
    A = gram[:, head[:, None], head]
    scale = np.sqrt(np.einsum("sii->si", A)) + 1e-12
    A = A / scale[:, :, None] / scale[:, None, :] + 1e-10 * np.eye(STATES)
    C = gram[:, head[:, None], rest] / scale[:, :, None]
    B = gram[:, rest[:, None], rest]
    return Linearisation(
        gram=B - np.swapaxes(C, 1, 2) @ np.linalg.solve(A, C), flight=data.flight, z=z, local=local
    )
