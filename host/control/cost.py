"""The cost of the tracking problem: squared deviations from targets, and a soft limit of the tilt."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

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
    size: int = 40


COST = CostPlaces()


def cost_terms(*, terminal: bool) -> ca.Function:
    """Return (x, u, reference, cost) -> value, gradient in x, in u, Hessian in x (Gauss-Newton)."""
    x, u = ca.SX.sym("x", STATES), ca.SX.sym("u", INPUTS)
    reference, cost = ca.SX.sym("reference", STATES + INPUTS), ca.SX.sym("cost", COST.size)
    weight = cost[COST.terminal if terminal else COST.state]
    error, input_error = x - reference[:STATES], u - reference[STATES:]
    if terminal:
        input_error = ca.SX(INPUTS, 1)
    tilt_cos = ca.cos(x[THETA.start]) * ca.cos(x[THETA.start + 1])
    shortfall = ca.fmax(cost[COST.tilt_cos] - tilt_cos, 0.0)
    value = 0.5 * (
        ca.dot(weight, error * error)
        + ca.dot(cost[COST.input], input_error * input_error)
        + cost[COST.tilt] * shortfall * shortfall
    )
    by_shortfall = ca.jacobian(shortfall, x)
    hessian = ca.diag(weight) + cost[COST.tilt] * by_shortfall.T @ by_shortfall
    outputs = [value, ca.densify(ca.gradient(value, x)), cost[COST.input] * input_error, ca.densify(hessian)]
    name = "terminal_cost" if terminal else "stage_cost"
    return ca.Function(name, [x, u, reference, cost], outputs, {"cse": True})
