"""Minimum-snap splines of degree 7 through any number of waypoints.

Between two waypoints the path is the septic that meets position, velocity, acceleration and jerk at both
ends. The derivatives at the inner waypoints are free and follow from one symmetric positive definite solve of
a chain of 3 x 3 blocks (Bry et al., IJRR 2015, "free end derivatives"). By the natural conditions of the
problem the optimum is C6 at every inner waypoint.

Time is in units of the mean leg, and every unknown is scaled to a unit diagonal. The solve therefore stays
well conditioned for hundreds of legs whose durations differ by orders of magnitude. Cost and memory are
linear in the number of legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trimtab.host.plan.descent import minimise_in_box

Array = NDArray[np.float64]

_DERIVATIVES = 4  # p, v, a, j at each end
REST = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))  # velocities at both ends
_SHARE_FACTOR = 3.0  # how far optimise_durations may move a leg's share of the time, both ways


def _septic_basis() -> list[list[Fraction]]:
    """Return an 8 x 8 matrix: column c is the septic on [0, 1], by monomials, whose c-th end value is one.

    End values are in the order p0, v0, a0, j0, p1, v1, a1, j1, derivatives with respect to the unit interval.
    """

    def row(at: int, derivative: int) -> list[Fraction]:
        out = []
        for power in range(8):
            factor = 1
            for step in range(derivative):
                factor *= power - step
            out.append(Fraction(factor if at == 1 or power == derivative else 0))
        return out

    system = [row(at, derivative) for at in (0, 1) for derivative in range(_DERIVATIVES)]
    size = len(system)
    work = [line + [Fraction(int(i == j)) for j in range(size)] for i, line in enumerate(system)]
    for column in range(size):
        pivot = next(r for r in range(column, size) if work[r][column] != 0)
        work[column], work[pivot] = work[pivot], work[column]
        lead = work[column][column]
        work[column] = [value / lead for value in work[column]]
        for r in range(size):
            if r != column and work[r][column] != 0:
                factor = work[r][column]
                work[r] = [a - factor * b for a, b in zip(work[r], work[column], strict=True)]
    return [line[size:] for line in work]


def _snap_gram() -> Array:
    """Return the 8 x 8 matrix G: y' G y is the integral of squared snap over [0, 1] for end values y."""
    basis = _septic_basis()

    def moment(i: int, j: int) -> Fraction:
        if i < 4 or j < 4:
            return Fraction(0)
        falling = 1
        for step in range(4):
            falling *= (i - step) * (j - step)
        return Fraction(falling, i + j - 7)

    weighted = [
        [sum((moment(i, j) * basis[j][b] for j in range(4, 8)), Fraction(0)) for b in range(8)]
        for i in range(8)
    ]
    gram = [
        [sum((basis[i][a] * weighted[i][b] for i in range(4, 8)), Fraction(0)) for b in range(8)]
        for a in range(8)
    ]
    return np.array([[float(value) for value in line] for line in gram])


_GRAM = _snap_gram()
_POWERS = np.array([0, 1, 2, 3, 0, 1, 2, 3])


@dataclass(frozen=True, kw_only=True)
class SnapSpline:
    """Waypoint times, the end values of the septics between them, and the integral of the squared snap.

    ends_ned: position, velocity, acceleration, jerk; cost in m^2/s^7.
    """

    times_s: Annotated[np.ndarray, "waypoints"]
    ends_ned: Annotated[np.ndarray, "waypoints 4 3"]
    cost: float


def _checked(waypoints_ned: Array, durations_s: Array) -> tuple[Array, Array]:
    waypoints = np.asarray(waypoints_ned, dtype=float)
    durations = np.asarray(durations_s, dtype=float)
    if waypoints.ndim != 2 or waypoints.shape[1] != 3 or len(waypoints) < 2:
        raise ValueError(f"waypoints must be (K >= 2, 3), got {waypoints.shape}")
    if durations.shape != (len(waypoints) - 1,):
        raise ValueError(
            f"{len(waypoints)} waypoints need {len(waypoints) - 1} durations, got {durations.shape}"
        )
    if not (np.isfinite(waypoints).all() and np.isfinite(durations).all() and (durations > 0).all()):
        raise ValueError("waypoints must be finite and durations finite and positive")
    return waypoints, durations


def solve_snap(
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"],
    durations_s: Annotated[np.ndarray, "legs"],
    end_velocities_ned: ArrayLike = REST,
) -> SnapSpline:
    """Return the minimum-snap spline through the waypoints, with a = j = 0 at both ends.

    waypoints_ned: two or more, m. end_velocities_ned: (2, 3) m/s at start and end, at rest by default. Raises
    ValueError for wrong shapes, non-finite values and durations that are not positive. Source: Mellinger and
    Kumar, ICRA 2011; Bry et al., IJRR 2015.
    """
    waypoints, durations = _checked(waypoints_ned, durations_s)
    unit_s = float(durations.mean())
    legs = durations / unit_s
    scale = legs[:, None] ** _POWERS
    blocks = scale[:, :, None] * _GRAM * scale[:, None, :] / legs[:, None, None] ** 7

    ends = np.zeros((len(waypoints), 4, 3))
    ends[:, 0] = waypoints
    ends[[0, -1], 1] = np.asarray(end_velocities_ned, dtype=float) * unit_s
    if len(waypoints) > 2:
        ends[1:-1, 1:] = _inner_derivatives(blocks, ends)
    values = np.concatenate([ends[:-1], ends[1:]], axis=1)
    cost = float((values * (blocks @ values)).sum()) / unit_s**7
    ends[:, 1:] /= unit_s ** np.arange(1, 4)[:, None]
    return SnapSpline(times_s=np.concatenate([[0.0], np.cumsum(durations)]), ends_ned=ends, cost=cost)


