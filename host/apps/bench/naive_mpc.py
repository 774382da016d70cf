"""The tracking problem of the MPC in the usual CasADi style: `map`, CasADi's derivatives, Ipopt with MUMPS.

Model, cost, bounds and horizon are those of the given controller. The network consists of matrix products.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.host.apps.bench.naive import SOLVED, ipopt
from trimtab.host.control.cost import COST
from trimtab.host.control.dynamics import INPUTS, NETWORK_STATE, STATES, ControlModel
from trimtab.host.models.airframe import THETA

Array = NDArray[np.float64]

_MOST_S = 10.0
_TOLERANCE = 1e-6


class NaiveMpc:
    """The problem, solved from its last solution."""

    def __init__(self, model: ControlModel, *, stages: int, step_s: float, cost: Array) -> None:
        x, u = ca.MX.sym("x", STATES, stages + 1), ca.MX.sym("u", INPUTS, stages)
        x0, targets = ca.MX.sym("x0", STATES), ca.MX.sym("targets", STATES + INPUTS, stages + 1)
        step = _step(model, step_s)
        terms = _stage_cost(cost).map(stages)(x[:, :-1], u, targets[:, :-1])
        total = ca.sum2(terms) + _terminal_cost(cost)(x[:, -1], targets[:STATES, -1])
        gaps = ca.veccat(x[:, 0] - x0, x[:, 1:] - step.map(stages)(x[:, :-1], u))
        nlp = {"x": ca.veccat(x, u), "p": ca.veccat(x0, targets), "f": total, "g": gaps}
        self._solver = ca.nlpsol("naive_mpc", "ipopt", nlp, ipopt(_TOLERANCE, _MOST_S))
        free = np.full(STATES * (stages + 1), np.inf)
        self._low = np.concatenate([-free, np.tile(cost[COST.low], stages)])
        self._high = np.concatenate([free, np.tile(cost[COST.high], stages)])
        self._states = STATES * (stages + 1)
        self._start: Array | None = None

    def solve(self, x0: Array, targets: Array) -> Array | None:
        """Return the first inputs (4) for a state (13) and targets (N + 1, 17); None if it fails."""
        if self._start is None:
            self._start = np.concatenate([targets[:, :STATES].ravel(), targets[:-1, STATES:].ravel()])
        found = self._solver(
            x0=self._start,
            p=np.concatenate([x0, targets.ravel()]),
            lbx=self._low,
            ubx=self._high,
            lbg=0.0,
            ubg=0.0,
        )
        if self._solver.stats()["return_status"] not in SOLVED:
            self._start = None
            return None
        self._start = np.array(found["x"]).ravel()
        return self._start[self._states : self._states + INPUTS]


def _step(model: ControlModel, step_s: float) -> ca.Function:
    """Return (x, u) -> x_next by RK4."""
    symbols = ca.SX.sym("x", STATES), ca.SX.sym("u", INPUTS), ca.SX.sym("d", 3)
    x, u, d = symbols
    rigid = ca.Function("rigid", symbols, [model.derivative(x, u, ca.SX(ca.DM(model.parameters)), d)])
    x, u = ca.MX.sym("x", STATES), ca.MX.sym("u", INPUTS)

    def slope(at: ca.MX) -> ca.MX:
        learned = ca.MX(ca.DM.zeros(3))
        if model.network is not None:
            learned = model.network.layout.matrices(ca.DM(model.network.xi), at[NETWORK_STATE])
        return rigid(at, u, learned)

    k1 = slope(x)
    k2 = slope(x + 0.5 * step_s * k1)
    k3 = slope(x + 0.5 * step_s * k2)
    k4 = slope(x + step_s * k3)
    return ca.Function("step", [x, u], [x + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)])


def _stage_cost(cost: Array) -> ca.Function:
    x, u, target = ca.MX.sym("x", STATES), ca.MX.sym("u", INPUTS), ca.MX.sym("target", STATES + INPUTS)
    error = ca.vertcat(x, u) - target
    weights = ca.DM(np.concatenate([cost[COST.state], cost[COST.input]]))
    value = 0.5 * ca.dot(weights, error * error) + _tilt_cost(cost, x)
    return ca.Function("stage_cost", [x, u, target], [value])


def _terminal_cost(cost: Array) -> ca.Function:
    x, target = ca.MX.sym("x", STATES), ca.MX.sym("target", STATES)
    error = x - target
    value = 0.5 * ca.dot(ca.DM(cost[COST.terminal]), error * error) + _tilt_cost(cost, x)
    return ca.Function("terminal_cost", [x, target], [value])


def _tilt_cost(cost: Array, x: ca.MX) -> ca.MX:
    roll, pitch = x[THETA.start], x[THETA.start + 1]
    shortfall = ca.fmax(cost[COST.tilt_cos] - ca.cos(roll) * ca.cos(pitch), 0.0)
    return 0.5 * cost[COST.tilt] * shortfall * shortfall
