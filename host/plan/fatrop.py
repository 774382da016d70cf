"""Fatrop on an assembled problem, by its own C interface.

CasADi's wheel brings Fatrop with it. CasADi's interface to it looks for the stages' blocks in time that grows
with their number squared; here the blocks are known. What stays in C (`fatrop.c`) is the copying between
Fatrop's matrices and the assembly's flat arrays.
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
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen.compiler import Compiler, shared_library
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.plan.problem import Enough, SolveStatus
from trimtab.host.plan.transcription import Assembly, ranks

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_SOURCE = Path(__file__).parent / "fatrop.c"
_WHEEL = Path(ca.__file__).parent
_EVALUATIONS = 30
"""Times the iterations allowed: a line search that tries without end is ended."""
_PIVOT, _PIVOT_STEP_S = 1e-4, 0.025
"""Least pivot in eliminating a stage's equalities, at steps of this length or longer; shorter ones have less
of it, as their square. Smaller pivots wait for an earlier stage. A rest at the end is reached through five
integrations of the input, whose pivots in one step are next to nothing: with them the Hessian never looks
definite, and Fatrop searches on without end; where too few count, rows pile up and look dependent.
"""
_NEAR = {"mu_init": 1e-3, "bound_push": 1e-4, "bound_frac": 1e-4}
"""For a start near the solution; else Fatrop moves it further into its box, and takes longer to come back."""
_LOOK_S = 0.02
_SILENT_S, _SILENT_STAGE_S = 0.5, 0.005
"""Processor time after which Fatrop is taken to search without end: in all, and for every stage. Making a
Hessian definite takes it some twenty factorisations, of some 30 us a stage.
"""
_ASLEEP: list[_Run] = []
"""Solves that were put to sleep: what their threads hold must stay."""
_FILL = ctypes.CFUNCTYPE(None, ctypes.c_int)
_OBJECTIVE, _GRADIENT, _ROWS, _JACOBIAN, _HESSIAN = range(5)


class _Entries(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_long),
        *((name, ctypes.c_void_p) for name in ("stage", "row", "column", "source")),
    )


class _Chain(ctypes.Structure):
    _fields_ = (
        ("stages", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in ("nx", "nu", "equalities", "inequalities", "start")),
        *((name, ctypes.c_void_p) for name in ("initial", "lower", "upper")),
        *((name, ctypes.c_void_p) for name in ("w", "objective", "gradient", "rows", "jacobian", "hessian")),
        *((name, ctypes.c_void_p) for name in ("lam", "sigma")),
        ("fill", _FILL),
        *((name, ctypes.c_void_p) for name in ("gap_row", "equal_row", "bounded_row", "bounded_w")),
        ("equal_to", ctypes.c_void_p),
        *((name, _Entries) for name in ("dynamics", "equal", "bounded", "bend")),
    )


@dataclass(frozen=True, kw_only=True)
class Found:
    """Where Fatrop stopped. w: (width,); status: SOLVED, ACCEPTABLE or OTHER."""

    w: Array
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
) -> Found:
    """Return the assembly's optimum from its start, or the first acceptable point on the way.

    Raises what the assembly raises, CodegenError without a compiler.
    """
    run = _Run(assembly, compiler, max_iterations, enough)
    with held_interrupts() as interrupted:  # the solver outlives whatever runs in it
        return run.solve(tolerance, interrupted)


def _libraries() -> tuple[Path, ...]:
    found = [sorted(_WHEEL.glob(f"lib{name}.*")) for name in ("blasfeo", "fatrop")]
    return tuple(paths[0] for paths in found) if all(found) else ()


@cache
def _fatrop() -> ctypes.CDLL:
    for path in _libraries():
        library = ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    for name in ("create", "get_primal", "get_stats"):
        getattr(library, f"fatrop_ocp_c_{name}").restype = ctypes.c_void_p
    return library


@cache
def _glue(compiler: Compiler) -> ctypes.CDLL:
    source = f"/* CasADi {ca.CasadiMeta.version()} */\n" + _SOURCE.read_text(encoding="utf-8")
    library = ctypes.CDLL(str(shared_library(source, compiler, include=_WHEEL / "include")))
    library.interface_bytes.restype = ctypes.c_long
    return library


class _Run:
    """One solve: the chain's tables and arrays, and the callback that fills them."""

    def __init__(
        self, assembly: Assembly, compiler: Compiler, max_iterations: int, enough: Enough | None
    ) -> None:
        self._assembly, self._glue = assembly, _glue(compiler)
        self._enough, self._cost, self._calm = enough, np.inf, 0
        self._acceptable: Array | None = None
        self._kept: list[Any] = []
        self._error: BaseException | None = None
        self._max_iterations = max_iterations
        self._left = _EVALUATIONS * max_iterations
        pattern, source = assembly.whole_hessian
        self._w, self._lam = np.zeros(assembly.width), np.zeros(assembly.height)
        self._objective, self._sigma = np.zeros(1), np.zeros(1)
        self._gradient, self._rows = np.zeros(assembly.width), np.zeros(assembly.height)
        self._jacobian = np.zeros(assembly.slopes.count)
        self._hessian = np.zeros(assembly.upper.count)
        self._filled_by = {
            _OBJECTIVE: (self._objective,),
            _GRADIENT: (self._gradient,),
            _ROWS: (self._rows,),
            _JACOBIAN: (self._jacobian, self._rows),
            _HESSIAN: (self._hessian, self._gradient),
        }
        self._solver = ctypes.c_void_p()
        self._asked, self._busy = 0, False
        self._fill = _FILL(self._filled)
        self._chain = self._connected(pattern, source)

    def _connected(self, whole: tuple[Index, Index], source: Index) -> _Chain:
        a = self._assembly
        stages = a.count + 1
        nx, nu = a.nx_of, a.nu_of
        stage_of, row_stage = a.stage_of, a.row_stage
        within = ranks(stage_of)
        # Fatrop has a stage's inputs first.
        place = np.where(within < nx[stage_of], within + nu[stage_of], within - nx[stage_of])

        is_equal = ~a.is_gap & (a.g_low == a.g_high)
        is_bounded = ~a.is_gap & ~is_equal
        equal_row, bounded_row = np.flatnonzero(is_equal), np.flatnonzero(is_bounded)
        bounded_w = np.flatnonzero(np.isfinite(a.low) | np.isfinite(a.high))
        equalities = np.bincount(row_stage[equal_row], minlength=stages)
        of_rows = np.bincount(row_stage[bounded_row], minlength=stages)
        inequalities = of_rows + np.bincount(stage_of[bounded_w], minlength=stages)
        # Within a stage: its rows, then its unknowns.
        bounded_stage = np.concatenate([row_stage[bounded_row], stage_of[bounded_w]])
        order = np.argsort(bounded_stage, kind="stable")
        rows = np.concatenate([bounded_row, np.full(len(bounded_w), -1)])[order]
        unknowns = np.concatenate([np.full(len(bounded_row), -1), bounded_w])[order]
        number = ranks(bounded_stage[order])
        lower = np.concatenate([a.g_low[bounded_row], a.low[bounded_w]])[order]
        upper = np.concatenate([a.g_high[bounded_row], a.high[bounded_w]])[order]

        local = ranks(row_stage)  # of a row among those of its kind in its stage; gaps come first
        local[equal_row] = ranks(row_stage[equal_row])
        local[rows[rows >= 0]] = number[rows >= 0]
        r, c = a.slopes.rows, a.slopes.columns
        entry = np.arange(a.slopes.count)

        def entries(kept: NDArray[np.bool_]) -> _Entries:
            return self._entries(row_stage[r[kept]], place[c[kept]], local[r[kept]], entry[kept])

        own = is_bounded[r]
        bound_rows = unknowns >= 0
        bounded = self._entries(
            np.concatenate([row_stage[r[own]], stage_of[unknowns[bound_rows]]]),
            np.concatenate([place[c[own]], place[unknowns[bound_rows]]]),
            np.concatenate([local[r[own]], number[bound_rows]]),
            np.concatenate([entry[own], np.full(int(bound_rows.sum()), -1)]),
        )
        i, j = whole
        return _Chain(
            stages=stages,
            nx=self._ints(nx),
            nu=self._ints(nu),
            equalities=self._ints(equalities),
            inequalities=self._ints(inequalities),
            start=self._ints(a.start_of),
            initial=self._doubles(a.start()),
            lower=self._doubles(lower),
            upper=self._doubles(upper),
            w=self._doubles(self._w),
            objective=self._doubles(self._objective),
            gradient=self._doubles(self._gradient),
            rows=self._doubles(self._rows),
            jacobian=self._doubles(self._jacobian),
            hessian=self._doubles(self._hessian),
            lam=self._doubles(self._lam),
            sigma=self._doubles(self._sigma),
            fill=self._fill,
            gap_row=self._ints(a.row_start_of),
            equal_row=self._ints(equal_row),
            bounded_row=self._ints(rows),
            bounded_w=self._ints(unknowns),
            equal_to=self._doubles(a.g_low[equal_row]),
            dynamics=entries(a.is_gap[r] & (stage_of[c] == row_stage[r])),
            equal=entries(is_equal[r]),
            bounded=bounded,
            bend=self._entries(stage_of[i], place[i], place[j], source),
        )

    def _ints(self, numbers: Index) -> int:
        array = np.ascontiguousarray(numbers, dtype=np.int32)
        self._kept.append(array)
        return array.ctypes.data

    def _doubles(self, numbers: Array) -> int:
        array = np.ascontiguousarray(numbers, dtype=float)
        self._kept.append(array)
        return array.ctypes.data

    def _entries(self, stage: Index, row: Index, column: Index, source: Index) -> _Entries:
        return _Entries(len(stage), *(self._ints(part) for part in (stage, row, column, source)))

    def _filled(self, part: int) -> None:
        """Compute what C asks for. An error is kept for later and ends the solve; what is asked for after it
        is old.

        No number that is none may come back: Fatrop would look for a definite Hessian without end.
        """
        self._asked += 1
        self._busy = True
        if self._error is None and self._left > 0:
            self._left -= 1
            try:
                self._evaluate(part)
                if not all(np.isfinite(array).all() for array in self._filled_by[part]):
                    self._left = 0
            except BaseException as error:  # it must not be lost in C
                self._error = error
        if self._error is not None or self._left == 0 or self._acceptable is not None:
            for array in self._filled_by[part]:
                np.nan_to_num(array, copy=False)
            _fatrop().fatrop_ocp_c_set_option_int(self._solver, b"max_iter", ctypes.c_int(0))
        self._busy = False

    def _evaluate(self, part: int) -> None:
        assembly, w = self._assembly, self._w
        if part == _OBJECTIVE:
            self._objective[0] = assembly.objective(w)
        elif part == _GRADIENT:
            self._gradient[:] = assembly.gradient(w)
        elif part == _ROWS:
            self._rows[:] = assembly.rows(w)
        elif part == _JACOBIAN:
            self._jacobian[:] = assembly.jacobian(w)
            self._rows[:] = assembly.rows(w)
        else:
            sigma = float(self._sigma[0])
            self._hessian[:] = assembly.hessian(w, sigma, self._lam)
            self._gradient[:] = assembly.lagrangian_gradient(w, sigma, self._lam)
            self._judge()

    def _judge(self) -> None:
        """Note an acceptable point: Fatrop asks for the Hessian once an iteration, where it stands."""
        if self._enough is None:
            return
        cost, before = self._assembly.objective(self._w), self._cost
        calm = abs(cost - before) < self._enough.change * abs(cost)
        calm = calm and self._assembly.violation(self._w) <= self._enough.gap
        self._cost, self._calm = cost, self._calm + 1 if calm else 0
        if self._calm == 2:
            self._acceptable = self._w.copy()

    def _watched(self, library: ctypes.CDLL, interrupted: Callable[[], bool]) -> bool:
        """Whether Fatrop came to an end; it runs in a thread that is put to sleep where it asks for nothing
        more. Once `interrupted`, nothing more is evaluated for it.

        Time is the thread's own processor time: a busy machine ends nothing.
        """
        done = threading.Event()  # an interrupted join may say too early that the thread is
        left = threading.Event()  # the thread's number is good until then

        def run() -> None:
            try:
                library.fatrop_ocp_c_solve(self._solver)
            finally:
                done.set()
            left.wait()

        thread = threading.Thread(target=run, daemon=True)
        number = self._glue.sleep_signal()
        thread.start()
        assert thread.ident is not None
        seen, since = -1, 0.0
        while not done.wait(_LOOK_S):
            used = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
            if interrupted():
                self._left = 0
            if self._asked != seen:
                seen, since = self._asked, used
            elif used - since > _SILENT_S + _SILENT_STAGE_S * self._assembly.count and not self._busy:
                signal.pthread_kill(thread.ident, number)
                return False
        left.set()
        return True

    def solve(self, tolerance: float, interrupted: Callable[[], bool]) -> Found:
        library = _fatrop()
        interface = ctypes.create_string_buffer(self._glue.interface_bytes())
        self._glue.connect(interface, ctypes.byref(self._chain))
        self._solver = solver = ctypes.c_void_p(library.fatrop_ocp_c_create(interface, None, None))
        try:
            for name, value in (("print_level", 0), ("max_iter", self._max_iterations)):
                library.fatrop_ocp_c_set_option_int(solver, name.encode(), ctypes.c_int(value))
            step = min(1.0, float(self._assembly.problem.h0_s.mean()) / _PIVOT_STEP_S)
            numbers = {"tolerance": tolerance, "linsol_lu_fact_tol": _PIVOT * step * step}
            numbers |= _NEAR if self._assembly.problem.near else {}
            for name, number in numbers.items():
                library.fatrop_ocp_c_set_option_double(solver, name.encode(), ctypes.c_double(number))
            ended = self._watched(library, interrupted)
            if self._error is not None:
                raise self._error
            if not ended:
                return Found(w=self._w.copy(), status=SolveStatus.OTHER, iterations=0)
            stats = ctypes.c_void_p(library.fatrop_ocp_c_get_stats(solver))
            solved = self._glue.flag(stats) == 0 and self._left > 0
            iterations = int(self._glue.iterations(stats))
            self._glue.unknowns(
                ctypes.byref(self._chain), ctypes.c_void_p(library.fatrop_ocp_c_get_primal(solver))
            )
        finally:
            if ended:
                library.fatrop_ocp_c_destroy(solver)
            else:
                _ASLEEP.append(self)
        if self._acceptable is not None and not solved:
            return Found(w=self._acceptable, status=SolveStatus.ACCEPTABLE, iterations=iterations)
        status = SolveStatus.SOLVED if solved else SolveStatus.OTHER
        return Found(w=self._w.copy(), status=status, iterations=iterations)
