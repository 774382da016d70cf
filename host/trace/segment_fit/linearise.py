"""Linearisation of command-driven segments with free initial states.

Each lane is one roll-out of a segment: the base roll-out, or one with a single perturbed input. The perturbed
inputs are components of the initial state, scaled parameters, nuisances and components of the disturbance in
a bin. Differences of the lanes are the columns of the Jacobian. All lanes advance together through the
program of `trimtab.host.trace.segment_fit.model`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.base import parallel
from trimtab.host.models import dynamics
from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.data.signals import nominal_thrust
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.linearisation import Linearisation, OwnGrams
from trimtab.host.trace.segment_fit.model import STATES, SegmentModel
from trimtab.host.trace.segment_fit.rollout import remembered_by_flight, residuals, roll_out

Result = TypeVar("Result")

_STORED = 200
"""Segments whose columns of the basis are stored, which take about 70 MB."""

_PART = 32
"""Segments of a flight that are rolled out together."""

_THINNED = 4
"""`residuals_alone` looks at one of this many segments."""

_X_STEP = np.full(STATES, 1e-6)
TURN_STEPS = 6
"""Steps between the poses that give a body rate. More average attitude noise, fewer follow fast turns."""

_NUISANCE_STEP = 1e-5
_BIN_STEP = np.full(6, 1e-5)
_THETA_STEP = 1e-5
"""Step of the difference quotients, scaled. It must be small: attitude responds so strongly to torque that
with coarse steps the columns of similar effects are no longer parallel. Terms that should cancel would then
look like information."""


@dataclass(frozen=True, kw_only=True)
class Basis:
    """Columns of the Jacobian that hardly depend on the parameters and are reused between refits.

    Those of the first flights are stored. Those of all of many flights would fill the memory, so the others
    are rolled out again when they are needed, which gives the same bits.

    theta_scaled, nuisances: scaled parameters, and nuisances of each flight. x0, disturbance_frd: initial
    states and disturbance of the segments. memory: of `remembered` there.
    """

    theta_scaled: Annotated[np.ndarray, "columns"]
    nuisances: Annotated[np.ndarray, "flights nuisances"]
    x0: Annotated[np.ndarray, "segments 12"]
    disturbance_frd: Annotated[np.ndarray, "segments bins 6"]
    memory: Annotated[np.ndarray, "memory 1 segments"]
    _stored: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, init=False, repr=False)

    def columns(
        self,
        segment_model: SegmentModel,
        part: Segments,
        segments: Annotated[np.ndarray, "part"],
        flight: int,
    ) -> tuple[
        Annotated[np.ndarray, "part unknowns residuals"], Annotated[np.ndarray, "part unknowns unknowns"]
    ]:
        """Return the columns of some segments of a flight, in units of sigma, and their Grams.

        They are 12 of the initial state, those of the nuisances and 6 of the disturbance in each bin. part:
        the segments with the indices `segments`.
        """
        key = int(segments[0])
        stored = self._stored.get(key)
        if stored is None:
            columns = self._taken(segment_model, part, segments, flight)
            stored = columns, columns @ np.swapaxes(columns, 1, 2)
            if segments[-1] < _STORED:
                self._stored[key] = stored
        return stored

    def _taken(
        self, segment_model: SegmentModel, part: Segments, segments: np.ndarray, flight: int
    ) -> np.ndarray:
        """Return the columns of some segments, rolled out."""
        part = part.with_x0(self.x0[segments]).with_w(self.disturbance_frd[segments])
        memory = self.memory[:, :, segments]
        constant = segment_model.nuisances
        count = 1 + STATES + constant + 6 * part.bins
        theta_scaled = segment_model.space.of_flight(self.theta_scaled, flight)
        lanes = _Lanes(part, part.x0, theta_scaled, self.nuisances[flight], memory, count)
        steps = [_X_STEP, np.full(constant, _NUISANCE_STEP), np.tile(_BIN_STEP, part.bins)]
        lanes.steps[1:] = np.concatenate(steps)
        for i in range(STATES):
            lanes.x0[i, 1 + i] += _X_STEP[i]
        first = 1 + STATES
        for i in range(constant):
            lanes.nuisances[i, first + i] += _NUISANCE_STEP
        first += constant
        for b in range(part.bins):
            for i in range(6):
                lanes.bins[b, i, first + 6 * b + i] = _BIN_STEP[i]
        return lanes.jacobian(segment_model, part, bins=True)[:, 1:]


class _Lanes:
    """`count` lanes of every segment of a flight that start at one point, to be perturbed one by one."""

    def __init__(
        self,
        data: Segments,
        x0: Annotated[np.ndarray, "segments 12"],
        theta_scaled: Annotated[np.ndarray, "parameters"],
        nuisances: Annotated[np.ndarray, "nuisances"],
        memory: Annotated[np.ndarray, "memory _ segments"],
        count: int,
    ) -> None:
        self.x0 = np.repeat(x0.T[:, None, :], count, axis=1)
        self.theta_scaled = np.repeat(theta_scaled[:, None], count, axis=1)
        self.memory = np.broadcast_to(memory, (len(memory), count, len(data.flight)))
        self.nuisances = np.broadcast_to(
            nuisances[:, None, None], (len(nuisances), *self.x0.shape[1:])
        ).copy()
        self.bins = np.zeros((data.bins, 6, count))
        self.steps = np.ones(count)

    def residuals(
        self,
        segment_model: SegmentModel,
        data: Segments,
        bins: Annotated[np.ndarray, "bins 6 lanes"] | None = None,
    ) -> Annotated[np.ndarray, "lanes segments residuals"]:
        """Return the residual of every lane. bins: disturbance that is added to the lanes."""
        predicted = roll_out(
            segment_model, data, self.x0, self.theta_scaled, self.nuisances, bins, self.memory
        )
        return residuals(data, predicted)

    def jacobian(
        self, segment_model: SegmentModel, data: Segments, *, bins: bool
    ) -> Annotated[np.ndarray, "segments lanes residuals"]:
        """Return the residual in lane 0, its negative slopes by the perturbation in others.

        bins: whether lanes perturb the disturbance.
        """
        r = self.residuals(segment_model, data, self.bins if bins else None)
        A = (r[0] - r) / self.steps[:, None, None]
        A[0] = r[0]
        return np.swapaxes(A, 0, 1)


def basis(
    segment_model: SegmentModel,
    data: Segments,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    nuisances: Annotated[np.ndarray, "flights nuisances"],
) -> Basis:
    """Return the basis at scaled parameters, nuisances and the initial states and disturbance of `data`."""
    return Basis(
        theta_scaled=theta_scaled,
        nuisances=nuisances,
        x0=data.x0,
        disturbance_frd=data.disturbance_frd,
        memory=remembered_by_flight(segment_model, data, _points(segment_model, theta_scaled)),
    )


def _points(
    segment_model: SegmentModel,
    theta_scaled: Annotated[np.ndarray, "columns"],
    active: Sequence[int] | np.ndarray = (),
) -> Callable[[int], Annotated[np.ndarray, "parameters lanes"]]:
    """Return the parameters of the roll-outs of a flight: at theta_scaled, then with each `active` moved."""

    def of_flight(flight: int) -> np.ndarray:
        point = segment_model.space.of_flight(theta_scaled, flight)
        points = np.repeat(point[:, None], 1 + len(active), axis=1)
        points[active, 1 + np.arange(len(active))] += _THETA_STEP
        return points

    return of_flight


def _each_part(
    segment_model: SegmentModel, data: Segments, work: Callable[[Segments, np.ndarray, int], Result]
) -> list[Result]:
    """Return `work` of parts of the data, their indices (segments,) and the index of their flight.

    A part holds up to _PART segments of one flight, in order.
    """
    parts = []
    for flight in np.unique(data.flight).tolist():
        segments = np.flatnonzero(data.flight == flight)
        parts += [(segments[i : i + _PART], flight) for i in range(0, len(segments), _PART)]

    def of(part: tuple[np.ndarray, int]) -> Result:
        segments, flight = part
        return work(data.of_flight(flight, segments), segments, flight)

    return parallel.each(of, parts, segment_model.jobs)


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
    nuisances: Annotated[np.ndarray, "flights nuisances"],
    basis: Basis,
    iterations: int = 1,
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
    """
    x0 = data.x0.copy()
    memory = remembered_by_flight(segment_model, data, _points(segment_model, theta_scaled))

    def fit(part: Segments, segments: np.ndarray, flight: int) -> None:
        columns = basis.columns(segment_model, part, segments, flight)
        for _ in range(iterations):
            point = segment_model.space.of_flight(theta_scaled, flight)
            x = _stepped_x0(segment_model, part, point, nuisances[flight], columns, memory[:, :, segments])
            part = part.with_x0(x)
        x0[segments] = part.x0

    _each_part(segment_model, data, fit)
    return x0


