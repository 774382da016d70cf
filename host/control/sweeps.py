"""The two sweeps of an iteration as CasADi functions: prediction with its derivatives, and feedback.

The forward sweep predicts the states of a plan by RK4 and linearises every stage. The backward sweep returns
the change of the inputs that minimises the quadratic model of the cost within the bounds of the inputs: a
Riccati recursion in which every stage is a box-constrained problem of four unknowns (Tassa, Mansard and
Todorov, "Control-limited differential dynamic programming", ICRA 2014), with a Gauss-Newton Hessian.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from trimtab.host.codegen import held_interrupts
from trimtab.host.control.dynamics import INPUTS, NETWORK_STATE, STATES, ControlModel
from trimtab.host.models.airframe import THETA, V

GAINS = STATES * INPUTS
_ALONG = (0.0, 0.5, 0.5, 1.0)  # where RK4 evaluates, in steps
_WEIGHT = (1 / 6, 2 / 6, 2 / 6, 1 / 6)
_ACTIVE_SET_ROUNDS = 6
"""Rounds of the active set of four bounds; 16 sets exist, two or three rounds are usual."""


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
    stage = _Stage(model)
    return Sweeps(
        advance=_advance(model, stage),
        forward=_forward(model, stages, stage),
        backward=_backward(stages, stage.sparsity_a, stage.sparsity_b),
    )


def _network_slopes(model: ControlModel) -> ca.Function:
    """Return (xi, v_ned and Theta) -> acceleration (3), Jacobian (3, 6); zeros without a network."""
    xi, state = ca.MX.sym("xi", len(model.weights)), ca.MX.sym("state", 6)
    if model.network is None:
        zeros = [ca.MX(ca.DM.zeros(3)), ca.MX(ca.DM.zeros(3, 6))]
        return ca.Function("network_slopes", [xi, state], zeros)
    d = model.network.layout.matrices(xi, state)
    return ca.Function("network_slopes", [xi, state], [d, ca.densify(ca.jacobian(d, state))], {"cse": True})


def network_value(model: ControlModel) -> ca.Function:
    """Return (xi, v_ned and Theta) -> acceleration (3); zeros without a network."""
    xi, state = ca.MX.sym("xi", len(model.weights)), ca.MX.sym("state", 6)
    d = ca.MX(ca.DM.zeros(3))
    if model.network is not None:
        d = model.network.layout.matrices(xi, state)
    return ca.Function("network", [xi, state], [d], {"cse": True})


class _Stage:
    """One RK4 step from MX arguments: its evaluations of the dynamics, and the chain rule over them."""

    def __init__(self, model: ControlModel) -> None:
        self._network, self._network_slopes = network_value(model), _network_slopes(model)
        x, u = ca.SX.sym("x", STATES), ca.SX.sym("u", INPUTS)
        p, step_s = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("step_s")
        d, d_slope = ca.SX.sym("d", 3), ca.SX.sym("d_slope", 3, NETWORK_STATE.stop - NETWORK_STATE.start)
        slope = model.derivative(x, u, p, d)
        by_x, by_u = ca.jacobian(slope, x), ca.jacobian(slope, u)
        if model.network is not None:
            learned = ca.SX(STATES, STATES)
            learned[V, NETWORK_STATE] = d_slope
            by_x += learned
        options = {"cse": True}
        self._slope = ca.Function("slope", [x, u, p, d], [ca.densify(slope)], options)
        self._slopes = ca.Function(
            "slopes", [x, u, p, d, d_slope], [ca.densify(slope), by_x.nz[:], by_u.nz[:]], options
        )
        k = [ca.SX.sym(f"k{i}", STATES) for i in range(4)]
        self._end = ca.Function(
            "end", [x, step_s, *k], [x + step_s / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])]
        )
        share = ca.SX.sym("share")
        self._inside = ca.Function("inside", [x, step_s, share, k[0]], [x + share * step_s * k[0]])
        self._chain, self.sparsity_a, self.sparsity_b = _chain_rule(by_x.sparsity(), by_u.sparsity())

    def next(self, x: ca.MX, u: ca.MX, step_s: ca.MX, p: ca.MX, xi: ca.MX) -> ca.MX:
        """Return x_next."""
        ks: list[ca.MX] = []
        for share in _ALONG:
            at = self._inside(x, step_s, share, ks[-1]) if ks else x
            ks.append(self._slope(at, u, p, self._network(xi, at[NETWORK_STATE])))
        return self._end(x, step_s, *ks)

    def linearised(
        self, x: ca.MX, u: ca.MX, step_s: ca.MX, p: ca.MX, xi: ca.MX
    ) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Return x_next and the nonzeros of its Jacobians in x and u."""
        ks: list[ca.MX] = []
        by_x: list[ca.MX] = []
        by_u: list[ca.MX] = []
        for share in _ALONG:
            at = self._inside(x, step_s, share, ks[-1]) if ks else x
            k, a, b = self._slopes(at, u, p, *self._network_slopes(xi, at[NETWORK_STATE]))
            ks.append(k)
            by_x.append(a)
            by_u.append(b)
        a_nz, b_nz = self._chain(step_s, *by_x, *by_u)
        return self._end(x, step_s, *ks), a_nz, b_nz


