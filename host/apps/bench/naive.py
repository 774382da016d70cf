"""A shooting problem in the usual CasADi style: an MX function of an interval, `map`, CasADi's derivatives.

The rigid body is an SX function, the network consists of matrix products, and RK4 calls both four times.
Ipopt with MUMPS and the exact Hessian solves it. Unknowns, bounds, rows, weights and start are those of the
given problem.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.host.shooting.problem import Problem
from trimtab.host.shooting.stage import NETWORK_INPUTS, StageModel

Array = NDArray[np.float64]

SOLVED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")


@dataclass(frozen=True, kw_only=True)
class Ended:
    """Result of a solve. build_s and solve_s: processor time before and from the first iteration."""

    solved: bool
    cost: float
    iterations: int
    build_s: float
    solve_s: float


def solve(model: StageModel, problem: Problem, *, tolerance: float, most_s: float) -> Ended:
    """Return the problem's local optimum from its start, given up after `most_s` of processor time.

    Raises ValueError for a problem with keep-out shapes.
    """
    began = time.process_time()
    interval = _interval(model)
    count = len(problem.leg_of)
    if problem.path_bounds[0].shape[0] != interval.size1_out(2):
        raise ValueError("keep-out shapes are not supported here")
    x, u = ca.MX.sym("x", model.nx, count + 1), ca.MX.sym("u", model.nu, count)
    h = ca.MX.sym("h", problem.legs)
    step_s = (h[problem.leg_of.tolist()] * ca.DM(problem.h0_s)).T
    x_next, cost, path = interval.map(count)(x[:, :-1], u, step_s, ca.DM(problem.parameters))
    nlp = {
        "x": ca.veccat(x, u, h),
        "f": ca.sum2(cost),
        "g": ca.veccat(x[:, 1:] - x_next, path, ca.sum2(step_s)),
    }
    run = ca.nlpsol("naive", "ipopt", nlp, ipopt(tolerance, most_s))
    given = _given(model, problem)
    built = time.process_time()
    found = run(**given)
    stats = run.stats()
    return Ended(
        solved=stats["return_status"] in SOLVED,
        cost=float(found["f"]),
        iterations=int(stats["iter_count"]),
        build_s=built - began,
        solve_s=time.process_time() - built,
    )


def ipopt(tolerance: float, most_s: float) -> dict[str, Any]:
    """Return options for Ipopt: silent, MUMPS, at most `most_s` of processor time."""
    return {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.linear_solver": "mumps",
        "ipopt.tol": tolerance,
        "ipopt.max_cpu_time": most_s,
    }


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """The problem in continuous time as functions of (x, u, p): state derivative, running cost, path rows."""

    slope: ca.Function
    cost: ca.Function
    path: ca.Function


def pieces(model: StageModel) -> Pieces:
    """Return the model's, with the network as matrix products."""
    symbols = ca.SX.sym("x", model.nx), ca.SX.sym("u", model.nu), ca.SX.sym("p", model.np)
    rigid = ca.Function("rigid", symbols, [model.derivative(*symbols)])
    effort = ca.Function("effort", symbols, [model.effort(*symbols)])
    path = ca.Function("path", symbols, [model.path(*symbols)])
    at = x, u, p = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu), ca.MX.sym("p", model.np)
    push = ca.MX(3, 1)
    if model.network is not None:
        push = model.network.layout.matrices(ca.DM(model.network.xi), x[NETWORK_INPUTS])
    xdot, cost = rigid(x, u, p), effort(x, u, p)
    if (rows := model.network_rows) is not None:
        before, after = rows.start, model.nx - rows.stop
        xdot += ca.vertcat(ca.MX(before, 1), push, ca.MX(after, 1))
    if model.residual is not None:
        residual = ca.Function("residual", [symbols[0], symbols[2]], [model.residual(symbols[0], symbols[2])])
        cost += ca.sumsqr(residual(x, p) + push)
    inline = {"always_inline": True}  # into the function of an interval
    slope, running = (ca.Function(name, at, [of], inline) for name, of in (("slope", xdot), ("cost", cost)))
    return Pieces(slope=slope, cost=running, path=path)


def _interval(model: StageModel) -> ca.Function:
    """Return the function of an interval: (x, u, step_s, p) -> x_next, cost, path."""
    parts = pieces(model)
    x, u, p = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu), ca.MX.sym("p", model.np)
    step_s = ca.MX.sym("step_s")
    k1 = parts.slope(x, u, p)
    k2 = parts.slope(x + 0.5 * step_s * k1, u, p)
    k3 = parts.slope(x + 0.5 * step_s * k2, u, p)
    k4 = parts.slope(x + step_s * k3, u, p)
    x_next = x + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    cost = step_s * parts.cost(x, u, p)
    return ca.Function("interval", [x, u, step_s, p], [x_next, cost, parts.path(x, u, p)])


def _given(model: StageModel, problem: Problem) -> dict[str, Array]:
    """Return start and bounds in the order of the unknowns and rows."""

    def unknowns(x: Array, u: Array, h: Array | float) -> Array:
        steps = np.broadcast_to(np.asarray(h, dtype=float), (problem.legs,))
        return np.concatenate([x.ravel("F"), u.ravel("F"), steps])

    low, high = (
        unknowns(x, u, h)
        for x, u, h in zip(problem.x_bounds, problem.u_bounds, problem.h_bounds, strict=True)
    )
    gaps = np.zeros(model.nx * len(problem.leg_of))
    rows = [
        np.concatenate([gaps, path.ravel("F"), [total_s]])
        for path, total_s in zip(problem.path_bounds, problem.total_bounds_s, strict=True)
    ]
    start = np.clip(unknowns(problem.x_start, problem.u_start, problem.h_start), low, high)
    return {"x0": start, "lbx": low, "ubx": high, "lbg": rows[0], "ubg": rows[1]}
