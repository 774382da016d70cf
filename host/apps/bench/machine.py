"""What this machine can do at best: its vector width, instructions, and the arithmetic of one core."""

from __future__ import annotations

import ctypes
from time import process_time
from typing import Any

from trimtab.host.codegen.compiler import Compiler, compiled, vector_instructions
from trimtab.host.codegen.simd import lane_count, simd_library

_ROUNDS, _REPEATS = 2_000_000, 5
_CHAINS = 8
"""Independent sums, enough to keep all units of a core busy."""
_SOURCE = f"""
void peak(long rounds, double *out) {{
    V sum[{_CHAINS}], by = splat(*out);
    for (int i = 0; i < {_CHAINS}; ++i) sum[i] = splat(i);
    for (long k = 0; k < rounds; ++k) for (int i = 0; i < {_CHAINS}; ++i) sum[i] = sum[i] * by + by;
    for (int i = 0; i < {_CHAINS}; ++i) *out += sum[i][0];
}}
"""


def measure() -> dict[str, Any]:
    """Return lanes of a vector, instructions, and the peak of one core in Gflop/s; None without a compiler.

    The peak is of separate multiplications and additions, which compiled code here uses for equal bits.
    """
    found = compiled(_peak)
    lanes, peak = (None, None) if found is None else found
    return {"lanes": lanes, "features": vector_instructions(), "peak_gflops": peak}


def gradient_floor_ms(peak_gflops: float | None, weights: int, points: int) -> float | None:
    """Return the least time of a network's gradient: six operations for each weight and evaluation."""
    return None if peak_gflops is None else 6e-6 * weights * points / peak_gflops


def recursion_floor_ms(peak_gflops: float | None, states: int, inputs: int, intervals: int) -> float | None:
    """Return the least time of one factorisation of a chain: the products of its Riccati recursion."""
    unknowns = states + inputs
    operations = 2 * states * states * unknowns + 2 * states * unknowns * unknowns
    return None if peak_gflops is None else 1e-6 * operations * intervals / peak_gflops


def _peak(compiler: Compiler) -> tuple[int, float]:
    """Return lanes and peak. Raises CodegenError where the compiler fails."""
    library = simd_library(_SOURCE, compiler)
    lanes, out = lane_count(library), ctypes.c_double(0.5)
    least_s = float("inf")
    for _ in range(_REPEATS):
        began = process_time()
        library.peak(ctypes.c_long(_ROUNDS), ctypes.byref(out))
        least_s = min(least_s, process_time() - began)
    return lanes, 2e-9 * _ROUNDS * _CHAINS * lanes / least_s
