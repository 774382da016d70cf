"""Linearisation of command-driven segments with free initial states.

Each lane is one roll-out of a segment: the base roll-out, or one with a single perturbed input. The perturbed
inputs are components of the initial state, scaled parameters, nuisances and components of the disturbance in
a bin. Differences of the lanes are the columns of the Jacobian. All lanes advance together through the
program of `trimtab.host.trace.segment_fit.model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.models import dynamics
from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.data.signals import nominal_thrust
from trimtab.host.trace.linearisation import Linearisation
from trimtab.host.trace.segment_fit.model import NUISANCES, STATES, SegmentModel
from trimtab.host.trace.segment_fit.rollout import remembered, residuals, roll_out

_LANES = 2500
"""Lanes that are rolled out together."""
_X_STEP = np.full(STATES, 1e-6)
TURN_STEPS = 6
"""Steps between the poses that give a body rate. More average attitude noise, fewer follow fast turns."""

_NUISANCE_STEP = np.full(NUISANCES, 1e-5)
_BIN_STEP = np.full(6, 1e-5)
_THETA_STEP = 1e-5
"""Step of the difference quotients, scaled. It must be small: attitude responds so strongly to torque that
with coarse steps the columns of similar effects are no longer parallel. Terms that should cancel would then
look like information."""


@dataclass(frozen=True, kw_only=True)
class Basis:
    """Columns of the Jacobian that hardly depend on the parameters and are reused between refits.

    columns, in units of sigma: 12 of the initial state, 9 of nuisances and 6 of the disturbance in each bin.
    gram: their Gram.
    """

    columns: Annotated[np.ndarray, "segments unknowns residuals"]
    gram: Annotated[np.ndarray, "segments unknowns unknowns"]

    @property
    def x(self) -> Annotated[np.ndarray, "segments 12 residuals"]:
        """Columns of the initial state."""
        return self.columns[:, :STATES]

    @property
    def bins(self) -> Annotated[np.ndarray, "segments disturbances residuals"]:
        """Columns of the disturbance."""
        return self.columns[:, STATES + NUISANCES :]


@dataclass(frozen=True, kw_only=True)
class Grams:
    """Grams of every segment before initial states are projected out.

    gram: of [r | S | X | L | Z], with columns S of parameters, 12 columns X of the initial state, 9 columns L
    of nuisances and, for each bin, 6 columns Z of the disturbance. x0: initial states of the linearisation.
    parameters: number of columns S.
    """

    gram: Annotated[np.ndarray, "segments all_columns all_columns"]
    x0: Annotated[np.ndarray, "segments 12"]
    parameters: int


class _Lanes:
    """`count` lanes of every segment that start at one point, to be perturbed one by one."""

    def __init__(
        self,
        data: Segments,
        x0: Annotated[np.ndarray, "segments 12"],
        theta_scaled: Annotated[np.ndarray, "parameters"],
        nuisances: Annotated[np.ndarray, "flights 9"],
        memory: Annotated[np.ndarray, "memory _ segments"],
        count: int,
    ) -> None:
        self.x0 = np.repeat(x0.T[:, None, :], count, axis=1)
        self.theta_scaled = np.repeat(theta_scaled[:, None], count, axis=1)
        self.memory = np.broadcast_to(memory, (len(memory), count, len(data.flight)))
        self.nuisances = np.repeat(nuisances[data.flight].T[:, None, :], count, axis=1)
        self.bins = np.zeros((data.bins, 6, count))
        self.steps = np.ones(count)

    def jacobian(
        self, segment_model: SegmentModel, data: Segments, *, bins: bool
    ) -> Annotated[np.ndarray, "segments lanes residuals"]:
        """Return the residual in lane 0, its negative slopes by the perturbation in others.

        bins: whether lanes perturb the disturbance.
        """
        added = self.bins if bins else None
        r = residuals(
            data,
            roll_out(segment_model, data, self.x0, self.theta_scaled, self.nuisances, added, self.memory),
        )
        A = (r[0] - r) / self.steps[:, None, None]
        A[0] = r[0]
        return np.swapaxes(A, 0, 1)


def _chunks(data: Segments, lanes: int) -> list[slice]:
    """Return slices of segments that need about _LANES lanes each, if a segment needs `lanes`."""
    size = max(1, _LANES // lanes)
    return [slice(i, i + size) for i in range(0, len(data.flight), size)]


def basis(
    segment_model: SegmentModel,
    data: Segments,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    nuisances: Annotated[np.ndarray, "flights 9"],
) -> Basis:
    """Return the basis at scaled parameters and nuisances."""
    count = 1 + STATES + NUISANCES + 6 * data.bins
    memory = remembered(segment_model, data, theta_scaled[:, None])
    parts = []
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, part.x0, theta_scaled, nuisances, memory[:, :, chunk], count)
        for i in range(STATES):
            lanes.steps[1 + i] = _X_STEP[i]
            lanes.x0[i, 1 + i] += _X_STEP[i]
        first = 1 + STATES
        for i in range(NUISANCES):
            lanes.steps[first + i] = _NUISANCE_STEP[i]
            lanes.nuisances[i, first + i] += lanes.steps[first + i]
        first += NUISANCES
        for b in range(data.bins):
            for i in range(6):
                lanes.steps[first + 6 * b + i] = _BIN_STEP[i]
                lanes.bins[b, i, first + 6 * b + i] = lanes.steps[first + 6 * b + i]
        parts.append(lanes.jacobian(segment_model, part, bins=True)[:, 1:])
    whole = np.concatenate(parts)
    return Basis(columns=whole, gram=whole @ np.swapaxes(whole, 1, 2))


def disturbance_from_measured_rotation(
    segment_model: SegmentModel, data: Segments
) -> Annotated[np.ndarray, "segments bins 6"]:
    """Return the disturbance, FRD, that explains the measured rotation with the nominal model.

    Its angular acceleration, in rad/s^2, is the measured one minus the modelled one. If the gyro was not
    logged, the body rate comes from the attitudes of the poses. Its force is 0, since forces do not rotate
    the vehicle.
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
        measured[i], weight[i] = _rate_from_poses(data, i), 1.0
    j = np.array(vehicle.inertia_kg_m2)
    for k in range(-pre, data.steps):
        thrust = thrust + (target[:, pre + k] - thrust) * share
        if k >= 0:
            torque = np.stack(dynamics.rotor_torque(vehicle, list(thrust.T)), axis=1)
            rate = measured[:, k]
            modelled[:, k] = (torque - np.cross(rate, j * rate)) / j
    for b in range(data.bins):
        first, last = b * per_bin, min((b + 1) * per_bin, data.steps - 1)
        known = (weight[:, first] * weight[:, last])[:, None]
        acceleration = (measured[:, last] - measured[:, first]) / ((last - first) * data.dt_s)
        w[:, b, 3:] = known * (acceleration - modelled[:, first:last].mean(1))
    return w


