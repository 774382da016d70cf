"""Solves a chain of stages by our interior point method (`interior_point.c`), compiled for this machine."""

from __future__ import annotations

import ctypes
from typing import Final

import numpy as np

from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.plan.chain import Chain
from trimtab.host.plan.problem import Enough, Solution, SolveStatus

_FIRST_BARRIER = 0.1
"""Barrier parameter of a start without multipliers."""
_CALM_ITERATIONS = 2
_RUNNING, _SOLVED, _STUCK, _NOT_FINITE = range(4)
_STATUS: Final = {
    _RUNNING: SolveStatus.ITERATIONS,
    _SOLVED: SolveStatus.SOLVED,
    _STUCK: SolveStatus.STEP,
    _NOT_FINITE: SolveStatus.INVALID_NUMBER,
}


def solve_chain(
    chain: Chain, *, tolerance: float, max_iterations: int, enough: Enough | None = None
) -> Solution:
    """Return the local optimum from the chain's start, without its time.

    It ends at the tolerance, or at a point that is `enough`: only once the barrier parameter is within the
    tolerance, so that no cost of the barrier is left to gain.
    """
    problem, memory, method = chain.problem, chain.memory, chain.method
    known = problem.multipliers
    memory.tolerance = tolerance
    memory.mu = _FIRST_BARRIER if known is None else known.barrier
    memory.scale = 1.0 if known is None else known.scale
    here = ctypes.byref(memory)
    with held_interrupts():  # C cannot pass on what its callback raises
        code = int(method.begin(here))
    iterations, calm, cost = 0, 0, np.inf
    while code == _RUNNING and iterations < max_iterations and calm < _CALM_ITERATIONS:
        with held_interrupts():
            code = int(method.iterate(here))
        iterations += code == _RUNNING
        before, cost = cost, memory.objective
        near = enough is not None and memory.mu <= tolerance and memory.greatest <= enough.gap
        calm = calm + 1 if near and abs(cost - before) < enough.change * abs(cost) else 0
    status = SolveStatus.ACCEPTABLE if calm == _CALM_ITERATIONS else _STATUS[code]
    x, u, h = chain.point()
    return Solution(
        status=status,
        x=x,
        u=u,
        h=h,
        t_s=np.concatenate([[0.0], np.cumsum(h[problem.leg_of] * problem.h0_s)]),
        cost=memory.objective / memory.scale,
        iterations=iterations,
        solve_s=0.0,
        multipliers=chain.multipliers(),
        violation=memory.greatest,
        solver="interior point",
    )
