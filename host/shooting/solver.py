"""A problem's local optimum from its start: by our interior point method, or else by Ipopt."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.host.base.parallel import one_thread_of_algebra
from trimtab.host.codegen.compiler import compiled
from trimtab.host.route.shapes import Shape
from trimtab.host.shooting.chain import Chain
from trimtab.host.shooting.interior_point import solve_chain
from trimtab.host.shooting.intervals import Engine
from trimtab.host.shooting.problem import Multipliers, Problem, Solution, SolveStatus
from trimtab.host.shooting.stage import StageModel
from trimtab.host.shooting.transcription import Assembly

Array = NDArray[np.float64]
Solver = Literal["interior point", "ipopt"]

_NEAR = {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-6, "ipopt.bound_frac": 1e-6}
"""Options for a start near the solution; by default Ipopt moves it into its box."""

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
    solver: Solver | None = None,
) -> Solution:
    """Return the local optimum from the given start.

    Our method solves where there is a compiler, and Ipopt where it does not converge or there is none;
    `solver` selects one of them. `solve_s` is the processor time of
    both; it alone varies.
    """
    started = time.process_time()
    solution: Solution | None = None
    kernel = engine.kernel
    if solver != "ipopt" and kernel is not None:
        chain = compiled(lambda compiler: Chain(engine.model, kernel, compiler, problem, keep_out))
        if chain is not None:
            solution = solve_chain(
                chain, problem.multipliers, tolerance=tolerance, max_iterations=max_iterations
            )
    if solution is None or (solver is None and not solution.status.usable):
        solution = _ipopt(Assembly(engine, problem, keep_out), tolerance, max_iterations)
    return replace(solution, solve_s=time.process_time() - started)


class Repeated:
    """A problem that is solved again and again, with other parameters, another first state and start.

    Our method solves it where there is a compiler, in memory that is allocated once; else Ipopt does. The
    steps and the first node's states are fixed.
    """

    def __init__(self, model: StageModel, problem: Problem) -> None:
        self._problem, self._engine = problem, Engine(model)
        kernel = self._engine.kernel
        self._chain: Chain | None = None
        if kernel is not None:
            self._chain = compiled(lambda compiler: Chain(model, kernel, compiler, problem))

    def solve(
        self,
        first: Annotated[np.ndarray, "states"],
        parameters: Annotated[np.ndarray, "parameters intervals"],
        x: Annotated[np.ndarray, "states nodes"],
        u: Annotated[np.ndarray, "inputs intervals"],
        multipliers: Multipliers | None,
        *,
        tolerance: float,
        max_iterations: int,
    ) -> Solution:
        """Return the local optimum from a start x, u, without its time; `multipliers` are those there."""
        problem, chain = self._problem, self._chain
        if chain is not None:
            chain.set_parameters(parameters)
            chain.set_first(first)
            chain.start(x, u, problem.h_start, multipliers)
            return solve_chain(chain, multipliers, tolerance=tolerance, max_iterations=max_iterations)
        low, high = (bounds.copy() for bounds in problem.x_bounds)
        low[:, 0] = high[:, 0] = first
        now = replace(problem, parameters=parameters, x_bounds=(low, high), x_start=x, u_start=u)
        return _ipopt(Assembly(self._engine, now, ()), tolerance, max_iterations)


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
    if assembly.problem.near:
        options |= _NEAR
    w, none = ca.MX.sym("x", assembly.width), ca.MX.sym("p", 0, 1)
    nlp = {"x": w, "f": functions["nlp_f"](w, none), "g": functions["nlp_g"](w, none)}
    run = ca.nlpsol("plan", "ipopt", nlp, options)  # loads its own library of algebra
    with one_thread_of_algebra():
        result = run(**given)
    stats = run.stats()
    del callbacks  # CasADi holds no reference to them
    w_end = np.asarray(result["x"]).ravel()
    x, u, h = assembly.split(w_end)
    problem = assembly.problem
    return Solution(
        status=_STATUS.get(stats["return_status"], SolveStatus.OTHER),
        x=x,
        u=u,
        h=h,
        t_s=problem.times_s(h),
        cost=assembly.objective(w_end),
        iterations=int(stats["iter_count"]),
        solve_s=0.0,
        multipliers=None,
        violation=assembly.violation(w_end),
        solver="ipopt",
    )