def _chain_rule(
    sparsity_x: ca.Sparsity, sparsity_u: ca.Sparsity
) -> tuple[ca.Function, ca.Sparsity, ca.Sparsity]:
    """Return (step_s, 4 x d slope/dx, 4 x d slope/du) -> A and B of the RK4 step, with their patterns."""
    step_s = ca.SX.sym("step_s")
    xs = [ca.SX.sym(f"x{i}", sparsity_x.nnz()) for i in range(4)]
    us = [ca.SX.sym(f"u{i}", sparsity_u.nnz()) for i in range(4)]
    a, b = ca.SX(STATES, STATES), ca.SX(STATES, INPUTS)
    total_a, total_b = ca.SX(STATES, STATES), ca.SX(STATES, INPUTS)
    for x_nz, u_nz, share, weight in zip(xs, us, _ALONG, _WEIGHT, strict=True):
        by_x = ca.SX(sparsity_x, x_nz)
        at_b = share * step_s * b
        a = by_x @ (ca.SX.eye(STATES) + share * step_s * a)
        b = by_x @ at_b + ca.SX(sparsity_u, u_nz)
        total_a += weight * a
        total_b += weight * b
    total_a = ca.sparsify(ca.SX.eye(STATES) + step_s * total_a)
    total_b = ca.sparsify(step_s * total_b)
    chain = ca.Function("chain", [step_s, *xs, *us], [total_a.nz[:], total_b.nz[:]], {"cse": True})
    return chain, total_a.sparsity(), total_b.sparsity()


def _cost(*, terminal: bool) -> ca.Function:
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


def _advance(model: ControlModel, stage: _Stage) -> ca.Function:
    inputs = {
        "x": ca.MX.sym("x", STATES),
        "u": ca.MX.sym("u", INPUTS),
        "step_s": ca.MX.sym("step_s"),
        "p": ca.MX.sym("p", len(model.parameters)),
        "xi": ca.MX.sym("xi", len(model.weights)),
    }
    return _named("advance", inputs, {"next": stage.next(*inputs.values())})


