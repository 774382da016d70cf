"""A CasADi SX function over many lanes at once, in SIMD C or by CasADi's operations on vectors.

Both compute each lane with the arithmetic of the graph, so lanes do not depend on each other or their number.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import lru_cache

import casadi as ca
import numpy as np

from trimtab.host.codegen.buffered import Buffered
from trimtab.host.codegen.compiler import compiled as made_in_c
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.simd import aligned, lane_count, lane_source, pointer, simd_library

_FEW = 8
"""Lanes below which CasADi is faster one by one: an operation on a vector takes 25 ns and 0.5 ns a lane."""


@lru_cache(maxsize=64)
@held_interrupts()
def vectorised(function: ca.Function, lanes: int) -> ca.Function:
    """Return an SX function of dense columns as an MX function of matrices (lanes, rows).

    Each operation of the graph becomes one operation on a vector with an entry for each lane. The bits are
    those of the function. Raises ValueError for a function of other than dense columns.
    """
    _check_columns(function)
    names = function.name_in(), function.name_out()
    inputs = [ca.MX.sym(name, lanes, function.size1_in(name)) for name in names[0]]
    if lanes < _FEW:
        results = function.map(lanes).call([matrix.T for matrix in inputs])
        return ca.Function(function.name(), inputs, [matrix.T for matrix in results], *names)
    columns = [ca.horzsplit(matrix) if matrix.shape[1] else [] for matrix in inputs]
    results = [[ca.MX()] * function.size1_out(name) for name in names[1]]
    value: dict[int, ca.MX] = {}  # work slot -> its current value
    for k in range(function.n_instructions()):
        code, source, target = (
            function.instruction_id(k), function.instruction_input(k), function.instruction_output(k),
        )  # fmt: skip
        if code == ca.OP_CONST:
            value[target[0]] = ca.MX(function.instruction_constant(k))
        elif code == ca.OP_INPUT:
            value[target[0]] = columns[source[0]][source[1]]
        elif code == ca.OP_OUTPUT:
            result = value[source[0]]
            results[target[0]][target[1]] = result if result.shape[0] == lanes else ca.repmat(result, lanes)
        elif len(source) == 1:
            value[target[0]] = ca.MX.unary(code, value[source[0]])
        else:
            value[target[0]] = ca.MX.binary(code, value[source[0]], value[source[1]])
    matrices = [ca.horzcat(*columns) if columns else ca.MX(lanes, 0) for columns in results]
    return ca.Function(function.name(), inputs, matrices, *names)


def _check_columns(function: ca.Function) -> None:
    for kind, names, pattern in (
        ("input", function.name_in(), function.sparsity_in),
        ("output", function.name_out(), function.sparsity_out),
    ):
        for name in names:
            if not pattern(name).is_dense() or pattern(name).size2() != 1:
                raise ValueError(f"{kind} {name} of {function.name()} is not a dense column")


class Batch:
    """An SX function of dense columns over `lanes` lanes: write `inputs`, call, read `outputs`.

    The arrays are (rows, lanes) and never move. `compiled`: in C where a compiler works.

    Raises ValueError for a function of other than dense columns, CodegenError where TRIMTAB_ENGINE requests C
    and that is not possible.
    """

    def __init__(self, function: ca.Function, lanes: int, *, compiled: bool = False) -> None:
        if lanes < 1:
            raise ValueError(f"lanes must be at least 1, got {lanes}")
        _check_columns(function)
        self.lanes = lanes
        self.inputs: Mapping[str, np.ndarray]
        self.outputs: Mapping[str, np.ndarray]
        library = _library(function) if compiled else None
        if library is None:
            self._run = Buffered(vectorised(function, lanes))
            self.inputs, self.outputs = self._run.inputs, self._run.outputs
        else:
            self._bind(function, library)

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._run()

    def _bind(self, function: ca.Function, library: ctypes.CDLL) -> None:
        width = lane_count(library)
        groups = -(-self.lanes // width)
        names = [*function.name_in(), *function.name_out()]
        sizes = [*map(function.size1_in, function.name_in()), *map(function.size1_out, function.name_out())]
        arrays = [aligned((size, groups * width)) for size in sizes]
        addresses = [pointer(array) for array in arrays]
        self._run = lambda: library.run(ctypes.c_long(groups), *addresses)
        views = {name: array[:, : self.lanes] for name, array in zip(names, arrays, strict=True)}
        self.inputs = {name: views[name] for name in function.name_in()}
        self.outputs = {name: views[name] for name in function.name_out()}


@lru_cache(maxsize=64)
def _library(function: ca.Function) -> ctypes.CDLL | None:
    """Return the compiled function over groups of lanes; None for CasADi's virtual machine."""
    library = made_in_c(lambda compiler: simd_library(_source(function), compiler))
    if library is not None:
        library.run.restype = None
    return library


def _source(function: ca.Function) -> str:
    """Return the C of run(groups, inputs..., outputs...), whose arrays are (rows, groups) of vectors."""
    inputs = [(f"a{i}", f"x{i}", function.size1_in(i)) for i in range(function.n_in())]
    outputs = [(f"b{i}", f"y{i}", function.size1_out(i)) for i in range(function.n_out())]
    parameters = [f"const V *{a}" for a, _, _ in inputs] + [f"V *{b}" for b, _, _ in outputs]
    arguments = [local for _, local, _ in inputs + outputs]
    return "\n".join(
        [
            lane_source(function, "evaluate"),
            f"void run(long groups, {', '.join(parameters)}) {{",
            "for (long g = 0; g < groups; ++g) {",
            *(f"V {local}[{max(1, size)}];" for _, local, size in inputs + outputs),
            *(f"for (int r = 0; r < {n}; ++r) {x}[r] = {a}[r * groups + g];" for a, x, n in inputs),
            f"evaluate({', '.join(arguments)});",
            *(f"for (int r = 0; r < {n}; ++r) {b}[r * groups + g] = {y}[r];" for b, y, n in outputs),
            "}}",
        ]
    )
