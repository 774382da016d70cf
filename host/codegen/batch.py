"""A CasADi SX function over many lanes at once, by CasADi's operations on vectors, without a compiler.

Each lane has the arithmetic of the graph, so lanes do not depend on each other or their number.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from trimtab.host.codegen.buffered import Buffered
from trimtab.host.codegen.interrupts import held_interrupts

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


class Batch(Buffered):
    """An SX function of dense columns over `lanes` lanes: write `inputs`, call, read `outputs`.

    The arrays are (rows, lanes) and never move.

    Raises ValueError for a function of other than dense columns.
    """

    def __init__(self, function: ca.Function, lanes: int) -> None:
        if lanes < 1:
            raise ValueError(f"lanes must be at least 1, got {lanes}")
        super().__init__(vectorised(function, lanes))