def _forward(model: ControlModel, stages: int, stage: _Stage) -> ca.Function:
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
    policy, stage_cost, terminal_cost = _policy(), _cost(terminal=False), _cost(terminal=True)
    per_stage = [ca.horzsplit(inputs[name]) for name in ("x_plan", "u_plan", "k", "K", "reference")]
    x, total = inputs["x0"], ca.MX(0.0)
    xs, us, a_columns, b_columns = [x], [], [], []
    for x_plan, u_plan, k, K, reference in zip(*per_stage, strict=False):
        u = policy(x, x_plan, u_plan, k, K, inputs["alpha"], inputs["cost"])
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
    stage_cost, terminal_cost = _cost(terminal=False), _cost(terminal=True)
    feedback = _feedback(sparsity_a, sparsity_b)
    columns = {name: ca.horzsplit(inputs[name]) for name in ("x", "u", "A", "B", "reference")}
    _, p, _, P = terminal_cost(columns["x"][-1], columns["u"][-1], columns["reference"][-1], inputs["cost"])
    ks, Ks, decrease, change = [], [], ca.MX(0.0), ca.MX(0.0)
    for i in reversed(range(stages)):
        x, u = columns["x"][i], columns["u"][i]
        _, by_x, by_u, hessian = stage_cost(x, u, columns["reference"][i], inputs["cost"])
        k, K, P, p, less, most = feedback(
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


def _policy() -> ca.Function:
    """Return (x, x_plan, u_plan, k, K, alpha, cost) -> u within its bounds."""
    x, x_plan = ca.SX.sym("x", STATES), ca.SX.sym("x_plan", STATES)
    u_plan, k = ca.SX.sym("u_plan", INPUTS), ca.SX.sym("k", INPUTS)
    K, alpha, cost = ca.SX.sym("K", GAINS), ca.SX.sym("alpha"), ca.SX.sym("cost", COST.size)
    u = u_plan + alpha * k + ca.reshape(K, INPUTS, STATES) @ (x - x_plan)
    u = ca.fmax(ca.fmin(u, cost[COST.high]), cost[COST.low])
    return ca.Function("policy", [x, x_plan, u_plan, k, K, alpha, cost], [u])


def _feedback(sparsity_a: ca.Sparsity, sparsity_b: ca.Sparsity) -> ca.Function:
    """Return a stage of the recursion.

    (u, A, B, gradients, Hessian in x, P, p, cost) -> k, K, P and p of this stage, decrease, change. P and p:
    Hessian and gradient of the cost to go.
    """
    u, cost = ca.SX.sym("u", INPUTS), ca.SX.sym("cost", COST.size)
    a_nz, b_nz = ca.SX.sym("a", sparsity_a.nnz()), ca.SX.sym("b", sparsity_b.nnz())
    by_x, by_u = ca.SX.sym("by_x", STATES), ca.SX.sym("by_u", INPUTS)
    hessian, P = ca.SX.sym("hessian", STATES, STATES), ca.SX.sym("P", STATES, STATES)
    p = ca.SX.sym("p", STATES)
    a, b = ca.SX(sparsity_a, a_nz), ca.SX(sparsity_b, b_nz)
    pb, pa = P @ b, P @ a
    q_uu = ca.diag(cost[COST.input]) + b.T @ pb
    q_ux = pb.T @ a
    q_xx = hessian + a.T @ pa
    q_u, q_x = by_u + b.T @ p, by_x + a.T @ p
    low, high = cost[COST.low] - u, cost[COST.high] - u
    k, K = _box_minimum(q_uu, q_u, q_ux, low, high)
    value_hessian = q_xx + K.T @ q_uu @ K + K.T @ q_ux + q_ux.T @ K
    value_hessian = 0.5 * (value_hessian + value_hessian.T)
    value_gradient = q_x + K.T @ (q_uu @ k + q_u) + q_ux.T @ k
    decrease = -(ca.dot(k, q_u) + 0.5 * ca.dot(k, q_uu @ k))
    change = ca.mmax(ca.fabs(k) / (cost[COST.high] - cost[COST.low]))
    outputs = [k, ca.vec(K), value_hessian, value_gradient, decrease, change]
    inputs = [u, a_nz, b_nz, by_x, by_u, hessian, P, p, cost]
    return ca.Function("feedback", inputs, [ca.densify(output) for output in outputs], {"cse": True})


def _box_minimum(H: ca.SX, g: ca.SX, g_x: ca.SX, low: ca.SX, high: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the minimum k of 1/2 k'Hk + g'k in low..high, and its slope K by x where g moves by g_x x.

    A primal-dual active set (Hintermueller, Ito and Kunisch, SIAM J. Optim. 2002) in a fixed number of
    rounds. Inputs at a bound have no feedback.
    """
    free = ca.SX.ones(INPUTS)
    fixed = ca.SX.zeros(INPUTS)  # value of the inputs at a bound
    k = ca.SX.zeros(INPUTS)
    masked = ca.SX.zeros(INPUTS, INPUTS)
    for _ in range(_ACTIVE_SET_ROUNDS):
        masked = _masked(H, free)
        k = fixed + free * _solve(masked, free * -(g + H @ fixed))
        dual = -(g + H @ k)
        scale = ca.diag(H)
        at_high = dual + scale * (k - high) > 0.0
        at_low = dual + scale * (k - low) < 0.0
        free = 1.0 - ca.fmax(at_high, at_low)
        fixed = ca.if_else(at_high, high, ca.if_else(at_low, low, ca.SX.zeros(INPUTS)))
    k = ca.fmax(ca.fmin(k, high), low)
    masked = _masked(H, free)
    K = -ca.repmat(free, 1, STATES) * _solve(masked, ca.repmat(free, 1, STATES) * g_x)
    return k, K


def _masked(H: ca.SX, free: ca.SX) -> ca.SX:
    """Return H with the rows and columns of fixed inputs replaced by their diagonal."""
    return H * (free @ free.T) + ca.diag((1.0 - free) * ca.diag(H))


def _solve(H: ca.SX, right: ca.SX) -> ca.SX:
    """Return H^-1 right by Cholesky's factors of a positive definite H."""
    lower = ca.SX.zeros(INPUTS, INPUTS)
    for j in range(INPUTS):
        pivot = H[j, j] - ca.dot(lower[j, :j], lower[j, :j])
        lower[j, j] = ca.sqrt(pivot)
        for i in range(j + 1, INPUTS):
            lower[i, j] = (H[i, j] - ca.dot(lower[i, :j], lower[j, :j])) / lower[j, j]
    rows: list[ca.SX] = []
    for i in range(INPUTS):
        rest = right[i, :]
        for j in range(i):
            rest = rest - lower[i, j] * rows[j]
        rows.append(rest / lower[i, i])
    for i in reversed(range(INPUTS)):
        rest = rows[i]
        for j in range(i + 1, INPUTS):
            rest = rest - lower[j, i] * rows[j]
        rows[i] = rest / lower[i, i]
    return ca.vertcat(*rows)


def _named(name: str, inputs: dict[str, ca.MX], outputs: dict[str, ca.MX]) -> ca.Function:
    return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))
