"""The cost of the tracking problem: squared deviations from targets, and a soft limit of the tilt."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import casadi as ca
import numpy as np

from trimtab.host.control.dynamics import INPUTS, STATES
from trimtab.host.models.airframe import THETA


class CostPlaces(NamedTuple):
    """Places of the cost's parameters in their vector.

    state, terminal: weights of the squared deviation of the states (13). input: of the inputs (4). tilt: of
    the squared shortfall of cos(tilt) below `tilt_cos`. low, high: bounds of the inputs (4).
    """

    state: slice = slice(0, 13)
    terminal: slice = slice(13, 26)
    input: slice = slice(26, 30)
    tilt: int = 30
    tilt_cos: int = 31
    low: slice = slice(32, 36)
    high: slice = slice(36, 40)


COST = CostPlaces()
STAGE_SIZE = STATES + INPUTS + 2
"""Number of a stage's parameters: the weights of states and inputs, that of the tilt, and its limit."""


def stage_parameters(
    cost: Annotated[np.ndarray, "parameters"], stages: int
) -> Annotated[np.ndarray, "parameters stages+1"]:
    """Return the parameters of the stages, and those of one more, whose states are at the horizon's end."""
    shared = [*cost[COST.input], cost[COST.tilt], cost[COST.tilt_cos]]
    columns = [np.append(cost[COST.state], shared)] * stages + [np.append(cost[COST.terminal], shared)]
    return np.column_stack(columns)


def stage_cost(x: ca.SX, u: ca.SX, target: ca.SX, p: ca.SX) -> ca.SX:
    """Return the cost of a stage. target: of states and inputs (17); p: column of `stage_parameters`."""
    error = ca.vertcat(x, u) - target
    tilt, tilt_cos = p[STATES + INPUTS], p[STATES + INPUTS + 1]
    shortfall = ca.fmax(tilt_cos - ca.cos(x[THETA.start]) * ca.cos(x[THETA.start + 1]), 0.0)
    return 0.5 * (ca.dot(p[: STATES + INPUTS], error * error) + tilt * shortfall * shortfall)