def _inner_derivatives(blocks: Array, ends: Array) -> Array:
    """Return velocity, acceleration and jerk (K - 2, 3, 3) at the inner waypoints of least cost.

    ends: (K, 4, 3) with the waypoints, and the derivatives at the first and the last waypoint.
    """
    waypoints = ends[:, 0]
    diagonal = blocks[:-1, 5:8, 5:8] + blocks[1:, 1:4, 1:4]
    coupling = blocks[1:-1, 1:4, 5:8]  # rows: this inner waypoint, columns: the next
    middle = blocks[:-1, 5:8, 4] + blocks[1:, 1:4, 0]
    right = -(
        blocks[:-1, 5:8, 0, None] * waypoints[:-2, None]
        + middle[:, :, None] * waypoints[1:-1, None]
        + blocks[1:, 1:4, 4, None] * waypoints[2:, None]
    )
    right[0] -= blocks[0, 5:8, 1:4] @ ends[0, 1:]
    right[-1] -= blocks[-1, 1:4, 5:8] @ ends[-1, 1:]
    weight = 1.0 / np.sqrt(np.einsum("maa->ma", diagonal))
    diagonal *= weight[:, :, None] * weight[:, None, :]
    coupling = coupling * weight[:-1, :, None] * weight[1:, None, :]
    return weight[:, :, None] * _solve_chain(diagonal, coupling, weight[:, :, None] * right)


def _solve_chain(diagonal: Array, coupling: Array, right: Array) -> Array:
    """Return x (n, 3, c) of a symmetric positive definite system with 3 x 3 blocks along the diagonal.

    coupling: the n - 1 blocks above the diagonal. Every second unknown is eliminated, until one is left.
    """
    if len(diagonal) == 1:
        return np.linalg.solve(diagonal, right).astype(np.float64, copy=False)
    above, below = coupling[::2], coupling[1::2]  # before and after each eliminated unknown; the last may be
    between, count = len(below), len(above)  # without one after it
    after = np.concatenate([below, np.zeros((count - between, 3, 3))])
    given = np.concatenate([above.swapaxes(1, 2), after, right[1::2]], axis=2)
    solved = np.linalg.solve(diagonal[1::2], given)
    of_before, of_after, of_right = solved[..., :3], solved[:between, :, 3:6], solved[..., 6:]
    kept, kept_right = diagonal[::2].copy(), right[::2].copy()
    kept[:count] -= above @ of_before
    kept[1:] -= below.swapaxes(1, 2) @ of_after
    kept_right[:count] -= above @ of_right
    kept_right[1:] -= below.swapaxes(1, 2) @ of_right[:between]
    out = np.empty_like(right)
    out[::2] = _solve_chain(kept, -above[:between] @ of_after, kept_right)
    out[1::2] = of_right - of_before @ out[::2][:count]
    out[1::2][:between] -= of_after @ out[2::2]
    return out


def cost_gradient(spline: SnapSpline) -> Annotated[np.ndarray, "legs"]:
    """Return the derivative of the optimal cost by each leg's duration.

    By the envelope theorem the end values may be constant: only the cost matrix of the leg changes.
    """
    durations = np.diff(spline.times_s)
    ends = np.concatenate([spline.ends_ned[:-1], spline.ends_ned[1:]], axis=1)
    scale = durations[:, None] ** _POWERS
    slope = _POWERS * durations[:, None] ** np.maximum(_POWERS - 1, 0)
    values = scale[:, :, None] * ends
    weighted = _GRAM @ values
    cost = (values * weighted).sum(axis=(1, 2))
    change = (slope[:, :, None] * ends * weighted).sum(axis=(1, 2))
    return -7.0 * cost / durations**8 + 2.0 * change / durations**7


def heuristic_durations(
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"], total_s: float
) -> Annotated[np.ndarray, "legs"]:
    """Return durations in proportion to length, with extra time to start and to stop.

    A tenth of the mean leg is added to every length, so that legs between equal waypoints get time too.
    """
    waypoints = np.asarray(waypoints_ned, dtype=float)
    length = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    weight = length + 0.1 * length.mean() if length.any() else np.ones(len(length))
    if len(weight) > 2:
        weight[0] *= 1.35
        weight[-1] *= 1.35
    return weight / weight.sum() * total_s


def optimise_durations(
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"],
    total_s: float,
    end_velocities_ned: ArrayLike = REST,
    *,
    iterations: int = 100,
) -> Annotated[np.ndarray, "legs"]:
    """Return the durations of the given sum that minimise the snap cost.

    BFGS on the logarithm of the cost over the logarithms of the shares, with the exact gradient, from the
    heuristic durations. A share changes by at most a factor of three. Deterministic.
    """
    start = heuristic_durations(waypoints_ned, total_s)
    if len(start) == 1:
        return start

    def objective(log_share: Array) -> tuple[float, Array]:
        share = np.exp(log_share - log_share.max())
        share /= share.sum()
        spline = solve_snap(waypoints_ned, share * total_s, end_velocities_ned)
        slope = cost_gradient(spline) / spline.cost * total_s
        return float(np.log(spline.cost)), share * (slope - share @ slope)

    if solve_snap(waypoints_ned, start, end_velocities_ned).cost == 0.0:
        return start
    log_start = np.log(start / total_s)
    reach = np.log(_SHARE_FACTOR)
    optimum = minimise_in_box(
        objective,
        log_start,
        log_start - reach,
        log_start + reach,
        iterations=iterations,
        decrease=1e-9,
        slope=1e-7,
    )
    share = np.exp(optimum - optimum.max())
    return share / share.sum() * total_s
