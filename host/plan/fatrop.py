"""Fatrop on an assembled problem, by its own C interface.

Fatrop comes with CasADi's wheel. CasADi's interface to it searches for the blocks of the stages, in time that
grows with the square of their number; here the blocks are known. `fatrop.c` copies between Fatrop's matrices
and the assembly's flat arrays.
"""

from __future__ import annotations

import ctypes
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.libraries import load_library
from trimtab.host.plan.fatrop_chain import Chain, Values
from trimtab.host.plan.problem import Enough, SolveStatus
from trimtab.host.plan.transcription import Assembly

Array = NDArray[np.float64]

_SOURCE = Path(__file__).parent / "fatrop.c"
_WHEEL = Path(ca.__file__).parent
_EVALUATIONS = 30
"""Evaluations allowed per iteration allowed: the bound on a line search without end."""
_PIVOT, _PIVOT_STEP_S = 1e-4, 0.025
"""Least pivot when a stage's equalities are eliminated, at steps of this length or longer.

For shorter steps it is scaled by the square of the step. Smaller pivots are left to an earlier stage. Rest at
the end is reached through five integrations of the input, whose pivots within one step are tiny. If they are
used, the Hessian never appears definite and Fatrop searches without end. If too few pivots are used, rows
accumulate and appear dependent.
"""
_NEAR = {"mu_init": 1e-3, "bound_push": 1e-4, "bound_frac": 1e-4}
"""Options for a start near the solution; the defaults would move it further into its box first."""
_LOOK_S = 0.02
_SILENT_S, _SILENT_STAGE_S = 0.5, 0.005
"""Processor time without a request after which Fatrop is taken to search without end: a base and a share per
stage. Making a Hessian definite takes it about twenty factorisations of about 30 us a stage.
"""
_SOLVER_BYTES_PER_BYTE = 64
"""Memory that Fatrop allocates per byte of Jacobian and Hessian, rounded up: 35 to 44 were measured."""
_ASLEEP: list[_Run] = []
"""Solves that were put to sleep: their threads still use their memory."""
_OBJECTIVE, _GRADIENT, _ROWS, _JACOBIAN, _HESSIAN = range(5)


@dataclass(frozen=True, kw_only=True)
class ChainResult:
    """The point at which Fatrop stopped. status: SOLVED, ACCEPTABLE or OTHER."""

    w: Annotated[np.ndarray, "unknowns"]
    status: SolveStatus
    iterations: int


def usable() -> bool:
    """Whether Fatrop and its headers are where CasADi's wheel has them."""
    return (_WHEEL / "include" / "fatrop" / "ocp" / "OCPCInterface.h").is_file() and bool(_libraries())


def solve_chain(
    assembly: Assembly,
    compiler: Compiler,
    *,
    tolerance: float,
    max_iterations: int,
    enough: Enough | None = None,
) -> ChainResult:
    """Return the assembly's optimum from its start, or the first acceptable point on the way.

    Raises what the assembly raises, and CodegenError without a compiler.
    """
    run = _Run(assembly, compiler, max_iterations, enough)
    with held_interrupts() as interrupted:  # Fatrop must return before its memory goes
        return run.solve(tolerance, interrupted)


def _libraries() -> tuple[Path, ...]:
    libraries = [sorted(_WHEEL.glob(f"lib{name}.*")) for name in ("blasfeo", "fatrop")]
    return tuple(paths[0] for paths in libraries) if all(libraries) else ()


@cache
def _fatrop() -> ctypes.CDLL:
    library = [ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL) for path in _libraries()][-1]
    for name in ("create", "get_primal", "get_stats"):
        getattr(library, f"fatrop_ocp_c_{name}").restype = ctypes.c_void_p
    return library


@cache
def _glue(compiler: Compiler) -> ctypes.CDLL:
    source = f"/* CasADi {ca.CasadiMeta.version()} */\n" + _SOURCE.read_text(encoding="utf-8")
    library = load_library(ctypes.CDLL, source, compiler, include=_WHEEL / "include")
    library.interface_bytes.restype = ctypes.c_long
    return library


