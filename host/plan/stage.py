"""One shooting interval: RK4 step, stage cost, and their exact derivatives by a stage-wise chain rule.

An interval has z = (x, u, h). Symbolic differentiation of the unrolled RK4 step would repeat the derivatives
of the residual network through all four evaluations. Here formulas give the network's Jacobian and Hessian
once per evaluation, and CasADi differentiates the small rest of the dynamics. Forward sensitivities and one
adjoint sweep join the evaluations. The expressions are SX, for all intervals by `Function.map`.

Source: paper eqs. 10-11. With Z_i = d(x_i, u)/dz of RK4 evaluation i and kappa_i the adjoint of its slope
k_i, the Hessian of lam' F(z) is the sum of Z_i' (d2 kappa_i' f) Z_i and of the products of h with the
sensitivities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.ops import CASADI
from trimtab.host.models.network import Layout, Network

NETWORK_INPUTS = slice(3, 9)  # v_ned and Theta in the state

_ALONG = (0.0, 0.5, 0.5, 1.0)  # where RK4 evaluates, in steps
_WEIGHT = (1 / 6, 2 / 6, 2 / 6, 1 / 6)


@dataclass(frozen=True, kw_only=True)
class StageModel:
    """Dynamics, cost and path rows of an interval. p: its parameters besides the nominal step.

    derivative(x, u, p): (nx,) continuous dynamics without the network. residual(x, p): 3 rows or more, m/s^2,
    the part of the cost |residual|^2 that is not the network's, or None for no such cost. effort(x, u, p):
    scalar, already weighted. path(x, u, p): rows bounded at every node. network: added to the residual's
    first 3 rows, and in the dynamics to the rows of the derivative in `network_rows`, None for none.
    """

    nx: int
    nu: int
    np: int
    derivative: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
    residual: Callable[[ca.SX, ca.SX], ca.SX] | None
    effort: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
    path: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
    network: Network | None
    network_rows: slice | None


@dataclass(frozen=True, kw_only=True)
class Stage:
    """CasADi functions of one interval of h * h0_s seconds, z = (x, u, h).

    value(x, u, h, h0_s, p) -> x_next, cost, path. gradient(same) -> d cost/dz. slopes(same) -> d x_next/dz, d
    path/d(x, u).
    hessian(same, sigma, lam_x, lam_path) -> upper triangle of the Hessian in z of sigma cost + lam_x' x_next
    + lam_path' path.
    """

    value: ca.Function
    gradient: ca.Function
    slopes: ca.Function
    hessian: ca.Function


@dataclass(frozen=True, kw_only=True)
class _NetworkTerms:
    """The network's acceleration d, its Jacobian, and mu -> gradient (vjp) and Hessian of mu' d."""

    value: ca.SX
    jacobian: ca.SX
    vjp: Callable[[ca.SX], ca.SX]
    hessian: Callable[[ca.SX], ca.SX]


def network_ends(layout: Layout) -> dict[str, ca.Function]:
    """Return the network's inputs from v_ned and Theta, its acceleration from its outputs, and derivatives.

    `kernel.c` calls them by these names. seen(state): inputs (n,). dseen(state): (n, 6). ddseen(state, eta):
    Hessian (6, 6) of eta' seen. given(state, out): acceleration (3,). dgiven(state, out): (3, 6), (3, 3).
    ddgiven(state, out, mu): Hessian of mu' given, by state and state (6, 6), by out and state (3, 6).
    """
    state, out = ca.SX.sym("state", 6), ca.SX.sym("out", 3)
    mu, eta = ca.SX.sym("mu", 3), ca.SX.sym("eta", layout.sizes[0])
    network_inputs = ca.vertcat(*layout.inputs(CASADI, ca.vertsplit(state)))
    acceleration = ca.vertcat(*layout.acceleration(CASADI, ca.vertsplit(state), ca.vertsplit(out)))
    slope = ca.gradient(ca.dot(mu, acceleration), state)
    parts = {
        "seen": ([state], [network_inputs]),
        "dseen": ([state], [ca.jacobian(network_inputs, state)]),
        "ddseen": ([state, eta], [ca.hessian(ca.dot(eta, network_inputs), state)[0]]),
        "given": ([state, out], [acceleration]),
        "dgiven": ([state, out], [ca.jacobian(acceleration, state), ca.jacobian(acceleration, out)]),
        "ddgiven": ([state, out, mu], [ca.jacobian(slope, state), ca.jacobian(slope, out).T]),
    }
    return {name: ca.Function(name, inputs, outputs) for name, (inputs, outputs) in parts.items()}


def _network(network: Network, state: ca.SX) -> _NetworkTerms:
    """Return d (3), Jacobian (3, 6), gradient (6) and Hessian (6, 6) by (v_ned, Theta), by formula."""
    ends = network_ends(network.layout)
    layers = [(ca.DM(weight), ca.DM(bias)) for weight, bias in network.layout.layers(network.xi)]
    ways = network.layout.sizes[0]
    value, slope = ends["seen"](state), ca.SX.eye(ways)
    hidden: list[tuple[ca.SX, ca.SX]] = []  # (activation, Jacobian of what it is applied to)
    for weight, bias in layers[:-1]:
        before = weight @ slope
        value = ca.tanh(weight @ value + bias)
        slope = ca.repmat(1 - value * value, 1, ways) * before
        hidden.append((value, before))
    weight, bias = layers[-1]
    out = weight @ value + bias
    by_state = ends["dseen"](state)
    out_slope = weight @ slope @ by_state
    given_by_state, by_out = ends["dgiven"](state, out)

    def behind(mu: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return gradient and Hessian of mu' out by the network's inputs."""
        total = ca.SX(ways, ways)
        back = weight.T @ mu
        for (activation, before), (inner, _) in zip(reversed(hidden), reversed(layers[:-1]), strict=True):
            gain = 1 - activation * activation
            total += before.T @ (ca.repmat(-2 * activation * gain * back, 1, ways) * before)
            back = inner.T @ (gain * back)
        return back, total

    def vjp(mu: ca.SX) -> ca.SX:
        return by_state.T @ behind(by_out.T @ mu)[0] + given_by_state.T @ mu

    def hessian(mu: ca.SX) -> ca.SX:
        eta, total = behind(by_out.T @ mu)
        direct, mixed = ends["ddgiven"](state, out, mu)
        cross = mixed.T @ out_slope
        return by_state.T @ total @ by_state + ends["ddseen"](state, eta) + direct + cross + cross.T

    return _NetworkTerms(
        value=ends["given"](state, out),
        jacobian=by_out @ out_slope + given_by_state,
        vjp=vjp,
        hessian=hessian,
    )


