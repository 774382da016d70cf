"""One stage of the prediction as CasADi functions: an RK4 step with its Jacobians, the network inside."""

from __future__ import annotations

import casadi as ca

from trimtab.host.control.dynamics import INPUTS, NETWORK_STATE, STATES, ControlModel
from trimtab.host.control.residual_network import network_functions
from trimtab.host.models.airframe import V
from trimtab.host.models.step import ALONG, WEIGHT, rk4


class Stage:
    """One RK4 step from MX arguments: its evaluations of the dynamics, and the chain rule over them."""

    def __init__(self, model: ControlModel) -> None:
        self._network = network_functions(model.network)
        x, u = ca.SX.sym("x", STATES), ca.SX.sym("u", INPUTS)
        p = ca.SX.sym("p", len(model.parameters))
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
        self._chain, self.sparsity_a, self.sparsity_b = _chain_rule(by_x.sparsity(), by_u.sparsity())

    def matrices(self, xi: ca.MX) -> list[ca.MX]:
        """Return the network's matrices, for all steps of a prediction."""
        return self._network.matrices.call([xi])

    def next(self, x: ca.MX, u: ca.MX, step_s: ca.MX, p: ca.MX, matrices: list[ca.MX]) -> ca.MX:
        """Return x_next."""
        return rk4(
            lambda at, _: self._slope(at, u, p, self._network.value(*matrices, at[NETWORK_STATE])), x, step_s
        )

    def linearised(
        self, x: ca.MX, u: ca.MX, step_s: ca.MX, p: ca.MX, matrices: list[ca.MX]
    ) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Return x_next and the nonzeros of its Jacobians in x and u."""
        by_x: list[ca.MX] = []
        by_u: list[ca.MX] = []

        def slope(at: ca.MX, _: int) -> ca.MX:
            k, a, b = self._slopes(at, u, p, *self._network.slopes(*matrices, at[NETWORK_STATE]))
            by_x.append(a)
            by_u.append(b)
            return k

        x_next = rk4(slope, x, step_s)
        a_nz, b_nz = self._chain(step_s, *by_x, *by_u)
        return x_next, a_nz, b_nz


def _chain_rule(
    sparsity_x: ca.Sparsity, sparsity_u: ca.Sparsity
) -> tuple[ca.Function, ca.Sparsity, ca.Sparsity]:
    """Return (step_s, 4 x d slope/dx, 4 x d slope/du) -> A and B of the RK4 step, with their patterns."""
    step_s = ca.SX.sym("step_s")
    xs = [ca.SX.sym(f"x{i}", sparsity_x.nnz()) for i in range(4)]
    us = [ca.SX.sym(f"u{i}", sparsity_u.nnz()) for i in range(4)]
    a, b = ca.SX(STATES, STATES), ca.SX(STATES, INPUTS)
    total_a, total_b = ca.SX(STATES, STATES), ca.SX(STATES, INPUTS)
    for x_nz, u_nz, share, weight in zip(xs, us, ALONG, WEIGHT, strict=True):
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
