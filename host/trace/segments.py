"""Command-driven segments: roll-outs of the library form from free initial states, linearised by lanes.

A lane is one column of the Jacobian of one segment: the base roll-out, one initial-state direction, one
scaled parameter, one local nuisance or one disturbance bin. All lanes advance together through the program of
`trimtab.host.trace.form`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.models import dynamics
from trimtab.host.trace.evidence import Linearisation
from trimtab.host.trace.form import CHANNELS, LOCALS, STATES, Form
from trimtab.host.vehicle import Vehicle

BIN_S = 0.1
PATH_S = 0.02
"""Step of the measured paths along which the effects' own states are found."""

_LANES = 2500
_X_STEP = np.full(STATES, 1e-6)
TURN_STEPS = 6
"""Steps over which poses say a body rate: noise of attitude asks for many, a turn that changes for few."""

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
    roll-outs are linearised at, so that they stay near what was measured whatever the parameters lack. paths
    (flights, n, 12): measured state of whole flights each PATH_S, from rest; path_start_s (S,) into them.
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
    path_start_s: np.ndarray
    paths: np.ndarray
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
        shared = ("dt_s", "paths", "in_newton", "rate_driven")
        return replace(self, **{k: v[index] for k, v in vars(self).items() if k not in shared})


def roll_out(
    form: Form,
    data: Segments,
    x0: np.ndarray,
    z: np.ndarray,
    local: np.ndarray,
    bins: np.ndarray | None = None,
    memory: np.ndarray | None = None,
) -> np.ndarray:
    """Predicted measurements (H, 12, C, S) of lanes: `form.CHANNELS` of every step.

    x0 (12, C, S); z (P, C); local (9, C, S); bins (bins, 6, C) disturbance, specific force m/s^2 then angular
    acceleration rad/s^2, both FRD. Motors start at the lagged command of the run-up, the effects' own states
    at `memory` (M, C, S); by default with what the measured flight made of them.
    """
    lanes, count = x0.shape[1:]
    total = lanes * count
    step, pre = form.bind("step", total), data.command.shape[1] - data.steps
    inputs, outputs = step.inputs, step.outputs

    def load(name: str, value: np.ndarray) -> None:
        """An input of every segment (S,) or (S, n), the same in all lanes."""
        rows = value.T[:, None] if value.ndim == 2 else value
        inputs[name].reshape(-1, lanes, count)[:] = rows

    each = np.repeat(z, count, axis=1)
    inputs["z"][:] = each
    inputs["body"][:] = x0.reshape(STATES, total)
    inputs["local"][:] = local.reshape(LOCALS, total)
    commands = _delayed(form, data.command, z)
    inputs["thrust"][:] = _spun_up(form, commands[:pre], each)
    if form.memory:
        memory = remembered(form, data, z) if memory is None else memory
        inputs["memory"][:] = memory.reshape(form.memory, total)
    predicted = np.empty((data.steps, CHANNELS, lanes, count))
    per_bin = round(BIN_S / data.dt_s)
    w = inputs["w"].reshape(6, lanes, count)
    for k in range(data.steps):
        index = k // per_bin
        w[:] = data.w[:, index].T[:, None]
        if bins is not None:
            w += bins[index][:, :, None]
        inputs["command"][:] = commands[pre + k]
        load("attitude", data.attitude[:, k])
        load("rate", data.rate[:, k])
        load("voltage", data.voltage_ratio[:, k])
        load("t_s", data.start_s + k * data.dt_s)
        load("shift_s", data.shift_s[:, k])
        step()
        predicted[k] = outputs["predicted_out"].reshape(CHANNELS, lanes, count)
        inputs["body"][:] = outputs["body_out"]
        inputs["thrust"][:] = outputs["thrust_out"]
        inputs["memory"][:] = outputs["memory_out"]
    return predicted


