"""A shooting problem by rockit (MECO, KU Leuven): multiple shooting by RK4, a stage a leg, Ipopt and MUMPS.

Unknowns, bounds, cost and start are those of the given problem; a leg's free time is its step size times its
nominal time.
"""

from __future__ import annotations

import importlib.util
import time
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.host.apps.bench.naive import SOLVED, Ended, Pieces, ipopt, pieces
from trimtab.host.shooting.problem import Problem
from trimtab.host.shooting.stage import StageModel

Array = NDArray[np.float64]

_NONE = 1e20
"""A bound that is none to Ipopt; rockit's parameters are finite."""


def installed() -> bool:
    """Return whether rockit can be imported."""
    return importlib.util.find_spec("rockit") is not None


def solve(model: StageModel, problem: Problem, *, tolerance: float, most_s: float) -> Ended:
    """Return the problem's local optimum from its start, given up after `most_s` of processor time.

    Raises ValueError for a problem with keep-out shapes, or if a leg does not have its own free step size.
    """
    import rockit  # pyright: ignore[reportMissingImports]

    parts = pieces(model)
    if problem.path_bounds[0].shape[0] != parts.path.size1_out(0):
        raise ValueError("keep-out shapes are not supported here")
    if not problem.steps_free:
        raise ValueError("only one free step size per leg is supported here")
    began = time.process_time()
    ocp = rockit.Ocp()
    ends: list[ca.MX] = []
    total_s = ca.MX(0)
    for leg in range(problem.legs):
        stage, x = _add_leg(rockit, ocp, leg, model, parts, problem)
        if ends:
            ocp.subject_to(ends[-1] == stage.at_t0(x))
        ends.append(stage.at_tf(x))
        total_s += stage.T
    low, high = (ca.DM(bound[:, -1]) for bound in problem.x_bounds)
    ocp.subject_to(low <= (ends[-1] <= high))
    if np.isfinite(problem.total_bounds_s).all():
        least_s, most = problem.total_bounds_s
        ocp.subject_to(least_s <= (total_s <= most))
    ocp.solver("ipopt", {**ipopt(tolerance, most_s), "record_time": True})
    _ = ocp.gist  # transcribed: from here on only the solver can fail
    try:
        found = ocp.solve()
    except RuntimeError:
        found = ocp.non_converged_solution
    stats = found.stats
    return Ended(
        solved=stats["return_status"] in SOLVED,
        cost=float(found.value(ocp.objective)),
        iterations=int(stats["iter_count"]),
        build_s=time.process_time() - began - stats["t_proc_total"],
        solve_s=stats["t_proc_total"],
    )


def _add_leg(
    rockit: Any, ocp: Any, leg: int, model: StageModel, parts: Pieces, problem: Problem
) -> tuple[Any, ca.MX]:
    """Return the leg's stage and its state."""
    at = np.flatnonzero(problem.leg_of == leg)
    intervals, nodes = slice(at[0], at[-1] + 1), slice(at[0], at[-1] + 2)
    nominal_s = float(problem.h0_s[intervals].sum())
    stage = ocp.stage(t0=0.0, T=rockit.FreeTime(nominal_s * float(problem.h_start[leg])))
    stage.method(rockit.MultipleShooting(N=len(at), M=1, intg="rk"))
    x, u = stage.state(model.nx), stage.control(model.nu)
    p = stage.parameter(model.np, grid="control")
    stage.set_value(p, problem.parameters[:, intervals])
    stage.set_der(x, parts.slope(x, u, p))
    for rows, bounds in (
        (x, problem.x_bounds),
        (u, problem.u_bounds),
        (parts.path(x, u, p), problem.path_bounds),
    ):
        _bound(stage, rows, bounds[0][:, intervals], bounds[1][:, intervals])
    least, most = problem.h_bounds
    ocp.subject_to((least * nominal_s <= stage.T) <= most * nominal_s)
    ocp.add_objective(stage.sum(stage.DT_control * parts.cost(x, u, p)))
    stage.set_initial(x, np.clip(problem.x_start, *problem.x_bounds)[:, nodes])
    stage.set_initial(u, np.clip(problem.u_start, *problem.u_bounds)[:, intervals])
    return stage, x


def _bound(stage: Any, rows: ca.MX, low: Array, high: Array) -> None:
    """Bound the rows at the start of every interval, except those without a bound."""
    kept = np.flatnonzero((np.isfinite(low) | np.isfinite(high)).any(axis=1))
    if not len(kept):
        return
    floor, roof = (stage.parameter(len(kept), grid="control") for _ in range(2))
    stage.set_value(floor, np.maximum(low[kept], -_NONE))
    stage.set_value(roof, np.minimum(high[kept], _NONE))
    stage.subject_to(floor <= (rows[kept.tolist()] <= roof), include_last=False)