def _rate_from_poses(data: Segments, i: int) -> np.ndarray:
    """Return the body rate (steps, 3) in rad/s, FRD, of segment i from poses TURN_STEPS apart."""
    posed = np.flatnonzero(data.pose_weight[i])
    gap = min(TURN_STEPS, len(posed) - 1)
    first, last = posed[:-gap], posed[gap:]
    R = data.R_ned_frd[i].reshape(-1, 3, 3)
    rotation = Rotation.from_matrix(np.swapaxes(R[first], 1, 2) @ R[last]).as_rotvec()
    rate = rotation / ((last - first) * data.dt_s)[:, None]
    middle = 0.5 * (first + last)
    return np.column_stack([np.interp(np.arange(data.steps), middle, rate[:, axis]) for axis in range(3)])


def fitted_x0(
    segment_model: SegmentModel,
    data: Segments,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    nuisances: Annotated[np.ndarray, "flights 9"],
    basis: Basis,
    iterations: int = 1,
    memory: Annotated[np.ndarray, "memory 1 segments"] | None = None,
) -> Annotated[np.ndarray, "segments 12"]:
    """Return the initial states that fit the measurements of each segment best.

    Parameters
    ----------
    segment_model
        Model of the segments.
    data
        Segments; the iteration starts at their x0.
    theta_scaled
        Scaled parameters.
    nuisances
        Nuisances of each flight.
    basis
        Columns of the Jacobian.
    iterations
        Number of Gauss-Newton steps.
    memory
        States of the effects at the start of each segment; computed by `remembered` if None.
    """
    x0 = data.x0
    if memory is None:
        memory = remembered(segment_model, data, theta_scaled[:, None])
    normal = basis.gram[:, :STATES, :STATES] + 1e-9 * np.eye(STATES)
    for _ in range(iterations):
        residual = []
        for chunk in _chunks(data, 1):
            part = data.take(chunk)
            lanes = _Lanes(part, x0[chunk], theta_scaled, nuisances, memory[:, :, chunk], 1)
            residual.append(lanes.jacobian(segment_model, part, bins=False)[:, 0])
        x0 = x0 + np.linalg.solve(normal, basis.x @ np.concatenate(residual)[:, :, None])[:, :, 0]
    return x0


