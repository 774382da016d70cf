"""A smooth spline through the nodes of a solved problem.

The solver's acceleration is continuous, but its jerk jumps where an input does, and septic pieces through
such nodes overshoot. A B-spline of degree 7 with simple knots is C6. It is fitted to the positions and
velocities of the nodes, with the waypoints and the end velocities as equalities, and deviates from the nodes
by well under a millimetre. Its knots are the nodes of the reference, so the septic pieces of the reference
are the spline itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from trimtab.host.plan.table import SPACING_S, Table, knot_times, round_times

Array = NDArray[np.float64]

_DEGREE = 7
_VELOCITY_S = 0.03  # weight of a velocity error against a position error


def fit(
    times_s: Annotated[np.ndarray, "nodes"],
    p_ned: Annotated[np.ndarray, "3 nodes"],
    v_ned: Annotated[np.ndarray, "3 nodes"],
    waypoints: Annotated[NDArray[np.int64], "waypoints"],
    waypoints_ned: Annotated[np.ndarray, "waypoints 3"],
    end_velocities_ned: Annotated[np.ndarray, "2 3"],
) -> Table:
    """Return the node table of the least-squares spline through the nodes.

    times_s: of the nodes. waypoints: index of each waypoint among the nodes; the first and the last node are
    waypoints. end_velocities_ned: at the start and at the end. Acceleration and jerk are 0 at both ends. No
    leg has more pieces than intervals.
    """
    waypoint_times = round_times(times_s[waypoints])
    step_s = float(times_s[-1]) / (len(times_s) - 1)
    spacing_s = max(SPACING_S, step_s)
    knots_us = knot_times(waypoint_times, spacing_s, np.diff(waypoints))
    knots = knots_us * 1e-6
    padded = np.concatenate([[knots[0]] * _DEGREE, knots, [knots[-1]] * _DEGREE])
    inside, ends = np.clip(times_s, knots[0], knots[-1]), knots[[0, -1]]
    rows = _stacked(
        _basis(padded, inside, p_ned.T),
        _basis(padded, inside, v_ned.T, order=1, scale=_VELOCITY_S),
    )
    equal = _stacked(
        _basis(padded, waypoint_times * 1e-6, waypoints_ned),
        _basis(padded, ends, end_velocities_ned, order=1, scale=spacing_s),
        _basis(padded, ends, np.zeros((2, 3)), order=2, scale=spacing_s**2),
        _basis(padded, ends, np.zeros((2, 3)), order=3, scale=spacing_s**3),
    )
    coefficients = _constrained_lstsq(rows, equal, len(padded) - _DEGREE - 1)
    spline = BSpline(padded, coefficients, _DEGREE)
    states = np.concatenate([spline(knots, nu=order) for order in range(4)], axis=1)
    states[[0, -1], 3:6], states[[0, -1], 6:] = end_velocities_ned, 0.0
    return Table(times_us=knots_us, states_ned=states)


@dataclass(frozen=True, kw_only=True)
class _Rows:
    """Linear equations for the coefficients, with _DEGREE + 1 adjacent coefficients in each.

    first: column of the first of them. values: their factors. wanted: right-hand sides.
    """

    first: Annotated[NDArray[np.int64], "rows"]
    values: Annotated[np.ndarray, "rows 8"]
    wanted: Annotated[np.ndarray, "rows 3"]


def _basis(
    padded: np.ndarray, at: np.ndarray, wanted: np.ndarray, order: int = 0, scale: float = 1.0
) -> _Rows:
    """Return the equations that the spline's derivative of this order has the wanted values, times `scale`.

    padded: knots. at: (rows,). wanted: (rows, 3).
    """
    size = len(padded) - _DEGREE - 1
    interval = np.clip(np.searchsorted(padded, at, side="right") - 1, _DEGREE, size - 1)
    columns = interval[:, None] + np.arange(-_DEGREE, 1)
    # One unit coefficient per residue class of the columns: no interval has two columns of one class.
    classes = np.zeros((size, _DEGREE + 1))
    classes[np.arange(size), np.arange(size) % (_DEGREE + 1)] = 1.0
    values = BSpline(padded, classes, _DEGREE)(at, nu=order)
    values = np.take_along_axis(values, columns % (_DEGREE + 1), axis=1)
    return _Rows(first=columns[:, 0], values=scale * values, wanted=scale * wanted)


def _stacked(*parts: _Rows) -> _Rows:
    """Return all equations in one."""
    return _Rows(
        first=np.concatenate([part.first for part in parts]),
        values=np.concatenate([part.values for part in parts]),
        wanted=np.concatenate([part.wanted for part in parts]),
    )


def _constrained_lstsq(rows: _Rows, equal: _Rows, size: int) -> Array:
    """Return the coefficients (size, 3) that solve `rows` in least squares and `equal` exactly.

    The equalities also count as rows. This does not change the solution, and the normal equations are
    positive definite even where the rows alone do not determine it.
    """
    both = _stacked(rows, equal)
    row, column = np.tril_indices(_DEGREE + 1)
    products = both.values[:, row] * both.values[:, column]
    places = (row - column) * size + column + both.first[:, None]
    band = np.bincount(places.ravel(), products.ravel(), (_DEGREE + 1) * size).reshape(-1, size)
    factor = cholesky_banded(band, lower=True), True

    columns = (both.first[:, None] + np.arange(_DEGREE + 1)).ravel()
    moments = [np.bincount(columns, (both.values * each[:, None]).ravel(), size) for each in both.wanted.T]
    constraints = np.zeros((len(equal.first), size))
    np.put_along_axis(constraints, equal.first[:, None] + np.arange(_DEGREE + 1), equal.values, axis=1)
    solved = cho_solve_banded(factor, np.concatenate([moments, constraints]).T)
    free, shifts = solved[:, :3], solved[:, 3:]
    return free + shifts @ np.linalg.solve(constraints @ shifts, equal.wanted - constraints @ free)
