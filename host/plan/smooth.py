"""A smooth spline through the nodes of a solved problem.

The solver's acceleration is continuous but its jerk jumps where an input does, and septic pieces through such
nodes overshoot. A B-spline of degree 7 with simple knots is C6; fitted to the nodes' positions and
velocities, with the waypoints and the rest at both ends as equalities, it leaves the nodes by well under a
millimetre. Its knots are the reference's nodes, so that the septic pieces of the reference are the spline
itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from host.plan.table import SPACING_S, Table, knot_times, round_times

Array = NDArray[np.float64]

_DEGREE = 7
_VELOCITY_S = 0.03  # weight of a velocity error against a position error


def fit(
    times_s: Array, p_ned: Array, v_ned: Array, waypoints: NDArray[np.int64], waypoints_ned: Array
) -> Table:
    """The node table of the spline nearest to the nodes in the least-squares sense.

    times_s: (n,) node times; p_ned, v_ned: (3, n); waypoints: index of each waypoint among the nodes, the
    first 0, the last n - 1; waypoints_ned: (K, 3). No leg has more pieces than intervals between its nodes.
    """
    waypoint_times = round_times(times_s[waypoints])
    step_s = float(times_s[-1]) / (len(times_s) - 1)
    knots_us = knot_times(waypoint_times, max(SPACING_S, step_s), np.diff(waypoints))
    knots = knots_us * 1e-6
    padded = np.concatenate([[knots[0]] * _DEGREE, knots, [knots[-1]] * _DEGREE])
    size = len(padded) - _DEGREE - 1
    basis = BSpline(padded, np.eye(size), _DEGREE)

    inside = np.clip(times_s, knots[0], knots[-1])
    rows = np.concatenate([basis(inside), _VELOCITY_S * basis(inside, nu=1)])
    wanted = np.concatenate([p_ned.T, _VELOCITY_S * v_ned.T])
    ends = knots[[0, -1]]
    equal = np.concatenate([basis(waypoint_times * 1e-6), *[basis(ends, nu=order) for order in (1, 2, 3)]])
    exact = np.concatenate([waypoints_ned, np.zeros((6, 3))])

    coefficients = _constrained_lstsq(rows, wanted, equal, exact)
    spline = BSpline(padded, coefficients, _DEGREE)
    states = np.concatenate([spline(knots, nu=order) for order in range(4)], axis=1)
    states[[0, -1], 3:] = 0.0
    return Table(times_us=knots_us, states_ned=states)


def _constrained_lstsq(rows: Array, wanted: Array, equal: Array, exact: Array) -> Array:
    """The x with equal x = exact that minimises |rows x - wanted|, by the null space of `equal`."""
    q, r = np.linalg.qr(equal.T, mode="complete")
    count = len(equal)
    particular = q[:, :count] @ np.linalg.solve(r[:count].T, exact)
    free = q[:, count:]
    found, *_ = np.linalg.lstsq(rows @ free, wanted - rows @ particular, rcond=None)
    return particular + free @ found
