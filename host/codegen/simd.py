"""C over SIMD lanes: every number is a vector of independent numbers.

The arithmetic of a lane is IEEE's for any width of registers, so machines with the same libm agree bit for
bit. sin, cos, exp, tanh and atan2 are vector code with an error of at most 4 units in the last place. Other
transcendental functions call libm lane by lane.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

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