class _Run:
    """One solve: the chain of stages, and the callback that computes what Fatrop asks for."""

    def __init__(
        self, assembly: Assembly, compiler: Compiler, max_iterations: int, enough: Enough | None
    ) -> None:
        self._assembly, self._glue = assembly, _glue(compiler)
        self._enough, self._cost, self._calm_iterations = enough, np.inf, 0
        self._acceptable: Array | None = None
        self._error: BaseException | None = None
        self._max_iterations = max_iterations
        self._evaluations_left = _EVALUATIONS * max_iterations
        self._values = values = Values.of(assembly)
        self._outputs = {
            _OBJECTIVE: (values.objective,),
            _GRADIENT: (values.gradient,),
            _ROWS: (values.rows,),
            _JACOBIAN: (values.jacobian, values.rows),
            _HESSIAN: (values.hessian, values.gradient),
        }
        self._solver = ctypes.c_void_p()
        self._requests, self._busy = 0, False
        self._chain = Chain(assembly, values, self._fill)

    def _fill(self, part: int) -> None:
        """Compute what C asks for.

        The first error is stored and ends the solve; later requests then get old numbers. All numbers that C
        gets are finite: with others Fatrop would search for a definite Hessian without end.
        """
        self._requests += 1
        self._busy = True
        outputs = self._outputs[part]
        if self._error is None and self._evaluations_left > 0:
            self._evaluations_left -= 1
            try:
                self._evaluate(part)
                if not all(np.isfinite(array).all() for array in outputs):
                    self._evaluations_left = 0
            except BaseException as error:  # C cannot pass it on
                self._error = error
        if self._error is not None or self._evaluations_left == 0 or self._acceptable is not None:
            for array in outputs:
                _make_finite(array)
            _fatrop().fatrop_ocp_c_set_option_int(self._solver, b"max_iter", ctypes.c_int(0))
        self._busy = False

    def _evaluate(self, part: int) -> None:
        assembly, values, w = self._assembly, self._values, self._values.w
        if part == _OBJECTIVE:
            values.objective[0] = assembly.objective(w)
        elif part == _GRADIENT:
            values.gradient[:] = assembly.gradient(w)
        elif part == _ROWS:
            values.rows[:] = assembly.rows(w)
        elif part == _JACOBIAN:
            values.jacobian[:] = assembly.jacobian(w)
            values.rows[:] = assembly.rows(w)
        else:
            sigma = float(values.sigma[0])
            values.hessian[:] = assembly.hessian(w, sigma, values.lam)
            values.gradient[:] = assembly.lagrangian_gradient(w, sigma, values.lam)
            self._judge()

    def _judge(self) -> None:
        """Store the point if it is acceptable. Fatrop asks for the Hessian once in every iteration."""
        if self._enough is None:
            return
        w = self._values.w
        cost, before = self._assembly.objective(w), self._cost
        calm = abs(cost - before) < self._enough.change * abs(cost)
        calm = calm and self._assembly.violation(w) <= self._enough.gap
        self._cost, self._calm_iterations = cost, self._calm_iterations + 1 if calm else 0
        if self._calm_iterations == 2:
            self._acceptable = w.copy()

    def _finishes(self, library: ctypes.CDLL, interrupted: Callable[[], bool]) -> bool:
        """Run Fatrop in a thread, and return whether it ended.

        A thread in which Fatrop has stopped asking for anything is put to sleep. The measure is the thread's
        processor time, so a busy machine ends nothing. Once `interrupted`, nothing more is evaluated.
        """
        solved = threading.Event()  # an interrupted join may report the thread's end too early
        released = threading.Event()  # until then the thread's number is valid

        def run() -> None:
            try:
                library.fatrop_ocp_c_solve(self._solver)
            finally:
                solved.set()
            released.wait()

        thread = threading.Thread(target=run, daemon=True)
        number = self._glue.sleep_signal()
        thread.start()
        assert thread.ident is not None
        requests, since = -1, 0.0
        while not solved.wait(_LOOK_S):
            used = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
            if interrupted():
                self._evaluations_left = 0
            if self._requests != requests:
                requests, since = self._requests, used
            elif used - since > _SILENT_S + _SILENT_STAGE_S * self._assembly.count and not self._busy:
                signal.pthread_kill(thread.ident, number)
                return False
        released.set()
        return True

    def solve(self, tolerance: float, interrupted: Callable[[], bool]) -> ChainResult:
        """Return where Fatrop stops. Raises what the assembly raises."""
        library = _fatrop()
        self._check_memory()
        interface = ctypes.create_string_buffer(self._glue.interface_bytes())
        self._glue.connect(interface, self._chain.pointer)
        self._solver = solver = ctypes.c_void_p(library.fatrop_ocp_c_create(interface, None, None))
        finished = True
        try:
            self._set_options(library, tolerance)
            finished = self._finishes(library, interrupted)
            if self._error is not None:
                raise self._error
            if not finished:
                return ChainResult(w=self._values.w.copy(), status=SolveStatus.OTHER, iterations=0)
            stats = ctypes.c_void_p(library.fatrop_ocp_c_get_stats(solver))
            solved = self._glue.flag(stats) == 0 and self._evaluations_left > 0
            iterations = int(self._glue.iterations(stats))
            primal = ctypes.c_void_p(library.fatrop_ocp_c_get_primal(solver))
            self._glue.unknowns(self._chain.pointer, primal)
        finally:
            if finished:
                library.fatrop_ocp_c_destroy(solver)
            else:
                _ASLEEP.append(self)
        if self._acceptable is not None and not solved:
            return ChainResult(w=self._acceptable, status=SolveStatus.ACCEPTABLE, iterations=iterations)
        status = SolveStatus.SOLVED if solved else SolveStatus.OTHER
        return ChainResult(w=self._values.w.copy(), status=status, iterations=iterations)

    def _check_memory(self) -> None:
        """Raise MemoryError if Fatrop could not allocate its matrices; it would then end the process."""
        bytes_given = self._values.jacobian.nbytes + self._values.hessian.nbytes
        np.empty(_SOLVER_BYTES_PER_BYTE * bytes_given, dtype=np.uint8)

    def _set_options(self, library: ctypes.CDLL, tolerance: float) -> None:
        problem = self._assembly.problem
        for name, value in (("print_level", 0), ("max_iter", self._max_iterations)):
            library.fatrop_ocp_c_set_option_int(self._solver, name.encode(), ctypes.c_int(value))
        step = min(1.0, float(problem.h0_s.mean()) / _PIVOT_STEP_S)
        numbers = {"tolerance": tolerance, "linsol_lu_fact_tol": _PIVOT * step * step}
        numbers |= _NEAR if problem.near else {}
        for name, number in numbers.items():
            library.fatrop_ocp_c_set_option_double(self._solver, name.encode(), ctypes.c_double(number))


def _make_finite(array: Array) -> None:
    """Replace what is not finite. Without the memory for that, set all to zero."""
    try:
        np.nan_to_num(array, copy=False)
    except MemoryError:
        array.fill(0.0)
