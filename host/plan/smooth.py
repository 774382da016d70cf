"""A smooth spline through the nodes of a solved problem.

The solver's acceleration is continuous, but its jerk jumps where an input does, and septic pieces through
such nodes overshoot. A B-spline of degree 7 with simple knots is C6. It is fitted to the positions and
velocities of the nodes, with the waypoints and the end velocities as equalities, and deviates from the nodes
by well under a millimetre. Its knots are the nodes of the reference, so the septic pieces of the reference
are the spline itself.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import bmat, csr_matrix, identity, vstack
from scipy.sparse.linalg import splu

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
    knots_us = knot_times(waypoint_times, max(SPACING_S, step_s), np.diff(waypoints))
    knots = knots_us * 1e-6
    padded = np.concatenate([[knots[0]] * _DEGREE, knots, [knots[-1]] * _DEGREE])
    inside = np.clip(times_s, knots[0], knots[-1])
    rows = vstack([_basis(padded, inside), _VELOCITY_S * _basis(padded, inside, 1)])
    wanted = np.concatenate([p_ned.T, _VELOCITY_S * v_ned.T])
    ends = np.array([knots[0], knots[-1]])
    equal = vstack(
        [_basis(padded, waypoint_times * 1e-6), *[_basis(padded, ends, order) for order in (1, 2, 3)]]
    )
    exact = np.concatenate([waypoints_ned, end_velocities_ned, np.zeros((4, 3))])

    coefficients = _constrained_lstsq(rows, wanted, equal, exact)
    spline = BSpline(padded, coefficients, _DEGREE)
    states = np.concatenate([spline(knots, nu=order) for order in range(4)], axis=1)
    states[[0, -1], 3:6], states[[0, -1], 6:] = end_velocities_ned, 0.0
    return Table(times_us=knots_us, states_ned=states)


def _basis(padded: np.ndarray, at: np.ndarray, order: int = 0) -> csr_matrix:
    """Return the values (n, size) of every B-spline at n places, or of its derivative of this order."""
    size = len(padded) - _DEGREE - 1
    interval = np.clip(np.searchsorted(padded, at, side="right") - 1, _DEGREE, size - 1)
    columns = interval[:, None] + np.arange(-_DEGREE, 1)
    # One unit coefficient per residue class of the columns: no interval has two columns of one class.
    classes = np.zeros((size, _DEGREE + 1))
    classes[np.arange(size), np.arange(size) % (_DEGREE + 1)] = 1.0
    values = BSpline(padded, classes, _DEGREE)(at, nu=order)
    values = np.take_along_axis(values, columns % (_DEGREE + 1), axis=1)
    starts = (_DEGREE + 1) * np.arange(len(at) + 1)
    return csr_matrix((values.ravel(), columns.ravel(), starts), shape=(len(at), size))


def _constrained_lstsq(rows: Any, wanted: Array, equal: Any, exact: Array) -> Array:
    """Return the x that minimises |rows x - wanted| with equal x = exact, by the optimality conditions."""
    residuals, size = rows.shape
    # The residual r is an unknown, so nothing is squared: r + rows x = wanted, rows' r + equal' m = 0.
    system = bmat(
        [
            [identity(residuals), rows, None],
            [rows.T, None, equal.T],
            [None, equal, None],
        ],
        format="csc",
    )
    given = np.concatenate([wanted, np.zeros((size, wanted.shape[1])), exact])
    return splu(system).solve(given)[residuals : residuals + size]
