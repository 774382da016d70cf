"""Solves a chain of stages by our interior point method (`interior_point.c`), compiled for this machine."""

from __future__ import annotations

import ctypes
from contextlib import nullcontext
from typing import Final

from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.shooting.chain import Chain
from trimtab.host.shooting.problem import Multipliers, Solution, SolveStatus

_FIRST_BARRIER = 0.1
"""Barrier parameter of a start without multipliers."""
_RUNNING, _SOLVED, _STUCK, _NOT_FINITE = range(4)
_STATUS: Final = {
    _RUNNING: SolveStatus.ITERATIONS,
    _SOLVED: SolveStatus.SOLVED,
    _STUCK: SolveStatus.STEP,
    _NOT_FINITE: SolveStatus.INVALID_NUMBER,
}


def solve_chain(
    chain: Chain, known: Multipliers | None, *, tolerance: float, max_iterations: int
) -> Solution:
    """Return the local optimum from the chain's start, without its time.

    known: the multipliers of that start. tolerance: of gaps, slopes of the Lagrangian and complementarity;
    below 1e-6 rounding decides.
    """
    problem, memory, method = chain.problem, chain.memory, chain.method
    memory.tolerance = tolerance
    memory.mu = _FIRST_BARRIER if known is None else known.barrier
    here = ctypes.byref(memory)
    guard = held_interrupts if memory.places else nullcontext  # C cannot pass on what its callback raises
    with guard():
        code = int(method.begin(here))
    iterations = 0
    while code == _RUNNING and iterations < max_iterations:
        with guard():
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
