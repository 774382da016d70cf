"""A stage of the backward sweep: the best change of its inputs within their bounds, and the feedback."""

from __future__ import annotations

import casadi as ca

from trimtab.host.control.cost import COST
from trimtab.host.control.dynamics import INPUTS, STATES

GAINS = STATES * INPUTS
_ACTIVE_SET_ROUNDS = 6
"""Rounds of the active set of four bounds; 16 sets exist, two or three rounds are usual."""


def policy() -> ca.Function:
    """Return (x, x_plan, u_plan, k, K, alpha, cost) -> u within its bounds."""
    x, x_plan = ca.SX.sym("x", STATES), ca.SX.sym("x_plan", STATES)
    u_plan, k = ca.SX.sym("u_plan", INPUTS), ca.SX.sym("k", INPUTS)
    K, alpha, cost = ca.SX.sym("K", GAINS), ca.SX.sym("alpha"), ca.SX.sym("cost", COST.size)
    u = u_plan + alpha * k + ca.reshape(K, INPUTS, STATES) @ (x - x_plan)
    u = ca.fmax(ca.fmin(u, cost[COST.high]), cost[COST.low])
    return ca.Function("policy", [x, x_plan, u_plan, k, K, alpha, cost], [u])


def feedback(sparsity_a: ca.Sparsity, sparsity_b: ca.Sparsity) -> ca.Function:
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
