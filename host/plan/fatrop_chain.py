"""An assembled problem as the chain of stages that Fatrop's C interface takes (`fatrop.c`)."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trimtab.host.plan.sparse import ranks
from trimtab.host.plan.transcription import Assembly

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_FILL = ctypes.CFUNCTYPE(None, ctypes.c_int)


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
        *((name, _Entries) for name in ("dynamics", "equal", "bounded", "hessian_entries")),
    )


@dataclass(frozen=True, kw_only=True)
class Values:
    """Arrays that Fatrop and the assembly exchange numbers in: the point, and what is computed there.

    jacobian, hessian: nonzeros in the order of the assembly's `slopes` and `upper`.
    """

    w: Annotated[np.ndarray, "unknowns"]
    objective: Annotated[np.ndarray, "1"]
    gradient: Annotated[np.ndarray, "unknowns"]
    rows: Annotated[np.ndarray, "rows"]
    jacobian: Annotated[np.ndarray, "slopes"]
    hessian: Annotated[np.ndarray, "upper"]
    lam: Annotated[np.ndarray, "rows"]
    sigma: Annotated[np.ndarray, "1"]

    @classmethod
    def of(cls, assembly: Assembly) -> Values:
        """Return the arrays for an assembly, filled with zeros."""
        width, height = assembly.width, assembly.height
        return cls(
            w=np.zeros(width),
            objective=np.zeros(1),
            gradient=np.zeros(width),
            rows=np.zeros(height),
            jacobian=np.zeros(assembly.slopes.count),
            hessian=np.zeros(assembly.upper.count),
            lam=np.zeros(height),
            sigma=np.zeros(1),
        )


@dataclass(frozen=True, kw_only=True)
class _Inequalities:
    """Bounded rows and bounded unknowns together, stage by stage: in each its rows, then its unknowns.

    rows, unknowns: which row of the assembly, or which entry of w, each one is; -1 for the other kind.
    rank: place within its stage. counts: (stages,).
    """

    rows: Index
    unknowns: Index
    rank: Index
    counts: Index
    lower: Array
    upper: Array


def _inequalities(a: Assembly, bounded_row: Index, stages: int) -> _Inequalities:
    bounded_w = np.flatnonzero(np.isfinite(a.low) | np.isfinite(a.high))
    stage = np.concatenate([a.row_stage[bounded_row], a.stage_of[bounded_w]])
    order = np.argsort(stage, kind="stable")
    return _Inequalities(
        rows=np.concatenate([bounded_row, np.full(len(bounded_w), -1)])[order],
        unknowns=np.concatenate([np.full(len(bounded_row), -1), bounded_w])[order],
        rank=ranks(stage[order]),
        counts=np.bincount(stage, minlength=stages),
        lower=np.concatenate([a.g_low[bounded_row], a.low[bounded_w]])[order],
        upper=np.concatenate([a.g_high[bounded_row], a.high[bounded_w]])[order],
    )


class Chain:
    """The C structure of a problem. `fill` is called with what Fatrop wants computed into `values`."""

    def __init__(self, assembly: Assembly, values: Values, fill: Callable[[int], None]) -> None:
        self._memory: list[Any] = []  # C holds the arrays' addresses
        self._fill = _FILL(fill)
        self._chain = self._connect(assembly, values)

    @property
    def pointer(self) -> Any:
        """The structure's address, as an argument of C."""
        return ctypes.byref(self._chain)

    def _connect(self, a: Assembly, values: Values) -> _Chain:
        stages = a.count + 1
        is_equal = ~a.is_gap & (a.g_low == a.g_high)
        is_bounded = ~a.is_gap & ~is_equal
        equal_row = np.flatnonzero(is_equal)
        bounds = _inequalities(a, np.flatnonzero(is_bounded), stages)
        return _Chain(
            stages=stages,
            nx=self._ints(a.nx_of),
            nu=self._ints(a.nu_of),
            equalities=self._ints(np.bincount(a.row_stage[equal_row], minlength=stages)),
            inequalities=self._ints(bounds.counts),
            start=self._ints(a.start_of),
            initial=self._doubles(a.start()),
            lower=self._doubles(bounds.lower),
            upper=self._doubles(bounds.upper),
            **{name: self._doubles(array) for name, array in vars(values).items()},
            fill=self._fill,
            gap_row=self._ints(a.row_start_of),
            equal_row=self._ints(equal_row),
            bounded_row=self._ints(bounds.rows),
            bounded_w=self._ints(bounds.unknowns),
            equal_to=self._doubles(a.g_low[equal_row]),
            **self._matrices(a, is_equal, is_bounded, bounds),
        )

    def _matrices(
        self, a: Assembly, is_equal: NDArray[np.bool_], is_bounded: NDArray[np.bool_], bounds: _Inequalities
    ) -> dict[str, _Entries]:
        """Return where the nonzeros of the Jacobian and the Hessian are in Fatrop's matrices."""
        rank = ranks(a.stage_of)
        # Fatrop has the inputs of a stage first.
        nx, nu = a.nx_of[a.stage_of], a.nu_of[a.stage_of]
        place = np.where(rank < nx, rank + nu, rank - nx)

        row_rank = ranks(a.row_stage)  # of a row among those of its kind in its stage; gaps come first
        row_rank[is_equal] = ranks(a.row_stage[is_equal])
        is_row = bounds.rows >= 0
        row_rank[bounds.rows[is_row]] = bounds.rank[is_row]
        r, c = a.slopes.rows, a.slopes.columns
        stage, entry = a.row_stage[r], np.arange(a.slopes.count)

        def entries(chosen: NDArray[np.bool_]) -> tuple[Index, ...]:
            return stage[chosen], place[c[chosen]], row_rank[r[chosen]], entry[chosen]

        unknowns = bounds.unknowns[~is_row]
        of_unknowns = a.stage_of[unknowns], place[unknowns], bounds.rank[~is_row], np.full(len(unknowns), -1)
        of_rows = entries(is_bounded[r])
        (i, j), source = a.whole_hessian
        return {
            "dynamics": self._entries(*entries(a.is_gap[r] & (a.stage_of[c] == stage))),
            "equal": self._entries(*entries(is_equal[r])),
            "bounded": self._entries(*map(np.concatenate, zip(of_rows, of_unknowns, strict=True))),
            "hessian_entries": self._entries(a.stage_of[i], place[i], place[j], source),
        }

    def _ints(self, numbers: Index) -> int:
        return self._address(np.ascontiguousarray(numbers, dtype=np.int32))

    def _doubles(self, numbers: Array) -> int:
        return self._address(np.ascontiguousarray(numbers, dtype=float))

    def _address(self, array: NDArray[Any]) -> int:
        self._memory.append(array)
        return array.ctypes.data

    def _entries(self, stage: Index, row: Index, column: Index, source: Index) -> _Entries:
        return _Entries(len(stage), *(self._ints(part) for part in (stage, row, column, source)))
