"""One shooting interval: RK4 step, stage cost and path rows, differentiated by CasADi.

An interval has z = (x, u, h). The functions are MX over several intervals at once, with an operation on
vectors for each operation of the dynamics and matrix products for the network. This is the portable path, and
independent of the derivatives in `kernel.c`.

Source: paper eqs. 10-11.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from trimtab.host.codegen.batch import vectorised
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.models.network import Network
from trimtab.host.models.step import rk4

NETWORK_INPUTS = slice(3, 9)  # v_ned and Theta in the state


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
    """CasADi functions of `width` intervals of h * h0_s seconds, z = (x, u, h).

    value(x, u, h, h0_s, p) -> x_next, cost, path. gradient(same) -> d cost/dz. slopes(same) -> d x_next/dz, d
    path/d(x, u).
    hessian(same, sigma, lam_x, lam_path) -> upper triangle of the Hessian in z of sigma cost + lam_x' x_next
    + lam_path' path.

    Inputs, values and gradients are matrices (width, rows). Slopes and Hessian are sparse, with each row and
    column repeated for all intervals: number i of interval k is at i * width + k.
    """

    width: int
    value: ca.Function
    gradient: ca.Function
    slopes: ca.Function
    hessian: ca.Function


@held_interrupts()
def build_stage(model: StageModel, width: int) -> Stage:
    """Return the functions of `width` intervals for a model.

    Deterministic: the same model gives the same instructions.
    """
    f, start = (vectorised(function, width) for function in _functions(model))
    x, u, p = f.mx_in()
    h, h0 = ca.MX.sym("h", width), ca.MX.sym("h0_s", width)
    step = h * h0
    d_start = _network(model, x)

    def slope(at: ca.MX, half: int) -> ca.MX:
        rate = f(at, u, p)
        if (rows := model.network_rows) is None or model.network is None:
            return rate
        return rate + _columns(_network(model, at) if half else d_start, rows.start, model.nx)

    x_next = rk4(slope, x, ca.repmat(step, 1, model.nx))
    running, d, path = start(x, u, p)
    if model.residual is not None:
        d += _columns(d_start, 0, d.shape[1])
        running += ca.sum2(d * d)
    cost = running * step

    arguments, names = [x, u, h, h0, p], ["x", "u", "h", "h0_s", "p"]
    z, xu = ca.veccat(x, u, h), ca.veccat(x, u)
    sigma, lam_x = ca.MX.sym("sigma", width), ca.MX.sym("lam_x", width, model.nx)
    lam_path = ca.MX.sym("lam_path", *path.shape)
    total = ca.dot(sigma, cost) + ca.dot(lam_x, x_next) + ca.dot(lam_path, path)
    cost_slope = ca.reshape(ca.gradient(ca.sum1(cost), z), width, -1)
    x_slope, path_slope = ca.jacobian(ca.vec(x_next), z), ca.jacobian(ca.vec(path), xu)
    return Stage(
        width=width,
        value=ca.Function("value", arguments, [x_next, cost, path], names, ["x_next", "cost", "path"]),
        gradient=ca.Function("gradient", arguments, [ca.densify(cost_slope)], names, ["cost_slope"]),
        slopes=ca.Function("slopes", arguments, [x_slope, path_slope], names, ["x_slope", "path_slope"]),
        hessian=ca.Function(
            "hessian",
            [*arguments, sigma, lam_x, lam_path],
            [ca.triu(ca.hessian(total, z)[0])],
            [*names, "sigma", "lam_x", "lam_path"],
            ["hessian"],
        ),
    )


def _functions(model: StageModel) -> tuple[ca.Function, ca.Function]:
    """Return (x, u, p) -> derivative, and (x, u, p) -> effort, residual, path, both without the network."""
    x, u, p = ca.SX.sym("x", model.nx), ca.SX.sym("u", model.nu), ca.SX.sym("p", model.np)
    residual = ca.SX(3, 1) if model.residual is None else model.residual(x, p)
    start = [model.effort(x, u, p), residual, model.path(x, u, p)]
    names, options = ["x", "u", "p"], {"cse": True}
    f = ca.densify(model.derivative(x, u, p))
    return (
        ca.Function("f", [x, u, p], [f], names, ["slope"], options),
        ca.Function(
            "start", [x, u, p], [*map(ca.densify, start)], names, ["effort", "residual", "path"], options
        ),
    )


def _network(model: StageModel, x: ca.MX) -> ca.MX:
    """Return the network's acceleration (width, 3) at states (width, nx); zeros without a network."""
    if model.network is None:
        return ca.MX(x.shape[0], 3)
    xi = ca.MX(ca.DM(model.network.xi))
    return model.network.layout.matrices(xi, x[:, NETWORK_INPUTS].T).T


def _columns(block: ca.MX, first: int, count: int) -> ca.MX:
    """Return a matrix of `count` columns that is `block` from the column `first` on."""
    width, columns = block.shape
    return ca.horzcat(ca.MX(width, first), block, ca.MX(width, count - first - columns))