def _stepped_x0(
    segment_model: SegmentModel,
    part: Segments,
    theta_scaled: np.ndarray,
    nuisances: np.ndarray,
    columns: tuple[np.ndarray, np.ndarray],
    memory: np.ndarray,
) -> np.ndarray:
    """Return the initial states (segments, 12) after a Gauss-Newton step towards the measurements.

    theta_scaled: of the roll-outs. columns: of the basis, and their Grams. memory: of `remembered`.
    """
    lanes = _Lanes(part, part.x0, theta_scaled, nuisances, memory, 1)
    return part.x0 + _x0_step(lanes.residuals(segment_model, part), columns)[0]


def _x0_step(residual: np.ndarray, columns: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the Gauss-Newton steps (lanes, segments, 12) of initial states that reduce `residual`.

    residual: (lanes, segments, residuals). columns: of the basis, and their Grams.
    """
    states, gram = (each[:, :STATES] for each in columns)
    normal = gram[:, :, :STATES] + 1e-9 * np.eye(STATES)
    return np.linalg.solve(normal, states @ residual[..., None])[..., 0]


def residuals_alone(
    segment_model: SegmentModel,
    data: Segments,
    points: Annotated[np.ndarray, "points parameters"],
    nuisances: Annotated[np.ndarray, "flights nuisances"],
    basis: Basis,
) -> list[Linearisation]:
    """Return the linearisations at several points without parameters, whose slopes take most of the time.

    They hold one of _THINNED segments. The states of effects are those of the basis. Arguments are those of
    `linearise`.
    """
    picked = np.arange(0, len(data.flight), _THINNED)
    piece, piece_flight = _pieces(data.flight, len(nuisances))
    lins = [
        Linearisation.blank(
            data.bins,
            piece=piece[picked],
            piece_flight=piece_flight,
            theta_scaled=np.zeros(0),
            nuisances=nuisances,
            jobs=segment_model.jobs,
        )
        for _ in points
    ]

    def reduce(part: Segments, segments: np.ndarray, flight: int) -> list[OwnGrams]:
        inside = segments % _THINNED == 0
        if not inside.any():
            return [[] for _ in points]
        columns = basis.columns(segment_model, part, segments, flight)
        columns = columns[0][inside], columns[1][inside]
        segments = segments[inside]
        part, memory = data.of_flight(flight, segments), basis.memory[:, :, segments]
        of_flight = np.stack([segment_model.space.of_flight(point, flight) for point in points], axis=1)
        lanes = _Lanes(part, part.x0, of_flight[:, 0], nuisances[flight], memory, len(points))
        lanes.theta_scaled = of_flight
        lanes.x0 += _x0_step(lanes.residuals(segment_model, part), columns).transpose(2, 0, 1)
        own = []
        for lin, r in zip(lins, lanes.residuals(segment_model, part), strict=True):
            r = _with_disturbance(r[:, None], segment_model, part, columns[0])
            own.append(lin.reduce(segments // _THINNED, _without_x0(_gram(r, columns), 1)))
        return own

    for parts in _each_part(segment_model, data, reduce):
        for lin, own in zip(lins, parts, strict=True):
            lin.add(own)
    return lins


def _with_disturbance(
    A: np.ndarray, segment_model: SegmentModel, part: Segments, columns: np.ndarray
) -> np.ndarray:
    """Return A (segments, n, residuals) with the disturbance added to its first column, the residual."""
    w = part.disturbance_frd.reshape(len(A), 1, -1)
    A[:, 0] += (w @ columns[:, STATES + segment_model.nuisances :])[:, 0]
    return A


def _gram(A: np.ndarray, columns: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the Grams of A (segments, n, residuals) and the columns of the basis."""
    cross = A @ np.swapaxes(columns[0], 1, 2)
    return np.block([[A @ np.swapaxes(A, 1, 2), cross], [np.swapaxes(cross, 1, 2), columns[1]]])


def linearise(
    segment_model: SegmentModel,
    data: Segments,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    nuisances: Annotated[np.ndarray, "flights nuisances"],
    basis: Basis,
) -> tuple[Linearisation, Annotated[np.ndarray, "segments 12"]]:
    """Return the linearisation at scaled parameters and nuisances, and its initial states.

    The initial states first take one Gauss-Newton step towards the measurements of their segment. Then they
    are projected out, since they are free. basis: gives the columns that are not taken at this point.
    """
    space = segment_model.space
    count, active = 1 + len(space.rolled.columns), space.active(theta_scaled)
    taken = np.concatenate([[0], 1 + active])
    piece, piece_flight = _pieces(data.flight, len(nuisances))
    points_of = _points(segment_model, theta_scaled, active)
    memory = remembered_by_flight(segment_model, data, points_of)
    x0 = data.x0.copy()

    lin = Linearisation.blank(
        data.bins,
        piece=piece,
        piece_flight=piece_flight,
        theta_scaled=theta_scaled,
        nuisances=nuisances,
        freedom=data.measured_values - STATES * len(data.flight),
        jobs=segment_model.jobs,
    )

    def reduce(part: Segments, segments: np.ndarray, flight: int) -> tuple[OwnGrams, np.ndarray]:
        columns = basis.columns(segment_model, part, segments, flight)
        starts, points = memory[:, :, segments], points_of(flight)
        x0[segments] = _stepped_x0(
            segment_model, part, points[:, 0], nuisances[flight], columns, starts[:, :1]
        )
        lanes = _Lanes(part, x0[segments], points[:, 0], nuisances[flight], starts, len(taken))
        lanes.steps[1:] = _THETA_STEP
        lanes.theta_scaled = points
        slopes = lanes.jacobian(segment_model, part, bins=False)
        A = np.zeros((len(segments), count, slopes.shape[2]))
        A[:, taken] = slopes
        A = _with_disturbance(A, segment_model, part, columns[0])
        sizes = np.einsum("spn,spn->p", A, A)
        gram = space.expanded(_without_x0(_gram(A, columns), count), flight)
        return lin.reduce(segments, gram), sizes

    parts, sizes = zip(*_each_part(segment_model, data, reduce), strict=True)
    space.rolled.check_finite(np.sum(sizes, axis=0))
    for own in parts:
        lin.add(own)
    return lin, x0


def _pieces(flight: np.ndarray, flights: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the index of the piece of each segment, and of the flight of each piece.

    A flight is one piece, or is cut into RULES.widening_pieces if there are fewer flights than that.
    """
    if flights >= RULES.widening_pieces:
        return flight, np.arange(flights)
    part = np.empty(len(flight), dtype=int)
    for index in range(flights):
        segments = np.flatnonzero(flight == index)
        part[segments] = np.arange(len(segments)) * RULES.widening_pieces // max(len(segments), 1)
    ids, piece = np.unique(flight * RULES.widening_pieces + part, return_inverse=True)
    return piece, ids // RULES.widening_pieces


def _without_x0(gram: np.ndarray, first: int) -> np.ndarray:
    """Return Grams (segments, n, n) with the columns of the initial state, from `first` on, projected out."""
    states, others = np.arange(first, first + STATES), np.r_[0:first, first + STATES : gram.shape[1]]
    A = gram[:, states[:, None], states]
    scale = np.sqrt(np.einsum("sii->si", A)) + 1e-12
    A = A / scale[:, :, None] / scale[:, None, :] + 1e-10 * np.eye(STATES)
    C = gram[:, states[:, None], others] / scale[:, :, None]
    B = gram[:, others[:, None], others]
    return B - np.swapaxes(C, 1, 2) @ np.linalg.solve(A, C)
