"""The prediction's stage for the solver, and one of its steps as a CasADi function."""

from __future__ import annotations

import casadi as ca

from trimtab.host.codegen import held_interrupts
from trimtab.host.control.cost import STAGE_SIZE, stage_cost
from trimtab.host.control.dynamics import INPUTS, STATES, ControlModel, network_acceleration
from trimtab.host.models.airframe import V
from trimtab.host.models.step import rk4
from trimtab.host.shooting.stage import StageModel


def stage_model(model: ControlModel, step_s: float) -> StageModel:
    """Return a stage of `step_s`. Its parameters: those of the model, those of the cost, the target (17)."""
    of_model = len(model.parameters)
    of_cost = of_model + STAGE_SIZE

    def effort(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
        # The cost is a sum over the stages; the solver integrates the effort over time.
        return stage_cost(x, u, p[of_cost:], p[of_model:of_cost]) / step_s

    return StageModel(
        nx=STATES,
        nu=INPUTS,
        np=of_cost + STATES + INPUTS,
        derivative=lambda x, u, p: model.derivative(x, u, p[:of_model], ca.SX.zeros(3)),
        residual=None,
        effort=effort,
        path=lambda x, u, p: ca.SX(0, 1),
        network=model.network,
        network_rows=V,
    )


@held_interrupts()
def advance_function(model: ControlModel) -> ca.Function:
    """Return (x, u, step_s, p, xi) -> x_next, one RK4 step."""
    names = ["x", "u", "step_s", "p", "xi"]
    sizes = [STATES, INPUTS, 1, len(model.parameters), len(model.weights)]
    x, u, step_s, p, xi = symbols = [ca.MX.sym(*of) for of in zip(names, sizes, strict=True)]
    of_sx = [ca.SX.sym("x", STATES), ca.SX.sym("u", INPUTS), ca.SX.sym("p", sizes[3]), ca.SX.sym("d", 3)]
    slope = ca.Function("slope", of_sx, [ca.densify(model.derivative(*of_sx))], {"cse": True})
    x_next = rk4(lambda at, _: slope(at, u, p, network_acceleration(model, xi, at)), x, step_s)
    return ca.Function("advance", symbols, [x_next], names, ["next"])
