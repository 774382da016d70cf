"""All intervals of a problem at once: in C over SIMD lanes, or in CasADi's virtual machine.

Both write their results into flat arrays that never move; an `Output` has the place of each number.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen.buffered import Buffered
from trimtab.host.codegen.compiler import compiled
from trimtab.host.codegen.simd import aligned, lanes_of
from trimtab.host.shooting.kernel import Kernel, kernel, point_in_lanes
from trimtab.host.shooting.stage import Stage, StageModel, build_stage

Array = NDArray[np.float64]
Index = NDArray[np.int64]


_WIDEST = 100
"""Most intervals in a block of the virtual machine: wider ones save little and take longer to build."""


@dataclass(frozen=True, kw_only=True)
class Output:
    """Results of one kind.

    flat: the numbers. at: place of each in `flat`. rows, columns: its row and column in the interval's matrix
    or vector.
    """

    flat: Annotated[np.ndarray, "numbers"]
    at: Annotated[Index, "intervals entries"]
    rows: Annotated[Index, "entries"]
    columns: Annotated[Index, "entries"]

    def dense(self, height: int, width: int = 1) -> Annotated[np.ndarray, "intervals height width"]:
        """Return the results as matrices, a copy."""
        out = np.zeros((len(self.at), height, width))
        out[:, self.rows, self.columns] = self.flat[self.at]
        return out


class Intervals(Protocol):
    """The evaluations that a problem's assembly needs, at the point of the last `set`; h is in units of h0.

    Slopes and Hessian are by z = (x, u, h), of the Hessian the upper triangle; path slopes are by (x, u).
    """

    x_next: Output
    cost: Output
    path: Output
    x_slope: Output
    cost_slope: Output
    path_slope: Output
    hessian: Output

    def set(
        self,
        x: Annotated[np.ndarray, "intervals states"],
        u: Annotated[np.ndarray, "intervals inputs"],
        h: Annotated[np.ndarray, "intervals"],
    ) -> None:
        """Set the point."""
        ...

    def values(self) -> None:
        """Compute x_next, cost and path."""
        ...

    def slopes(self) -> None:
        """Compute x_slope, cost_slope and path_slope."""
        ...

    def gradient(self) -> None:
        """Compute cost_slope alone."""
        ...

    def compute_hessian(
        self,
        sigma: float,
        lam_x: Annotated[np.ndarray, "intervals states"],
        lam_path: Annotated[np.ndarray, "intervals rows"],
    ) -> None:
        """Compute the Hessian of sigma cost + lam_x' x_next + lam_path' path."""
        ...


class Engine:
    """A stage model ready to be evaluated over any number of intervals.

    It runs in C where a compiler works and neither `engine` nor TRIMTAB_ENGINE decides otherwise, else in the
    virtual machine. Raises CodegenError where C is requested and not possible.
    """

    def __init__(self, model: StageModel, engine: str | None = None) -> None:
        self.model = model
        self._kernel = compiled(lambda compiler: kernel(model, compiler), engine)
        self._stages: dict[int, Stage] = {}

    @property
    def kernel(self) -> Kernel | None:
        """The compiled functions, None in the virtual machine."""
        return self._kernel

    def over(
        self,
        h0_s: Annotated[np.ndarray, "intervals"],
        parameters: Annotated[np.ndarray, "parameters intervals"],
    ) -> Intervals:
        """Return intervals with these nominal steps and parameters."""
        if self._kernel is not None:
            return _Lanes(self.model, self._kernel, h0_s, parameters)
        width = -(-len(h0_s) // -(-len(h0_s) // _WIDEST))
        if width not in self._stages:
            self._stages[width] = build_stage(self.model, width)
        return _Machine(self.model, self._stages[width], h0_s, parameters)


class _Lanes:
    """Intervals in lanes of the C kernel."""

    def __init__(self, model: StageModel, made: Kernel, h0_s: Array, parameters: Array) -> None:
        self._kernel, lanes = made, made.lanes
        count, nx, nu = len(h0_s), model.nx, model.nu
        nz = nx + nu + 1
        # Lanes beyond the last interval repeat the first, so their numbers are finite; nobody reads them.
        self._z = point_in_lanes(nz, h0_s, parameters, lanes)
        self._groups = len(self._z)
        self._nx, self._nu = nx, nu
        self._xi = np.zeros(1) if model.network is None else np.ascontiguousarray(model.network.xi)
        self._sigma = aligned((1, lanes))
        self._lam_x = aligned((self._groups, nx, lanes))
        self._lam_path = aligned((self._groups, made.rows, lanes))
        pattern = made.pattern
        self.x_next = self._output(count, np.ones((nx, 1), dtype=bool))
        self.cost = self._output(count, np.ones((1, 1), dtype=bool))
        rows = np.arange(made.rows)
        self.path = self._placed(count, max(1, made.rows), rows, rows, np.zeros_like(rows))
        self.x_slope = self._output(count, pattern.x_slope)
        self.cost_slope = self._output(count, np.ones((nz, 1), dtype=bool))
        rows, columns = made.path_slope
        entries = np.arange(len(rows))
        self.path_slope = self._placed(count, max(1, len(rows)), entries, rows, columns)
        rows, columns = np.nonzero(pattern.hessian)
        number = np.zeros((nz, nz), dtype=np.int64)
        number[np.triu_indices(nz)] = np.arange(nz * (nz + 1) // 2)
        self.hessian = self._placed(count, nz * (nz + 1) // 2, number[rows, columns], rows, columns)

    def _output(self, count: int, mask: NDArray[np.bool_]) -> Output:
        rows, columns = np.nonzero(mask)
        return self._placed(count, mask.size, rows * mask.shape[1] + columns, rows, columns)

    def _placed(self, count: int, size: int, entries: Index, rows: Index, columns: Index) -> Output:
        """Return an output of `size` numbers in each lane; `entries` of them are read."""
        k = np.arange(count)[:, None]
        lanes = self._kernel.lanes
        at = (k // lanes) * (size * lanes) + entries * lanes + k % lanes
        flat = aligned((self._groups, size, lanes)).reshape(-1)
        return Output(flat=flat, at=at, rows=rows, columns=columns)

    def set(
        self,
        x: Annotated[np.ndarray, "intervals states"],
        u: Annotated[np.ndarray, "intervals inputs"],
        h: Annotated[np.ndarray, "intervals"],
    ) -> None:
        nx, nu = self._nx, self._nu
        lanes = self._kernel.lanes
        self._z[:, :nx] = lanes_of(x, lanes)
        self._z[:, nx : nx + nu] = lanes_of(u, lanes)
        self._z[:, nx + nu] = lanes_of(h, lanes)

    def values(self) -> None:
        self._call(self._kernel.values, self._z, self.x_next.flat, self.cost.flat, self.path.flat)

    def slopes(self) -> None:
        self._slopes(dynamics=True)

    def gradient(self) -> None:
        self._slopes(dynamics=False)

    def _slopes(self, *, dynamics: bool) -> None:
        outputs = (self.x_slope.flat, self.cost_slope.flat, self.path_slope.flat)
        self._call(self._kernel.slopes, ctypes.c_long(dynamics), self._z, *outputs)

    def compute_hessian(
        self,
        sigma: float,
        lam_x: Annotated[np.ndarray, "intervals states"],
        lam_path: Annotated[np.ndarray, "intervals rows"],
    ) -> None:
        self._sigma[:] = sigma
        self._lam_x[:] = lanes_of(lam_x, self._kernel.lanes)
        self._lam_path[:] = lanes_of(lam_path, self._kernel.lanes)
        outputs = (self.x_slope.flat, self.cost_slope.flat, self.path_slope.flat, self.hessian.flat)
        self._call(self._kernel.hessians, self._z, self._sigma, self._lam_x, self._lam_path, *outputs)

    def _call(self, function: object, *arguments: ctypes.c_long | Array) -> None:
        assert callable(function)
        pointers = [
            ctypes.c_void_p(part.ctypes.data) if isinstance(part, np.ndarray) else part for part in arguments
        ]
        function(ctypes.c_void_p(self._xi.ctypes.data), ctypes.c_long(self._groups), *pointers)


class _Machine:
    """Intervals in CasADi's virtual machine, in blocks of the stage's width."""

    def __init__(self, model: StageModel, stage: Stage, h0_s: Array, parameters: Array) -> None:
        count, width = len(h0_s), stage.width
        blocks = -(-count // width)
        self._shape = (blocks, width)
        # Beyond the last interval the first is repeated, so the numbers are finite; nobody reads them.
        self._lane = np.where(np.arange(blocks * width) < count, np.arange(blocks * width), 0)
        self._at = np.arange(count)
        self._functions = {
            name: Buffered(function.map(blocks))
            for name, function in (
                ("value", stage.value),
                ("slopes", stage.slopes),
                ("gradient", stage.gradient),
                ("hessian", stage.hessian),
            )
        }
        for function in self._functions.values():
            function.inputs["h0_s"][:] = h0_s[self._lane].reshape(self._shape)
            function.inputs["p"][:] = self._in_blocks(parameters.T)
        self.x_next = self._values(stage, "value", "x_next")
        self.cost = self._values(stage, "value", "cost")
        self.path = self._values(stage, "value", "path")
        self.cost_slope = self._values(stage, "gradient", "cost_slope")
        self.x_slope = self._matrices(stage, "slopes", "x_slope")
        self.path_slope = self._matrices(stage, "slopes", "path_slope")
        self.hessian = self._matrices(stage, "hessian", "hessian")

    def _values(self, stage: Stage, function: str, name: str) -> Output:
        rows = np.arange(getattr(stage, function).size2_out(name))
        block, lane = np.divmod(self._at, stage.width)
        at = ((block * len(rows))[:, None] + rows) * stage.width + lane[:, None]
        flat = self._functions[function].outputs[name].reshape(-1)
        return Output(flat=flat, at=at, rows=rows, columns=np.zeros_like(rows))

    def _matrices(self, stage: Stage, function: str, name: str) -> Output:
        """Return the place of each number of sparse matrices, whose rows and columns are repeated."""
        triplet = getattr(stage, function).sparsity_out(name).get_triplet()
        rows, columns = (np.array(each, dtype=int) for each in triplet)
        order = np.lexsort((columns, rows, rows % stage.width)).reshape(stage.width, -1)
        block, lane = np.divmod(self._at, stage.width)
        flat = self._functions[function].outputs[name].reshape(-1)
        return Output(
            flat=flat,
            at=(block * len(rows))[:, None] + order[lane],
            rows=rows[order[0]] // stage.width,
            columns=columns[order[0]] // stage.width,
        )

    def _in_blocks(self, rows: Array) -> Array:
        """Return (blocks * columns, width) of (N, columns)."""
        blocks, width = self._shape
        return rows[self._lane].reshape(blocks, width, -1).swapaxes(1, 2).reshape(-1, width)

    def set(
        self,
        x: Annotated[np.ndarray, "intervals states"],
        u: Annotated[np.ndarray, "intervals inputs"],
        h: Annotated[np.ndarray, "intervals"],
    ) -> None:
        for function in self._functions.values():
            function.inputs["x"][:] = self._in_blocks(x)
            function.inputs["u"][:] = self._in_blocks(u)
            function.inputs["h"][:] = h[self._lane].reshape(self._shape)

    def values(self) -> None:
        self._functions["value"]()

    def slopes(self) -> None:
        self._functions["slopes"]()
        self.gradient()

    def gradient(self) -> None:
        self._functions["gradient"]()

    def compute_hessian(
        self,
        sigma: float,
        lam_x: Annotated[np.ndarray, "intervals states"],
        lam_path: Annotated[np.ndarray, "intervals rows"],
    ) -> None:
        inputs = self._functions["hessian"].inputs
        inputs["sigma"][:] = sigma
        inputs["lam_x"][:] = self._in_blocks(lam_x)
        inputs["lam_path"][:] = self._in_blocks(lam_path)
        self._functions["hessian"]()
