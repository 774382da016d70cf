"""One stage of the prediction as CasADi functions: an RK4 step with its Jacobians, the network inside."""

from __future__ import annotations

import casadi as ca

from trimtab.host.control.dynamics import INPUTS, NETWORK_STATE, STATES, ControlModel
from trimtab.host.models.airframe import V

_ALONG = (0.0, 0.5, 0.5, 1.0)  # where RK4 evaluates, in steps
_WEIGHT = (1 / 6, 2 / 6, 2 / 6, 1 / 6)


class Stage:
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


def network_value(model: ControlModel) -> ca.Function:
    """Return (xi, v_ned and Theta) -> acceleration (3); zeros without a network."""
    xi, state = ca.MX.sym("xi", len(model.weights)), ca.MX.sym("state", 6)
    d = ca.MX(ca.DM.zeros(3))
    if model.network is not None:
        d = model.network.layout.matrices(xi, state)
    return ca.Function("network", [xi, state], [d], {"cse": True})


def _network_slopes(model: ControlModel) -> ca.Function:
    """Return (xi, v_ned and Theta) -> acceleration (3), Jacobian (3, 6); zeros without a network."""
    xi, state = ca.MX.sym("xi", len(model.weights)), ca.MX.sym("state", 6)
    if model.network is None:
        zeros = [ca.MX(ca.DM.zeros(3)), ca.MX(ca.DM.zeros(3, 6))]
        return ca.Function("network_slopes", [xi, state], zeros)
    d = model.network.layout.matrices(xi, state)
    return ca.Function("network_slopes", [xi, state], [d, ca.densify(ca.jacobian(d, state))], {"cse": True})


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
