"""CasADi SX functions as C over SIMD lanes: every number is a vector of independent numbers.

The arithmetic of a lane is IEEE's, in the graph's order, for any width of registers, so machines with the
same libm agree bit for bit. sin, cos, exp, tanh and atan2 are vector code with an error of at most 4 units in
the last place. Other transcendental functions call libm lane by lane.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import casadi as ca
import numpy as np

from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.libraries import load_library

_ALIGNED = 64

_HERE = Path(__file__).parent

PRELUDE = "".join((_HERE / name).read_text(encoding="utf-8") for name in ("simd.h", "elementary.h"))
"""C of vectors, whose width LANES it takes from the compiler's target."""

RK4 = (_HERE / "rk4.h").read_text(encoding="utf-8")
"""C of a Runge-Kutta step, which follows PRELUDE."""

LAYERS = (_HERE / "layers.h").read_text(encoding="utf-8")
"""C of a network's layers, which follows PRELUDE."""

_UNARY = {
    ca.OP_NEG: "-{0}",
    ca.OP_EXP: "vexp({0})",
    ca.OP_LOG: "vlog({0})",
    ca.OP_SQRT: "vsqrt({0})",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SIN: "vsin({0})",
    ca.OP_COS: "vcos({0})",
    ca.OP_TAN: "vtan({0})",
    ca.OP_ASIN: "vasin({0})",
    ca.OP_ACOS: "vacos({0})",
    ca.OP_ATAN: "vatan({0})",
    ca.OP_SINH: "vsinh({0})",
    ca.OP_COSH: "vcosh({0})",
    ca.OP_TANH: "vtanh({0})",
    ca.OP_FLOOR: "vfloor({0})",
    ca.OP_CEIL: "vceil({0})",
    ca.OP_FABS: "vabs({0})",
    ca.OP_SIGN: "vsign({0})",
    ca.OP_NOT: "truth({0} == 0.0)",
    ca.OP_ASSIGN: "{0}",
}
_BINARY = {
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_POW: "vpow({0}, {1})",
    ca.OP_CONSTPOW: "vpow({0}, {1})",
    ca.OP_FMIN: "vmin({0}, {1})",
    ca.OP_FMAX: "vmax({0}, {1})",
    ca.OP_ATAN2: "vatan2({0}, {1})",
    ca.OP_FMOD: "vfmod({0}, {1})",
    ca.OP_COPYSIGN: "vcopysign({0}, {1})",
    ca.OP_LT: "truth({0} < {1})",
    ca.OP_LE: "truth({0} <= {1})",
    ca.OP_EQ: "truth({0} == {1})",
    ca.OP_NE: "truth({0} != {1})",
    ca.OP_AND: "truth(({0} != 0.0) & ({1} != 0.0))",
    ca.OP_OR: "truth(({0} != 0.0) | ({1} != 0.0))",
    ca.OP_IF_ELSE_ZERO: "choose({0} != 0.0, {1}, splat(0.0))",
}


def lane_source(function: ca.Function, name: str) -> str:
    """Return C of `name`(const V *input..., V *output...), with a pointer for each dense column.

    The C follows PRELUDE. Raises ValueError for an operation without a counterpart.
    """
    pointers = [f"const V *i{k}" for k in range(function.n_in())]
    pointers += [f"V *o{k}" for k in range(function.n_out())]
    lines = [f"INLINE void {name}({', '.join(pointers)}) {{"]
    variable_of: dict[int, str] = {}  # work slot -> the variable with its current value
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        if code == ca.OP_OUTPUT:
            block, row = function.instruction_output(k)
            lines.append(f"    o{block}[{row}] = {variable_of[function.instruction_input(k)[0]]};")
            continue
        if code == ca.OP_CONST:
            value = f"splat({_number(function.instruction_constant(k))})"
        elif code == ca.OP_INPUT:
            block, row = function.instruction_input(k)
            value = f"i{block}[{row}]"
        else:
            arguments = [variable_of[slot] for slot in function.instruction_input(k)]
            form = _UNARY.get(code) or _BINARY.get(code)
            if form is None:
                raise ValueError(f"{function.name()}: operation {code} has no counterpart over lanes")
            value = form.format(*arguments)
        lines.append(f"    const V v{k} = {value};")
        variable_of[function.instruction_output(k)[0]] = f"v{k}"
    return "\n".join([*lines, "}"]) + "\n"


def _number(value: float) -> str:
    return (
        repr(value) if np.isfinite(value) else f"({value})".replace("inf", "INFINITY").replace("nan", "NAN")
    )


def simd_library(key: str, compiler: Compiler, source: Callable[[], str] | None = None) -> ctypes.CDLL:
    """Return the library for PRELUDE and a source, for the instructions of this machine.

    `key` and `source` as of `load_library`. Raises CodegenError where the compiler fails.
    """
    text = None if source is None else lambda: PRELUDE + source()
    return load_library(ctypes.CDLL, PRELUDE + key, compiler, source=text, native=True)


def lane_count(library: ctypes.CDLL) -> int:
    """Return the number of lanes of a library by `simd_library`: doubles in a register of its target."""
    return int(library.lane_count())


def lanes_of(rows: np.ndarray, lanes: int) -> Annotated[np.ndarray, "... lanes"]:
    """Return rows (n, ...) as aligned (groups, ..., lanes); the first row fills the last group."""
    groups = -(-len(rows) // lanes)
    out = aligned((groups, *rows.shape[1:], lanes))
    filled = rows[np.where(np.arange(groups * lanes) < len(rows), np.arange(groups * lanes), 0)]
    out[...] = np.moveaxis(filled.reshape(groups, lanes, *rows.shape[1:]), 1, -1)
    return out


def rows_of(lanes: Annotated[np.ndarray, "... lanes"], count: int) -> np.ndarray:
    """Return the first `count` rows (count, ...) of an array by `lanes_of`, contiguous."""
    rows = np.ascontiguousarray(np.moveaxis(lanes, -1, 1))
    return rows.reshape(-1, *rows.shape[2:])[:count]


def pointer(array: np.ndarray | None) -> ctypes.c_void_p:
    """Return the address of an array's numbers, of None a null pointer."""
    return ctypes.c_void_p(None if array is None else array.ctypes.data)


def aligned(shape: tuple[int, ...]) -> np.ndarray:
    """Return zeros of this shape, aligned for vectors."""
    count = int(np.prod(shape))
    raw = np.zeros(count + _ALIGNED // 8)
    start = -raw.ctypes.data % _ALIGNED // 8
    return raw[start : start + count].reshape(shape)
