"""Command-driven segments: roll-outs of the library form from free initial states, linearised by lanes.

A lane is one column of the Jacobian of one segment: the base roll-out, one initial-state direction, one
scaled parameter, one local nuisance or one disturbance bin. All lanes advance together through the program of
`trimtab.host.trace.segment_fit.model`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.models import dynamics
from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.data.signals import nominal_thrust
from trimtab.host.trace.evidence import Linearisation
from trimtab.host.trace.segment_fit.model import LOCALS, STATES, SegmentModel
from trimtab.host.trace.segment_fit.rollout import remembered, residuals, roll_out

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
        self,
        data: Segments,
        x0: np.ndarray,
        theta_scaled: np.ndarray,
        local: np.ndarray,
        memory: np.ndarray,
        count: int,
    ) -> None:
        self.x0 = np.repeat(x0.T[:, None, :], count, axis=1)
        self.theta_scaled = np.repeat(theta_scaled[:, None], count, axis=1)
        self.memory = np.broadcast_to(memory, (len(memory), count, len(data.flight)))
        self.local = np.repeat(local[data.flight].T[:, None, :], count, axis=1)
        self.bins = np.zeros((data.bins, 6, count))
        self.steps = np.ones(count)

    def jacobian(self, segment_model: SegmentModel, data: Segments, *, bins: bool) -> np.ndarray:
        """(S, lanes, n): the residual in lane 0, in the others its negative slope along the perturbation."""
        pushed = self.bins if bins else None
        r = residuals(
            data, roll_out(segment_model, data, self.x0, self.theta_scaled, self.local, pushed, self.memory)
        )
        A = (r[0] - r) / self.steps[:, None, None]
        A[0] = r[0]
        return np.swapaxes(A, 0, 1)


def _chunks(data: Segments, lanes: int) -> list[slice]:
    size = max(1, _LANES // lanes)
    return [slice(i, i + size) for i in range(0, len(data.flight), size)]


def basis(segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray, local: np.ndarray) -> Basis:
    """Return the basis at scaled parameters theta_scaled (P,) and flight nuisances `local` (flights, 9)."""
    count = 1 + STATES + LOCALS + 6 * data.bins
    memory = remembered(segment_model, data, theta_scaled[:, None])
    parts = []
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, part.x0, theta_scaled, local, memory[:, :, chunk], count)
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
        parts.append(lanes.jacobian(segment_model, part, bins=True)[:, 1:])
    whole = np.concatenate(parts)
    return Basis(columns=whole, gram=whole @ np.swapaxes(whole, 1, 2))


def measured_turn(segment_model: SegmentModel, data: Segments) -> np.ndarray:
    """Disturbance (S, bins, 6) with the angular acceleration that the nominal model lacks along the
    measurements.

    Read off the measured body rate, where no gyro spoke off the poses' turning; the force part is zero,
    errors of force turn nothing.
    """
    w = np.zeros((len(data.flight), data.bins, 6))
    if data.rate_driven:
        return w
    pre, per_bin = data.command.shape[1] - data.steps, round(BIN_S / data.dt_s)
    vehicle = segment_model.vehicle
    share = 1.0 - np.exp(-data.dt_s / vehicle.motor_lag_s)
    target = nominal_thrust(vehicle, data.command, in_newton=data.in_newton)
    thrust = target[:, 0]
    modelled = np.empty((len(data.flight), data.steps, 3))
    measured, weight = data.rate_frd.copy(), data.rate_weight.copy()
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
    R = data.R_ned_frd[i].reshape(-1, 3, 3)
    turned = Rotation.from_matrix(np.swapaxes(R[first], 1, 2) @ R[last]).as_rotvec()
    rate = turned / ((last - first) * data.dt_s)[:, None]
    middle = 0.5 * (first + last)
    return np.column_stack([np.interp(np.arange(data.steps), middle, rate[:, axis]) for axis in range(3)])


def fitted_x0(
    segment_model: SegmentModel,
    data: Segments,
    theta_scaled: np.ndarray,
    local: np.ndarray,
    kept: Basis,
    iterations: int = 1,
    memory: np.ndarray | None = None,
) -> np.ndarray:
    """Return initial states (S, 12) that fit each segment's own measurements best; the rest is given.

    `memory` (M, 1, S) is `remembered` at z, where it is known.
    """
    x0 = data.x0
    if memory is None:
        memory = remembered(segment_model, data, theta_scaled[:, None])
    normal = kept.gram[:, :STATES, :STATES] + 1e-9 * np.eye(STATES)
    for _ in range(iterations):
        residual = []
        for chunk in _chunks(data, 1):
            part = data.take(chunk)
            lanes = _Lanes(part, x0[chunk], theta_scaled, local, memory[:, :, chunk], 1)
            residual.append(lanes.jacobian(segment_model, part, bins=False)[:, 0])
        x0 = x0 + np.linalg.solve(normal, kept.x @ np.concatenate(residual)[:, :, None])[:, :, 0]
    return x0


def linearise(
    segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray, local: np.ndarray, kept: Basis
) -> Grams:
    """Grams of all segments at scaled parameters theta_scaled (P,) and flight nuisances `local` (flights, 9).

    Initial states take one Gauss-Newton step towards their own segment first.
    """
    count = 1 + len(theta_scaled)
    points = np.repeat(theta_scaled[:, None], count, axis=1)
    points[:, 1:] += _Z_STEP * np.eye(len(theta_scaled))
    memory = remembered(segment_model, data, points)
    x0 = fitted_x0(segment_model, data, theta_scaled, local, kept, memory=memory[:, :1])
    first = 1 + len(theta_scaled)
    size = first + kept.columns.shape[1]
    gram = np.empty((len(data.flight), size, size))
    gram[:, first:, first:] = kept.gram
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, x0[chunk], theta_scaled, local, memory[:, :, chunk], count)
        lanes.steps[1:] = _Z_STEP
        lanes.theta_scaled = points
        A = lanes.jacobian(segment_model, part, bins=False)
        columns = kept.columns[chunk]
        A[:, 0] += np.einsum(
            "szn,sz->sn", kept.bins[chunk], part.disturbance_frd.reshape(len(part.disturbance_frd), -1)
        )
        gram[chunk, :first, :first] = A @ np.swapaxes(A, 1, 2)
        gram[chunk, :first, first:] = A @ np.swapaxes(columns, 1, 2)
    segment_model.space.check_finite(np.einsum("sii->i", gram[:, :first, :first]))
    gram[:, first:, :first] = np.swapaxes(gram[:, :first, first:], 1, 2)
    return Grams(gram=gram, x0=x0, parameters=len(theta_scaled))


def project(grams: Grams, data: Segments, theta_scaled: np.ndarray, local: np.ndarray) -> Linearisation:
    """Return the linearisation left when every segment's initial state is free."""
    gram = grams.gram
    first = 1 + grams.parameters
    head, rest = np.arange(first, first + STATES), np.r_[0:first, first + STATES : gram.shape[1]]
    A = gram[:, head[:, None], head]
    scale = np.sqrt(np.einsum("sii->si", A)) + 1e-12
    A = A / scale[:, :, None] / scale[:, None, :] + 1e-10 * np.eye(STATES)
    C = gram[:, head[:, None], rest] / scale[:, :, None]
    B = gram[:, rest[:, None], rest]
    return Linearisation(
        gram=B - np.swapaxes(C, 1, 2) @ np.linalg.solve(A, C),
        flight=data.flight,
        theta_scaled=theta_scaled,
        local=local,
    )
