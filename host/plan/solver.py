"""A problem's local optimum from its start: by Fatrop, and by Ipopt where Fatrop does not converge."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen.compiler import compiled
from trimtab.host.plan import fatrop
from trimtab.host.plan.intervals import Engine
from trimtab.host.plan.problem import Enough, Multipliers, Problem, Solution, SolveStatus
from trimtab.host.plan.transcription import Assembly
from trimtab.host.route.shapes import Shape

Array = NDArray[np.float64]
Solver = Literal["fatrop", "ipopt"]

_WARM = {
    "ipopt.warm_start_init_point": "yes",
    "ipopt.mu_init": 1e-4,
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_bound_frac": 1e-6,
    "ipopt.warm_start_slack_bound_push": 1e-6,
    "ipopt.warm_start_slack_bound_frac": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
}
"""Options for a start near the solution, with multipliers; by default Ipopt moves it into its box."""

_STATUS = {
    "Solve_Succeeded": SolveStatus.SOLVED,
    "Solved_To_Acceptable_Level": SolveStatus.ACCEPTABLE,
    "Infeasible_Problem_Detected": SolveStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": SolveStatus.ITERATIONS,
    "Restoration_Failed": SolveStatus.RESTORATION,
    "Invalid_Number_Detected": SolveStatus.INVALID_NUMBER,
    "Search_Direction_Becomes_Too_Small": SolveStatus.STEP,
}


class _Callback(ca.Callback):
    """A CasADi function that calls a Python function on arrays."""

    def __init__(
        self,
        name: str,
        inputs: Sequence[tuple[str, ca.Sparsity]],
        outputs: Sequence[tuple[str, ca.Sparsity]],
        run: Callable[..., list[Array | float]],
    ) -> None:
        ca.Callback.__init__(self)
        self._ins, self._outs, self._run = inputs, outputs, run
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._ins)

    def get_n_out(self) -> int:
        return len(self._outs)

    def get_name_in(self, i: int) -> str:
        return self._ins[i][0]

    def get_name_out(self, i: int) -> str:
        return self._outs[i][0]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._ins[i][1]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._outs[i][1]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arg: Sequence[Any], res: Sequence[Any]) -> int:
        given = [
            np.zeros(pattern.nnz()) if part is None else np.frombuffer(part)
            for part, (_, pattern) in zip(arg, self._ins, strict=True)
        ]
        for buffer, value in zip(res, self._run(*given), strict=True):
            if buffer is not None:
                np.frombuffer(buffer)[:] = value
        return 0


def _functions(assembly: Assembly) -> tuple[dict[str, ca.Function], list[_Callback]]:
    """Return the functions that Ipopt needs, by CasADi's names, and the callbacks behind them."""
    one, none = ca.Sparsity.dense(1), ca.Sparsity(0, 1)
    w, rows = ca.Sparsity.dense(assembly.width), ca.Sparsity.dense(assembly.height)
    at, weighed = [("x", w), ("p", none)], [("lam:f", one), ("lam:g", rows)]

    def slopes(point: Array, _: Array) -> list[Array | float]:
        return [assembly.rows(point), assembly.jacobian(point)]

    def hessian(point: Array, _: Array, sigma: Array, lam: Array) -> list[Array | float]:
        return [assembly.hessian(point, float(sigma[0]), lam)]

    callbacks = [
        _Callback("nlp_f", at, [("f", one)], lambda point, _: [assembly.objective(point)]),
        _Callback("nlp_g", at, [("g", rows)], lambda point, _: [assembly.rows(point)]),
        _Callback(
            "nlp_grad_f",
            at,
            [("f", one), ("grad:f:x", w)],
            lambda point, _: [assembly.objective(point), assembly.gradient(point)],
        ),
        _Callback("nlp_jac_g", at, [("g", rows), ("jac:g:x", assembly.slopes.sparsity())], slopes),
        _Callback(
            "nlp_hess_l", [*at, *weighed], [("triu:hess:gamma:x:x", assembly.upper.sparsity())], hessian
        ),
    ]
    return {callback.name(): callback for callback in callbacks}, callbacks


def solve(
    engine: Engine,
    problem: Problem,
    *,
    keep_out: Sequence[Shape] = (),
    tolerance: float,
    max_iterations: int,
    enough: Enough | None = None,
    solver: Solver | None = None,
) -> Solution:
    """Return the local optimum from the given start.

    Fatrop solves, and Ipopt where Fatrop does not converge; `solver` selects one of them.
    enough: when Fatrop may stop early. `solve_s` is the processor time of both; it alone varies.
    """
    started = time.process_time()
    assembly = Assembly(engine, problem, keep_out)
    solution: Solution | None = None
    if solver != "ipopt" and fatrop.usable():
        end = compiled(
            lambda compiler: fatrop.solve_chain(
                assembly, compiler, tolerance=tolerance, max_iterations=max_iterations, enough=enough
            )
        )
        if end is not None:
            solution = _solution(assembly, end.w, end.status, end.iterations, "fatrop")
    if solution is None or (solver is None and not solution.status.usable):
        solution = _ipopt(assembly, tolerance, max_iterations)
    return replace(solution, solve_s=time.process_time() - started)


def _solution(assembly: Assembly, w: Array, status: SolveStatus, iterations: int, solver: Solver) -> Solution:
    """Return a point as a solution, without its time."""
    problem = assembly.problem
    x, u, h = assembly.split(w)
    return Solution(
        status=status,
        x=x,
        u=u,
        h=h,
        t_s=np.concatenate([[0.0], np.cumsum(h[problem.leg_of] * problem.h0_s)]),
        cost=assembly.objective(w),
        iterations=iterations,
        solve_s=0.0,
        multipliers=None,
        violation=assembly.violation(w),
        solver=solver,
    )


def _ipopt(assembly: Assembly, tolerance: float, max_iterations: int) -> Solution:
    """Return Ipopt's solution of a problem."""
    functions, callbacks = _functions(assembly)
    options: dict[str, Any] = {
        "cache": functions,
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": tolerance,
        "ipopt.max_iter": max_iterations,
    }
    given = {
        "x0": assembly.start(),
        "lbx": assembly.low,
        "ubx": assembly.high,
        "lbg": assembly.g_low,
        "ubg": assembly.g_high,
    }
    known = assembly.problem.multipliers
    if known is not None:
        options |= _WARM
        given |= {"lam_x0": known.bounds, "lam_g0": known.rows}
    w, none = ca.MX.sym("x", assembly.width), ca.MX.sym("p", 0, 1)
    nlp = {"x": w, "f": functions["nlp_f"](w, none), "g": functions["nlp_g"](w, none)}
    run = ca.nlpsol("plan", "ipopt", nlp, options)
    result = run(**given)
    stats = run.stats()
    del callbacks  # CasADi holds no reference to them
    end = _solution(
        assembly,
        np.asarray(result["x"]).ravel(),
        _STATUS.get(stats["return_status"], SolveStatus.OTHER),
        int(stats["iter_count"]),
        "ipopt",
    )
    multipliers = Multipliers(
        bounds=np.asarray(result["lam_x"]).ravel(), rows=np.asarray(result["lam_g"]).ravel()
    )
    return replace(end, multipliers=multipliers)
