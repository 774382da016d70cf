"""Solves a chain of stages by our interior point method (`interior_point.c`), compiled for this machine."""

from __future__ import annotations

import ctypes
from typing import Final

from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.shooting.chain import Chain
from trimtab.host.shooting.problem import Solution, SolveStatus

_FIRST_BARRIER = 0.1
"""Barrier parameter of a start without multipliers."""
_RUNNING, _SOLVED, _STUCK, _NOT_FINITE = range(4)
_STATUS: Final = {
    _RUNNING: SolveStatus.ITERATIONS,
    _SOLVED: SolveStatus.SOLVED,
    _STUCK: SolveStatus.STEP,
    _NOT_FINITE: SolveStatus.INVALID_NUMBER,
}


def solve_chain(chain: Chain, *, tolerance: float, max_iterations: int) -> Solution:
    """Return the local optimum from the chain's start, without its time.

    tolerance: of gaps, slopes of the Lagrangian and complementarity; below 1e-6 rounding decides.
    """
    problem, memory, method = chain.problem, chain.memory, chain.method
    known = problem.multipliers
    memory.tolerance = tolerance
    memory.mu = _FIRST_BARRIER if known is None else known.barrier
    here = ctypes.byref(memory)
    with held_interrupts():  # C cannot pass on what its callback raises
        code = int(method.begin(here))
    iterations = 0
    while code == _RUNNING and iterations < max_iterations:
        with held_interrupts():
            code = int(method.iterate(here))
        iterations += code == _RUNNING
    x, u, h = chain.point()
    return Solution(
        status=_STATUS[code],
        x=x,
        u=u,
        h=h,
        t_s=problem.times_s(h),
        cost=memory.objective,
        iterations=iterations,
        solve_s=0.0,
        multipliers=chain.multipliers(),
        violation=memory.greatest,
        solver="interior point",
    )
