"""The two sweeps of an iteration as CasADi functions: prediction with its derivatives, and feedback.

The forward sweep predicts the states of a plan by RK4 and linearises every stage. The backward sweep returns
the change of the inputs that minimises the quadratic model of the cost within the bounds of the inputs: a
Riccati recursion in which every stage is a box-constrained problem of four unknowns (Tassa, Mansard and
Todorov, "Control-limited differential dynamic programming", ICRA 2014), with a Gauss-Newton Hessian.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from trimtab.host.codegen import held_interrupts
from trimtab.host.control.cost import COST, cost_terms
from trimtab.host.control.dynamics import INPUTS, STATES, ControlModel
from trimtab.host.control.feedback import GAINS, feedback, policy
from trimtab.host.control.stage import Stage


@dataclass(frozen=True, kw_only=True)
class Sweeps:
    """CasADi functions of a plan of N stages. Every column is a stage.

    advance(x, u, step_s, p, xi) -> x_next.
    forward(x0, x_plan, u_plan, k, K, alpha, reference, cost, step_s, p, xi) -> x, u, A, B, total: inputs
    u = clip(u_plan + alpha k + K (x - x_plan)), and A and B as their nonzeros.
    backward(x, u, A, B, reference, cost) -> k, K, decrease, change: the predicted decrease of the total by k,
    and the greatest |k| over the range of its input.
    """

    advance: ca.Function
    forward: ca.Function
    backward: ca.Function


@held_interrupts()
def sweeps(model: ControlModel, stages: int) -> Sweeps:
    """Return the functions for plans of this many stages. Weights, effects and costs are data."""
    stage = Stage(model)
    return Sweeps(
        advance=_advance(model, stage),
        forward=_forward(model, stages, stage),
        backward=_backward(stages, stage.sparsity_a, stage.sparsity_b),
    )


def _advance(model: ControlModel, stage: Stage) -> ca.Function:
    inputs = {
        "x": ca.MX.sym("x", STATES),
        "u": ca.MX.sym("u", INPUTS),
        "step_s": ca.MX.sym("step_s"),
        "p": ca.MX.sym("p", len(model.parameters)),
        "xi": ca.MX.sym("xi", len(model.weights)),
    }
    return _named("advance", inputs, {"next": stage.next(*inputs.values())})


def _forward(model: ControlModel, stages: int, stage: Stage) -> ca.Function:
    inputs = {
        "x0": ca.MX.sym("x0", STATES),
        "x_plan": ca.MX.sym("x_plan", STATES, stages),
        "u_plan": ca.MX.sym("u_plan", INPUTS, stages),
        "k": ca.MX.sym("k", INPUTS, stages),
        "K": ca.MX.sym("K", GAINS, stages),
        "alpha": ca.MX.sym("alpha"),
        "reference": ca.MX.sym("reference", STATES + INPUTS, stages + 1),
        "cost": ca.MX.sym("cost", COST.size),
        "step_s": ca.MX.sym("step_s"),
        "p": ca.MX.sym("p", len(model.parameters)),
        "xi": ca.MX.sym("xi", len(model.weights)),
    }
    of_policy, stage_cost, terminal_cost = policy(), cost_terms(terminal=False), cost_terms(terminal=True)
    per_stage = [ca.horzsplit(inputs[name]) for name in ("x_plan", "u_plan", "k", "K", "reference")]
    x, total = inputs["x0"], ca.MX(0.0)
    xs, us, a_columns, b_columns = [x], [], [], []
    for x_plan, u_plan, k, K, reference in zip(*per_stage, strict=False):
        u = of_policy(x, x_plan, u_plan, k, K, inputs["alpha"], inputs["cost"])
        total += stage_cost(x, u, reference, inputs["cost"])[0]
        x, a_nz, b_nz = stage.linearised(x, u, inputs["step_s"], inputs["p"], inputs["xi"])
        xs.append(x)
        us.append(u)
        a_columns.append(a_nz)
        b_columns.append(b_nz)
    total += terminal_cost(x, us[-1], per_stage[-1][-1], inputs["cost"])[0]
    outputs = {
        "x": ca.horzcat(*xs),
        "u": ca.horzcat(*us),
        "A": ca.horzcat(*a_columns),
        "B": ca.horzcat(*b_columns),
        "total": total,
    }
    return _named("forward", inputs, outputs)


def _backward(stages: int, sparsity_a: ca.Sparsity, sparsity_b: ca.Sparsity) -> ca.Function:
    inputs = {
        "x": ca.MX.sym("x", STATES, stages + 1),
        "u": ca.MX.sym("u", INPUTS, stages),
        "A": ca.MX.sym("A", sparsity_a.nnz(), stages),
        "B": ca.MX.sym("B", sparsity_b.nnz(), stages),
        "reference": ca.MX.sym("reference", STATES + INPUTS, stages + 1),
        "cost": ca.MX.sym("cost", COST.size),
    }
    stage_cost, terminal_cost = cost_terms(terminal=False), cost_terms(terminal=True)
    of_stage = feedback(sparsity_a, sparsity_b)
    columns = {name: ca.horzsplit(inputs[name]) for name in ("x", "u", "A", "B", "reference")}
    _, p, _, P = terminal_cost(columns["x"][-1], columns["u"][-1], columns["reference"][-1], inputs["cost"])
    ks, Ks, decrease, change = [], [], ca.MX(0.0), ca.MX(0.0)
    for i in reversed(range(stages)):
        x, u = columns["x"][i], columns["u"][i]
        _, by_x, by_u, hessian = stage_cost(x, u, columns["reference"][i], inputs["cost"])
        k, K, P, p, less, most = of_stage(
            u, columns["A"][i], columns["B"][i], by_x, by_u, hessian, P, p, inputs["cost"]
        )
        ks.append(k)
        Ks.append(K)
        decrease += less
        change = ca.fmax(change, most)
    outputs = {
        "k": ca.horzcat(*reversed(ks)),
        "K": ca.horzcat(*reversed(Ks)),
        "decrease": decrease,
        "change": change,
    }
    return _named("backward", inputs, outputs)


def _named(name: str, inputs: dict[str, ca.MX], outputs: dict[str, ca.MX]) -> ca.Function:
    return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))