def _delayed(form: Form, command: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Commands (pre + H, 4, C S) of the lanes z (P, C) as they arrive, from those given (S, pre + H, 4).

    Means over steps, so that a delay of a fraction of a step mixes two of them; before the first, the first.
    """
    each = []
    for delay in form.delay_s(z):
        whole, share = divmod(float(delay) / form.dt_s, 1.0)
        at = np.clip(np.arange(command.shape[1]) - int(whole), 0, command.shape[1] - 1)
        now, before = command[:, at], command[:, np.maximum(at - 1, 0)]
        each.append((1.0 - share) * now + share * before if share else now)
    lanes = np.transpose(np.array(each), (2, 3, 0, 1))
    return lanes.reshape(*lanes.shape[:2], -1)


def _spun_up(form: Form, commands: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Rotor thrusts (4, lanes) after commands (n, 4, lanes), begun where the first of them settles."""
    rotors = form.bind("rotors", commands.shape[2])
    rotors.inputs["z"][:] = z
    for k, command in enumerate(commands):
        rotors.inputs["command"][:] = command
        if k == 0:
            rotors()
            rotors.inputs["thrust"][:] = rotors.outputs["settled"]
        rotors()
        rotors.inputs["thrust"][:] = rotors.outputs["next"]
    return rotors.outputs["next"].copy()


def remembered(form: Form, data: Segments, z: np.ndarray) -> np.ndarray:
    """The effects' own states (M, C, S) at the segments' starts for scaled parameters z (P, C), along the
    measured paths of their flights.
    """
    if not form.memory:
        return np.empty((0, z.shape[1], len(data.flight)))
    own = [i for name, rows in form.space.owners.items() if form.memory_of(name) for i in rows]
    kinds, lane = np.unique(z[own], axis=1, return_inverse=True)
    values = np.repeat(z[:, :1], kinds.shape[1], axis=1)
    values[own] = kinds
    flights, steps = data.paths.shape[:2]
    program = form.bind("memory", flights * kinds.shape[1])
    program.inputs["z"][:] = np.repeat(values, flights, axis=1)
    body = program.inputs["body"].reshape(STATES, -1, flights)
    memory = program.inputs["memory"]
    acceleration = program.inputs["acceleration"].reshape(3, -1, flights)
    body[:] = data.paths[:, 0].T[:, None]
    program()
    now = program.outputs["rest"].copy()
    found = np.empty((steps, form.memory, kinds.shape[1], flights))
    for k in range(steps):
        found[k] = now.reshape(found.shape[1:])
        memory[:] = now
        after = data.paths[:, min(k + 1, steps - 1)]
        body[:] = data.paths[:, k].T[:, None]
        acceleration[:] = (after - data.paths[:, k])[:, 3:6].T[:, None] / PATH_S
        program()
        memory[:] = now + 0.5 * PATH_S * program.outputs["rates"]
        body[:] = 0.5 * (data.paths[:, k] + after).T[:, None]
        program()
        now = now + PATH_S * program.outputs["rates"]
    at = data.path_start_s / PATH_S
    low = np.clip(at.astype(int), 0, steps - 2)
    share = np.clip(at - low, 0.0, 1.0)
    low, share = low[None, :], share[None, :, None]
    lane, flight = lane.reshape(-1, 1), data.flight[None, :]
    ends = [np.moveaxis(found, 1, 3)[low + end, lane, flight] for end in (0, 1)]
    return np.moveaxis((1.0 - share) * ends[0] + share * ends[1], 2, 0)


def residuals(data: Segments, predicted: np.ndarray) -> np.ndarray:
    """Measured minus predicted in units of their sigma, (C, S, 12 H), for `roll_out`'s (H, 12, C, S)."""
    steps, _, lanes, segments = predicted.shape
    measured = np.concatenate([data.position, np.zeros_like(data.position), data.rate, data.force], axis=2)
    weights = (data.pose_weight, data.pose_weight, data.rate_weight, data.force_weight)
    scale = np.stack([w / data.sigma[:, i : i + 1] for i, w in enumerate(weights)], axis=2)
    out = measured - np.transpose(predicted, (2, 3, 0, 1))
    out *= np.repeat(scale, 3, axis=2)
    return out.reshape(lanes, segments, steps * CHANNELS)


@dataclass(frozen=True, kw_only=True)
class Basis:
    """Columns of the Jacobian that hardly depend on the parameters, whitened by sigma: kept between refits.

    columns (S, 12 + 9 + 6 bins, n): initial state, flight nuisances, disturbance; n = 12 H. gram: of these.
    """

    columns: np.ndarray
    gram: np.ndarray

    @property
    def x(self) -> np.ndarray:
        """(S, 12, n)."""
        return self.columns[:, :STATES]

    @property
    def bins(self) -> np.ndarray:
        """(S, 6 bins, n)."""
        return self.columns[:, STATES + LOCALS :]


@dataclass(frozen=True, kw_only=True)
class Grams:
    """Unprojected Grams (S, m, m) of [r | S P | X 12 | L 9 | Z 6 bins], and the initial states (S, 12) they
    hold at.
    """

    gram: np.ndarray
    x0: np.ndarray
    parameters: int


class _Lanes:
    """Lanes of perturbed roll-outs, all starting from one point of every segment."""

    def __init__(
        self, data: Segments, x0: np.ndarray, z: np.ndarray, local: np.ndarray, memory: np.ndarray, count: int
    ) -> None:
        self.x0 = np.repeat(x0.T[:, None, :], count, axis=1)
        self.z = np.repeat(z[:, None], count, axis=1)
        self.memory = np.broadcast_to(memory, (len(memory), count, len(data.flight)))
        self.local = np.repeat(local[data.flight].T[:, None, :], count, axis=1)
        self.bins = np.zeros((data.bins, 6, count))
        self.steps = np.ones(count)

    def jacobian(self, form: Form, data: Segments, *, bins: bool) -> np.ndarray:
        """(S, lanes, n): the residual in lane 0, in the others its negative slope along the perturbation."""
        pushed = self.bins if bins else None
        r = residuals(data, roll_out(form, data, self.x0, self.z, self.local, pushed, self.memory))
        A = (r[0] - r) / self.steps[:, None, None]
        A[0] = r[0]
        return np.swapaxes(A, 0, 1)


def _chunks(data: Segments, lanes: int) -> list[slice]:
    size = max(1, _LANES // lanes)
    return [slice(i, i + size) for i in range(0, len(data.flight), size)]


def basis(form: Form, data: Segments, z: np.ndarray, local: np.ndarray) -> Basis:
    """The basis at scaled parameters z (P,) and flight nuisances `local` (flights, 9)."""
    count = 1 + STATES + LOCALS + 6 * data.bins
    memory = remembered(form, data, z[:, None])
    parts = []
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, part.x0, z, local, memory[:, :, chunk], count)
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
        parts.append(lanes.jacobian(form, part, bins=True)[:, 1:])
    whole = np.concatenate(parts)
    return Basis(columns=whole, gram=whole @ np.swapaxes(whole, 1, 2))


def nominal_thrust(vehicle: Vehicle, command: np.ndarray, *, in_newton: bool) -> np.ndarray:
    """Rotor thrust in N that motor commands ask for, before the lag; what is in newton stays."""
    c1, c2 = vehicle.thrust_curve
    return command if in_newton else vehicle.thrust_max_n * command * (c1 + c2 * command)


def measured_turn(form: Form, data: Segments) -> np.ndarray:
    """Disturbance (S, bins, 6) with the angular acceleration that the nominal model lacks along the
    measurements.

    Read off the measured body rate, where no gyro spoke off the poses' turning; the force part is zero,
    errors of force turn nothing.
    """
    w = np.zeros((len(data.flight), data.bins, 6))
    if data.rate_driven:
        return w
    pre, per_bin = data.command.shape[1] - data.steps, round(BIN_S / data.dt_s)
    vehicle = form.vehicle
    share = 1.0 - np.exp(-data.dt_s / vehicle.motor_lag_s)
    target = nominal_thrust(vehicle, data.command, in_newton=data.in_newton)
    thrust = target[:, 0]
    modelled = np.empty((len(data.flight), data.steps, 3))
    measured, weight = data.rate.copy(), data.rate_weight.copy()
    for i in np.flatnonzero(~weight.any(axis=1)).tolist():
        measured[i], weight[i] = _turning(data, i), 1.0
    j = np.array(vehicle.inertia_kg_m2)
    for k in range(-pre, data.steps):
        thrust = thrust + (target[:, pre + k] - thrust) * share
        if k >= 0:
            torque = np.stack(dynamics.rotor_torque(vehicle, list(thrust.T)), axis=1)
            rate = measured[:, k]
            modelled[:, k] = (torque - np.cross(rate, j * rate)) / j
    for b in range(data.bins):
        a, e = b * per_bin, min((b + 1) * per_bin, data.steps - 1)
        known = (weight[:, a] * weight[:, e])[:, None]
        gained = (measured[:, e] - measured[:, a]) / ((e - a) * data.dt_s)
        w[:, b, 3:] = known * (gained - modelled[:, a:e].mean(1))
    return w


def _turning(data: Segments, i: int) -> np.ndarray:
    """Body rate (steps, 3) along segment i from its poses alone: means over TURN_STEPS between them."""
    at = np.flatnonzero(data.pose_weight[i])
    apart = min(TURN_STEPS, len(at) - 1)
    first, last = at[:-apart], at[apart:]
    R = data.attitude[i].reshape(-1, 3, 3)
    turned = Rotation.from_matrix(np.swapaxes(R[first], 1, 2) @ R[last]).as_rotvec()
    rate = turned / ((last - first) * data.dt_s)[:, None]
    middle = 0.5 * (first + last)
    return np.column_stack([np.interp(np.arange(data.steps), middle, rate[:, axis]) for axis in range(3)])


def fitted_x0(
    form: Form,
    data: Segments,
    z: np.ndarray,
    local: np.ndarray,
    kept: Basis,
    iterations: int = 1,
    memory: np.ndarray | None = None,
) -> np.ndarray:
    """Initial states (S, 12) that fit each segment's own measurements best; the rest is given.

    `memory` (M, 1, S) is `remembered` at z, where it is known.
    """
    x0 = data.x0
    if memory is None:
        memory = remembered(form, data, z[:, None])
    normal = kept.gram[:, :STATES, :STATES] + 1e-9 * np.eye(STATES)
    for _ in range(iterations):
        residual = []
        for chunk in _chunks(data, 1):
            part = data.take(chunk)
            lanes = _Lanes(part, x0[chunk], z, local, memory[:, :, chunk], 1)
            residual.append(lanes.jacobian(form, part, bins=False)[:, 0])
        x0 = x0 + np.linalg.solve(normal, kept.x @ np.concatenate(residual)[:, :, None])[:, :, 0]
    return x0


def linearise(form: Form, data: Segments, z: np.ndarray, local: np.ndarray, kept: Basis) -> Grams:
    """Grams of all segments at scaled parameters z (P,) and flight nuisances `local` (flights, 9).

    Initial states take one Gauss-Newton step towards their own segment first.
    """
    count = 1 + len(z)
    points = np.repeat(z[:, None], count, axis=1)
    points[:, 1:] += _Z_STEP * np.eye(len(z))
    memory = remembered(form, data, points)
    x0 = fitted_x0(form, data, z, local, kept, memory=memory[:, :1])
    first = 1 + len(z)
    size = first + kept.columns.shape[1]
    gram = np.empty((len(data.flight), size, size))
    gram[:, first:, first:] = kept.gram
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, x0[chunk], z, local, memory[:, :, chunk], count)
        lanes.steps[1:] = _Z_STEP
        lanes.z = points
        A = lanes.jacobian(form, part, bins=False)
        columns = kept.columns[chunk]
        A[:, 0] += np.einsum("szn,sz->sn", kept.bins[chunk], part.w.reshape(len(part.w), -1))
        gram[chunk, :first, :first] = A @ np.swapaxes(A, 1, 2)
        gram[chunk, :first, first:] = A @ np.swapaxes(columns, 1, 2)
    form.space.check_finite(np.einsum("sii->i", gram[:, :first, :first]))
    gram[:, first:, :first] = np.swapaxes(gram[:, :first, first:], 1, 2)
    return Grams(gram=gram, x0=x0, parameters=len(z))


def project(grams: Grams, data: Segments, z: np.ndarray, local: np.ndarray) -> Linearisation:
    """The linearisation left when every segment's initial state is free."""
    gram = grams.gram
    first = 1 + grams.parameters
    head, rest = np.arange(first, first + STATES), np.r_[0:first, first + STATES : gram.shape[1]]
    A = gram[:, head[:, None], head]
    scale = np.sqrt(np.einsum("sii->si", A)) + 1e-12
    A = A / scale[:, :, None] / scale[:, None, :] + 1e-10 * np.eye(STATES)
    C = gram[:, head[:, None], rest] / scale[:, :, None]
    B = gram[:, rest[:, None], rest]
    return Linearisation(
        gram=B - np.swapaxes(C, 1, 2) @ np.linalg.solve(A, C), flight=data.flight, z=z, local=local
    )
