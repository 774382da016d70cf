"""The tracking error that a model predicts: six more states of the planner, and the cost of min-error.

The flatness-based law answers a position error with the gains of its position loop (paper section III-B). Let
d be the residual acceleration that the law does not know, less its value at rest. The vehicle then leaves its
reference by e, with

    e'' = d(x) - k_p e - k_v e'.

The loop is a low-pass: it answers a slow residual with its full error d / k_p, a fast one with less. The axes
also differ in stiffness. A plan with the least mean squared e therefore differs from one with the least mean
squared d (paper eq. 10), which weighs all frequencies and axes alike. Attitude loop, delays and observer are
left out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import casadi as ca
import numpy as np

from trimtab.host.models.airframe import STATE_SIZE
from trimtab.host.shooting.problem import Problem
from trimtab.host.vehicle import Vehicle

ERROR, ERROR_RATE = slice(STATE_SIZE, STATE_SIZE + 3), slice(STATE_SIZE + 3, STATE_SIZE + 6)
"""Position error e_ned, m, and its rate, m/s, in the state."""
ERROR_STATES = ERROR_RATE.stop - ERROR.start


def error_derivative(vehicle: Vehicle, x: ca.SX, d_ned: ca.SX) -> list[Any]:
    """Return the derivatives (3,) and (3,) of error and error rate in a state x (22,) under d_ned (3,)."""
    k_p, k_v = ca.DM(vehicle.gains.position_p), ca.DM(vehicle.gains.velocity_d)
    return [x[ERROR_RATE], d_ned - k_p * x[ERROR] - k_v * x[ERROR_RATE]]


def error_cost(vehicle: Vehicle, x: ca.SX) -> ca.SX:
    """Return the squared error in units of a squared residual, m^2/s^4.

    A constant horizontal residual costs what it costs in min-residual.
    """
    stiffness = float(np.mean(vehicle.gains.position_p[:2]))
    return stiffness**2 * ca.sumsqr(x[ERROR])


def with_error(problem: Problem) -> Problem:
    """Return the problem with error and error rate as states: zero at the first node, free afterwards."""
    start, bounds = problem.x_start, problem.x_bounds
    free = np.full((ERROR_STATES, start.shape[1]), np.inf)
    free[:, 0] = 0.0
    return replace(
        problem,
        x_start=_padded(start),
        x_bounds=(np.vstack([bounds[0], -free]), np.vstack([bounds[1], free])),
    )


def _padded(x: Annotated[np.ndarray, "states nodes"]) -> Annotated[np.ndarray, "22 nodes"]:
    """Return states with error and error rate; those of an earlier solution have them already."""
    missing = ERROR_RATE.stop - len(x)
    return np.vstack([x, np.zeros((missing, x.shape[1]))])
