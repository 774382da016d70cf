"""A shooting problem as a chain of stages in fixed memory, as `interior_point.c` takes it.

The unknowns of a stage are the states, the step size and the elapsed time, then the inputs and the step size
of the next leg. Where steps are given, there is neither step size nor time; where the total time is not
bounded, there is no time. All stages are alike: the intervals of a leg hand on their step size, and the last
one sets that of the next leg.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.simd import aligned, simd_library
from trimtab.host.route.shapes import Shape
from trimtab.host.shooting.kernel import Kernel, point_in_lanes
from trimtab.host.shooting.places import Places
from trimtab.host.shooting.problem import Multipliers, Problem
from trimtab.host.shooting.stage import StageModel

Array = NDArray[np.float64]

_SOURCE = Path(__file__).parent / "interior_point.c"
_FILTER_SIZE = 500
_PLACES = ctypes.CFUNCTYPE(None, ctypes.c_int)
_ARRAYS = (
    "xi", "z", "x_next", "cost", "path", "x_slope", "cost_slope", "path_slope", "upper", "sigma", "lam",
    "path_lam", "positions", "place_value", "place_slope", "place_hessian", "place_lam", "h0_s", "new_leg",
    "equal_begin", "equal_at", "bound_begin", "bound_at", "equal_to", "low", "high", "w", "w_new", "dw",
    "costate", "costate_new", "equal_gap", "equal_y", "row", "s", "s_new", "ds", "y", "y_new", "z_low",
    "z_high", "dz_low", "dz_high", "stages", "ahead", "filter",
)  # fmt: skip
_NUMBERS = (
    "tolerance", "mu", "damping", "objective", "barrier", "violation", "greatest", "violation_most",
    "violation_small",
)  # fmt: skip


class Memory(ctypes.Structure):
    """The C structure `Problem`."""

    _fields_ = (
        *((name, ctypes.c_long) for name in ("count", "groups", "parameters", "places", "filter_size")),
        *((name, ctypes.c_void_p) for name in ("evaluate_values", "evaluate_hessians")),
        ("places_of", _PLACES),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
        *((name, ctypes.c_double) for name in _NUMBERS),
        ("filtered", ctypes.c_long),
    )


class Chain:
    """Memory of a problem, and the compiled method for its sizes. Nothing is allocated after the set-up.

    `memory` is what the C functions take. `set_parameters`, `set_first` and `start` change the problem in
    place. Raises CodegenError where the compiler fails.
    """

    def __init__(
        self,
        model: StageModel,
        kernel: Kernel,
        compiler: Compiler,
        problem: Problem,
        keep_out: Sequence[Shape] = (),
    ) -> None:
        self.problem, self.nx, self.nu = problem, model.nx, model.nu
        self.count = len(problem.leg_of)
        self._free = int(problem.steps_free)
        self._timed = int(problem.steps_free and bool(np.isfinite(problem.total_bounds_s).any()))
        self._states = model.nx + self._free + self._timed
        self.width = self._states + model.nu + self._free
        self.method = _method(model, kernel, compiler, self._free, self._timed)
        self._new_leg = np.append(problem.leg_of[1:] != problem.leg_of[:-1], False)
        self._places: Places | None = None
        if keep_out or problem.gates is not None:
            self._places = Places(problem.gates, keep_out, self.count)
        self._arrays = self._lanes(model, kernel) | self._of_places()
        self._limits()
        self._room()
        self._call = _PLACES(self._evaluate_places)
        self.memory = Memory(
            count=self.count,
            groups=len(self._arrays["z"]),
            parameters=model.np,
            places=0 if self._places is None else self._places.rows,
            filter_size=_FILTER_SIZE,
            evaluate_values=_address(kernel.values),
            evaluate_hessians=_address(kernel.hessians),
            places_of=self._call,
            **{name: self._arrays[name].ctypes.data for name in _ARRAYS},
        )
        self.start(problem.x_start, problem.u_start, problem.h_start, problem.multipliers)

    def set_parameters(self, parameters: Annotated[np.ndarray, "parameters intervals"]) -> None:
        """Set the parameters of all intervals."""
        self._given[: self.count] = parameters.T
        self._given[self.count :] = parameters[:, 0]
        self._parameters[:] = self._given.reshape(self._parameters.shape)

    def set_first(self, x: Annotated[np.ndarray, "states"]) -> None:
        """Set the states at the first node, which the problem fixes. `start` has to follow."""
        self._arrays["equal_to"][: self.nx] = x

    def start(
        self,
        x: Annotated[np.ndarray, "states nodes"],
        u: Annotated[np.ndarray, "inputs intervals"],
        h: Annotated[np.ndarray, "legs"],
        multipliers: Multipliers | None,
    ) -> None:
        """Set the unknowns and multipliers from which the method begins; unknown multipliers are zero."""
        p, arrays = self.problem, self._arrays
        w = self._present()
        w[:, : self.nx] = x.T
        w[:-1, self._states : self._states + self.nu] = u.T
        if self._free:
            steps = h[np.append(p.leg_of, p.leg_of[-1])]
            w[:, self.nx] = steps
            w[:-1, -1] = np.where(self._new_leg, steps[1:], 0.0)
            if self._timed:
                w[1:, self.nx + 1] = np.cumsum(p.h0_s * steps[:-1])
        w[self._fixed_unknowns] = arrays["equal_to"][self._is_unknown]
        arrays["costate"][:] = 0.0 if multipliers is None else multipliers.costates.T
        for name, at in (("equal_y", self._fixed), ("y", self._bounded)):
            arrays[name][:] = 0.0 if multipliers is None else multipliers.limits.T[at]

    def _lanes(self, model: StageModel, kernel: Kernel) -> dict[str, NDArray[Any]]:
        """Return the arrays over lanes; lanes beyond the last interval repeat the first."""
        p, nz = self.problem, model.nx + model.nu + 1
        lanes, z = kernel.lanes, point_in_lanes(nz, p.h0_s, p.parameters, kernel.lanes)
        groups = len(z)
        sizes = {
            "x_next": model.nx,
            "cost": 1,
            "path": max(1, kernel.rows),
            "x_slope": model.nx * nz,
            "cost_slope": nz,
            "path_slope": max(1, len(kernel.path_slope[0])),
            "upper": nz * (nz + 1) // 2,
            "lam": model.nx,
            "path_lam": kernel.rows,
        }
        xi = np.zeros(1) if model.network is None else np.ascontiguousarray(model.network.xi)
        arrays = {name: aligned((groups, size, lanes)) for name, size in sizes.items()}
        self._parameters = z[:, nz + 1 :].swapaxes(1, 2)
        self._given = np.zeros((groups * lanes, model.np))
        return arrays | {"xi": xi, "z": z, "sigma": aligned((1, lanes))}

    def _of_places(self) -> dict[str, NDArray[Any]]:
        rows = 0 if self._places is None else self._places.rows
        shapes = {"value": (rows,), "slope": (rows, 3), "hessian": (3, 3), "lam": (rows,)}
        arrays: dict[str, NDArray[Any]] = {
            f"place_{name}": np.zeros((self.count, *shape)) for name, shape in shapes.items()
        }
        return arrays | {
            "positions": np.zeros((self.count, 3)),
            "h0_s": np.ascontiguousarray(self.problem.h0_s),
            "new_leg": self._new_leg.astype(np.int32),
        }

    def _limits(self) -> None:
        """Place the bounds of unknowns and path rows, stage by stage; equal ones are equations."""
        p, arrays = self.problem, self._arrays
        shape = (self.count + 1, self.width + p.path_bounds[0].shape[0])
        low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
        bounds = (p.x_bounds, p.u_bounds, p.path_bounds, p.h_bounds, p.total_bounds_s)
        for out, x, u, path, h, total_s in zip((low, high), *bounds, strict=True):
            out[:, : self.nx] = x.T
            out[:-1, self._states : self._states + self.nu] = u.T
            out[:-1, self.width :] = path.T
            if self._free:
                out[np.append(True, self._new_leg), self.nx] = h
            if self._timed:
                out[[0, -1], self.nx + 1] = 0.0, total_s
        fixed = (low == high) & np.isfinite(low)
        bounded = ~fixed & (np.isfinite(low) | np.isfinite(high))
        for name, chosen in (("equal", fixed), ("bound", bounded)):
            stage, at = np.nonzero(chosen)
            counts = np.bincount(stage, minlength=self.count + 1)
            arrays[f"{name}_begin"] = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
            arrays[f"{name}_at"] = at.astype(np.int32)
        self._fixed, self._bounded = np.nonzero(fixed), np.nonzero(bounded)
        self._is_unknown = self._fixed[1] < self.width
        self._fixed_unknowns = tuple(index[self._is_unknown] for index in self._fixed)
        arrays |= {"equal_to": low[fixed], "low": low[bounded], "high": high[bounded]}
        arrays |= {name: np.zeros(int(fixed.sum())) for name in ("equal_gap", "equal_y")}
        of_bounds = ("row", "s", "s_new", "ds", "y", "y_new", "z_low", "z_high", "dz_low", "dz_high")
        arrays |= {name: np.zeros(int(bounded.sum())) for name in of_bounds}
        self._arrays = arrays

    def _room(self) -> None:
        """Allocate the unknowns, the multipliers and what an iteration needs."""
        nodes, arrays = self.count + 1, self._arrays
        arrays |= {name: aligned((nodes, self.width)) for name in ("w", "w_new", "dw")}
        arrays |= {name: np.zeros((nodes, self._states)) for name in ("costate", "costate_new")}
        arrays["stages"] = aligned((self.count * int(self.method.stage_bytes()) // 8,))
        arrays["ahead"] = aligned((nodes * int(self.method.ahead_bytes()) // 8,))
        arrays["filter"] = np.zeros((_FILTER_SIZE, 2))

    def _present(self) -> Annotated[np.ndarray, "nodes unknowns"]:
        """Return the present point's array: the method swaps it with the next point's."""
        arrays = self._arrays
        return arrays["w"] if arrays["w"].ctypes.data == self.memory.w else arrays["w_new"]

    def _evaluate_places(self, second: int) -> None:
        arrays, places = self._arrays, self._places
        assert places is not None
        if second:
            arrays["place_hessian"][:] = places.second(arrays["positions"], arrays["place_lam"])
        else:
            places.first(arrays["positions"])
            arrays["place_value"][:], arrays["place_slope"][:] = places.value, places.slope

    def point(
        self,
    ) -> tuple[
        Annotated[np.ndarray, "states nodes"],
        Annotated[np.ndarray, "inputs intervals"],
        Annotated[np.ndarray, "legs"],
    ]:
        """Return the states x, inputs u and step sizes h of the present point, with fixed values exact."""
        arrays = self._arrays
        w = self._present().copy()
        w[self._fixed_unknowns] = arrays["equal_to"][self._is_unknown]
        h = w[np.append(True, self._new_leg), self.nx] if self._free else np.ones(self.problem.legs)
        return w[:, : self.nx].T.copy(), w[:-1, self._states : self._states + self.nu].T.copy(), h.copy()

    def multipliers(self) -> Multipliers:
        """Return those at the present point."""
        limits = np.zeros((self.count + 1, self.width + self.problem.path_bounds[0].shape[0]))
        limits[self._fixed] = self._arrays["equal_y"]
        limits[self._bounded] = self._arrays["y"]
        return Multipliers(
            costates=self._arrays["costate"].T.copy(),
            limits=limits.T,
            barrier=self.memory.mu,
        )


def _method(model: StageModel, kernel: Kernel, compiler: Compiler, free: int, timed: int) -> ctypes.CDLL:
    """Return the compiled method for the sizes of a model. Raises CodegenError."""
    rows, columns = kernel.path_slope
    sizes = {"NX": model.nx, "NU": model.nu, "FREE": free, "TIMED": timed, "ROWS": kernel.rows}
    sizes["PATH_NNZ"] = max(1, len(rows))
    lines = [f"#define {name} {value}" for name, value in sizes.items()]
    for name, numbers in (("ROW", rows), ("COL", columns)):
        values = ", ".join(map(str, numbers.tolist())) or "0"
        lines.append(f"static const int PATH_{name}[] = {{{values}}};")
    source = "\n".join([*lines, _SOURCE.read_text(encoding="utf-8")])
    return _loaded(source, compiler)


@lru_cache(maxsize=32)
def _loaded(source: str, compiler: Compiler) -> ctypes.CDLL:
    method = simd_library(source, compiler)
    for name in ("stage_bytes", "ahead_bytes"):
        getattr(method, name).restype = ctypes.c_long
    return method


def _address(function: Callable[..., None]) -> int | None:
    return ctypes.cast(function, ctypes.c_void_p).value  # pyright: ignore[reportArgumentType]