def _embed(block: ca.SX, rows: slice, columns: slice, shape: tuple[int, int]) -> ca.SX:
    """Return a sparse matrix of the given shape that is `block` in those rows and columns."""
    out = ca.SX(*shape)
    out[rows, columns] = block
    return out


@dataclass(frozen=True, kw_only=True)
class _Evaluation:
    """One evaluation of the dynamics in a step: state, slope and their derivatives."""

    x: ca.SX
    sensitivity: ca.SX  # dx/dz
    slope: ca.SX
    slope_sensitivity: ca.SX  # d slope/dz
    jacobian: ca.SX  # d slope/dx
    network: _NetworkTerms | None


class _Builder:
    """Symbols of one interval and the expressions built from them."""

    def __init__(self, model: StageModel) -> None:
        self.model = model
        nx, nu = model.nx, model.nu
        self.x, self.u = ca.SX.sym("x", nx), ca.SX.sym("u", nu)
        self.h, self.h0 = ca.SX.sym("h"), ca.SX.sym("h0_s")
        self.p = ca.SX.sym("p", model.np)
        self.nz = nx + nu + 1
        self.step = self.h * self.h0
        self.xu = ca.vertcat(self.x, self.u)
        self.du = _embed(ca.SX.eye(nu), slice(0, nu), slice(nx, nx + nu), (nu, self.nz))
        self.dh = _embed(ca.SX(self.h0), slice(0, 1), slice(self.nz - 1, self.nz), (1, self.nz))  # d step/dz

        f = model.derivative(self.x, self.u, self.p)
        kappa = ca.SX.sym("kappa", nx)
        inputs = [self.x, self.u, self.p]
        self._f = ca.Function("f", inputs, [f, ca.jacobian(f, self.x), ca.jacobian(f, self.u)])
        self._f_hessian = ca.Function(
            "f_hessian", [*inputs, kappa], [ca.hessian(ca.dot(kappa, f), self.xu)[0]]
        )
        self.evaluations = self._integrate()
        self.x_next = self.x + self.step * self._mean_slope()
        self._residual()

    def _integrate(self) -> list[_Evaluation]:
        nx, nz = self.model.nx, self.nz
        start = _embed(ca.SX.eye(nx), slice(0, nx), slice(0, nx), (nx, nz))
        out: list[_Evaluation] = []
        for along in _ALONG:
            x, dx = self.x, start
            if out:
                last = out[-1]
                x = self.x + along * self.step * last.slope
                dx = start + along * (self.step * last.slope_sensitivity + last.slope @ self.dh)
            slope, jacobian, by_input = self._f(x, self.u, self.p)
            network = None
            if self.model.network is not None and (rows := self.model.network_rows) is not None:
                network = _network(self.model.network, x[NETWORK_INPUTS])
                slope = slope + _embed(network.value, rows, slice(0, 1), (nx, 1))
                jacobian = jacobian + _embed(network.jacobian, rows, NETWORK_INPUTS, (nx, nx))
            out.append(
                _Evaluation(
                    x=x,
                    sensitivity=dx,
                    slope=slope,
                    slope_sensitivity=jacobian @ dx + by_input @ self.du,
                    jacobian=jacobian,
                    network=network,
                )
            )
        return out

    def _mean_slope(self) -> ca.SX:
        total = ca.SX(self.model.nx, 1)
        for weight, evaluation in zip(_WEIGHT, self.evaluations, strict=True):
            total += weight * evaluation.slope
        return total

    def _mean_sensitivity(self) -> ca.SX:
        total = ca.SX(self.model.nx, self.nz)
        for weight, evaluation in zip(_WEIGHT, self.evaluations, strict=True):
            total += weight * evaluation.slope_sensitivity
        return total

    def _residual(self) -> None:
        """Set residual d, its Jacobian and Hessians in x, the running cost and its gradient in (x, u)."""
        model, nx = self.model, self.model.nx
        self.residual_jacobian: ca.SX | None = None
        running = model.effort(self.x, self.u, self.p)
        self._effort = running
        gradient = ca.gradient(running, self.xu)
        if model.residual is not None:
            d = model.residual(self.x, self.p)
            jacobian = ca.jacobian(d, self.x)
            rows = d.shape[0]
            mu = ca.SX.sym("mu", rows)
            hessian = ca.hessian(ca.dot(mu, d), self.x)[0]
            self._d_hessian = ca.Function("d_hessian", [self.x, self.p, mu], [hessian])
            vjps = jacobian.T @ d
            if model.network is not None:
                terms = self.evaluations[0].network or _network(model.network, self.x[NETWORK_INPUTS])
                d = d + _embed(terms.value, slice(0, 3), slice(0, 1), (rows, 1))
                back = terms.vjp(d[:3]) if model.network_rows is None else terms.jacobian.T @ d[:3]
                vjps = jacobian.T @ d + _embed(back, NETWORK_INPUTS, slice(0, 1), (nx, 1))
                jacobian = jacobian + _embed(terms.jacobian, slice(0, 3), NETWORK_INPUTS, (rows, nx))
                self._d_network_hessian = terms.hessian
            self.residual, self.residual_jacobian = d, jacobian
            running = running + ca.dot(d, d)
            gradient = gradient + ca.vertcat(2 * vjps, ca.SX(model.nu, 1))
        self.running, self.running_gradient = running, gradient

    def functions(self) -> Stage:
        """Return the functions."""
        model = self.model
        arguments = [self.x, self.u, self.h, self.h0, self.p]
        names = ["x", "u", "h", "h0_s", "p"]
        cost = self.running * self.step
        path = model.path(self.x, self.u, self.p)

        x_slope = _embed(ca.SX.eye(model.nx), slice(0, model.nx), slice(0, model.nx), (model.nx, self.nz))
        x_slope = x_slope + self.step * self._mean_sensitivity() + self._mean_slope() @ self.dh
        cost_slope = ca.vertcat(self.running_gradient * self.step, ca.SX(1, 1)) + self.dh.T * self.running
        path_slope = ca.jacobian(path, self.xu)

        sigma = ca.SX.sym("sigma")
        lam_x = ca.SX.sym("lam_x", model.nx)
        lam_path = ca.SX.sym("lam_path", path.shape[0])
        hessian = self._step_hessian(lam_x) + self._cost_hessian(sigma)
        path_hessian = ca.hessian(ca.dot(lam_path, path), self.xu)[0]
        hessian = hessian + _embed(
            path_hessian, slice(0, self.nz - 1), slice(0, self.nz - 1), (self.nz, self.nz)
        )
        return Stage(
            value=ca.Function(
                "value", arguments, [self.x_next, cost, path], names, ["x_next", "cost", "path"]
            ),
            gradient=ca.Function("gradient", arguments, [ca.densify(cost_slope)], names, ["cost_slope"]),
            slopes=ca.Function(
                "slopes", arguments, [ca.sparsify(x_slope), path_slope], names, ["x_slope", "path_slope"]
            ),
            hessian=ca.Function(
                "hessian",
                [*arguments, sigma, lam_x, lam_path],
                [ca.triu(ca.sparsify(hessian))],
                [*names, "sigma", "lam_x", "lam_path"],
                ["hessian"],
            ),
        )

    def _step_hessian(self, lam: ca.SX) -> ca.SX:
        """Return the Hessian in z of lam' x_next."""
        model, nz, nx = self.model, self.nz, self.model.nx
        adjoint: list[ca.SX] = [ca.SX(nx, 1)] * 4  # of each evaluation's slope
        vjps: list[ca.SX] = [ca.SX(nx, 1)] * 4  # of the state it was evaluated at
        for i in reversed(range(4)):
            adjoint[i] = _WEIGHT[i] * self.step * lam
            if i < 3:
                adjoint[i] = adjoint[i] + _ALONG[i + 1] * self.step * vjps[i + 1]
            vjps[i] = self.evaluations[i].jacobian.T @ adjoint[i]
        total = ca.SX(nz, nz)
        for evaluation, kappa in zip(self.evaluations, adjoint, strict=True):
            hessian = self._f_hessian(evaluation.x, self.u, self.p, kappa)
            if evaluation.network is not None and (rows := model.network_rows) is not None:
                block = evaluation.network.hessian(kappa[rows])
                hessian = hessian + _embed(
                    block, NETWORK_INPUTS, NETWORK_INPUTS, (nx + model.nu, nx + model.nu)
                )
            spread = ca.vertcat(evaluation.sensitivity, self.du)
            total = total + spread.T @ (hessian @ spread)
        cross = self._mean_sensitivity().T @ lam
        for i in range(1, 4):
            cross = cross + _ALONG[i] * (self.evaluations[i - 1].slope_sensitivity.T @ vjps[i])
        mixed = cross @ self.dh
        return total + mixed + mixed.T

    def _cost_hessian(self, sigma: ca.SX) -> ca.SX:
        """Return the Hessian in z of sigma cost."""
        model, nz = self.model, self.nz
        states, both = slice(0, model.nx), slice(0, nz - 1)
        block = ca.hessian(self._effort, self.xu)[0] * (sigma * self.step)
        total = _embed(block, both, both, (nz, nz))
        if self.residual_jacobian is not None:
            jacobian, mu = self.residual_jacobian, 2 * sigma * self.step * self.residual
            hessian = self._d_hessian(self.x, self.p, mu) + 2 * sigma * self.step * (jacobian.T @ jacobian)
            total = total + _embed(hessian, states, states, (nz, nz))
            if model.network is not None:
                learned = self._d_network_hessian(mu[:3])
                total = total + _embed(learned, NETWORK_INPUTS, NETWORK_INPUTS, (nz, nz))
        mixed = sigma * (ca.vertcat(self.running_gradient, ca.SX(1, 1)) @ self.dh)
        return total + mixed + mixed.T


@held_interrupts()
def build_stage(model: StageModel) -> Stage:
    """Return the interval's functions for a model.

    Deterministic: the same model gives the same instructions.
    """
    return _Builder(model).functions()