def linearise(
    segment_model: SegmentModel,
    data: Segments,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    nuisances: Annotated[np.ndarray, "flights 9"],
    basis: Basis,
) -> Grams:
    """Return the Grams of all segments at scaled parameters and nuisances.

    The initial states first take one Gauss-Newton step towards the measurements of their segment. basis:
    columns of the Jacobian that are not computed again.
    """
    count = 1 + len(theta_scaled)
    points = np.repeat(theta_scaled[:, None], count, axis=1)
    points[:, 1:] += _THETA_STEP * np.eye(len(theta_scaled))
    memory = remembered(segment_model, data, points)
    x0 = fitted_x0(segment_model, data, theta_scaled, nuisances, basis, memory=memory[:, :1])
    first = 1 + len(theta_scaled)
    size = first + basis.columns.shape[1]
    gram = np.empty((len(data.flight), size, size))
    gram[:, first:, first:] = basis.gram
    for chunk in _chunks(data, count):
        part = data.take(chunk)
        lanes = _Lanes(part, x0[chunk], theta_scaled, nuisances, memory[:, :, chunk], count)
        lanes.steps[1:] = _THETA_STEP
        lanes.theta_scaled = points
        A = lanes.jacobian(segment_model, part, bins=False)
        columns = basis.columns[chunk]
        A[:, 0] += np.einsum(
            "szn,sz->sn", basis.bins[chunk], part.disturbance_frd.reshape(len(part.disturbance_frd), -1)
        )
        gram[chunk, :first, :first] = A @ np.swapaxes(A, 1, 2)
        gram[chunk, :first, first:] = A @ np.swapaxes(columns, 1, 2)
    segment_model.space.check_finite(np.einsum("sii->i", gram[:, :first, :first]))
    gram[:, first:, :first] = np.swapaxes(gram[:, :first, first:], 1, 2)
    return Grams(gram=gram, x0=x0, parameters=len(theta_scaled))


def project(
    grams: Grams,
    data: Segments,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    nuisances: Annotated[np.ndarray, "flights 9"],
) -> Linearisation:
    """Return the linearisation with the initial state of every segment projected out, since it is free.

    theta_scaled, nuisances: point of the linearisation.
    """
    gram = grams.gram
    first = 1 + grams.parameters
    states, others = np.arange(first, first + STATES), np.r_[0:first, first + STATES : gram.shape[1]]
    A = gram[:, states[:, None], states]
    scale = np.sqrt(np.einsum("sii->si", A)) + 1e-12
    A = A / scale[:, :, None] / scale[:, None, :] + 1e-10 * np.eye(STATES)
    C = gram[:, states[:, None], others] / scale[:, :, None]
    B = gram[:, others[:, None], others]
    return Linearisation(
        gram=B - np.swapaxes(C, 1, 2) @ np.linalg.solve(A, C),
        flight=data.flight,
        theta_scaled=theta_scaled,
        nuisances=nuisances,
    )
