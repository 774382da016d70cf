"""Runge-Kutta of fourth order over many lanes in C, around a compiled slope function.

One small library with the loop over steps serves every slope function, which it gets by address. Its
arithmetic has the order of `trimtab.host.models.rollout`, so the results have the same bits.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np

from trimtab.host.codegen.compiler import Compiler, compiled
from trimtab.host.codegen.engine import c_source
from trimtab.host.codegen.libraries import load_library

_SOURCE = """
typedef int (*slopes)(const double **, double **, long long *, double *, int);

/* work: 4 size doubles, then the function's own. */
void rk4(slopes f, const double **arg, double **res, long long *iw, double *work, long long size,
         long long inputs, long long steps, long long every, long long rows, double step_s,
         const double *x0, const double *drive, double *samples)
{
    double *x = work, *at = x + size, *k = at + size, *total = k + size, *w = total + size;
    double half = 0.5 * step_s, sixth = step_s / 6.0;
    for (long long i = 0; i < size; ++i) x[i] = x0[i];
    for (long long i = 0; i < rows; ++i) *samples++ = x[i];
    for (long long step = 1; step <= steps; ++step) {
        for (int stage = 0; stage < 4; ++stage) {
            double ahead = stage == 0 ? 0.0 : stage == 3 ? step_s : half;
            for (long long i = 0; i < size; ++i) at[i] = stage == 0 ? x[i] : x[i] + k[i] * ahead;
            if (stage == 1 || stage == 3) drive += inputs;
            arg[0] = at, arg[1] = drive, res[0] = k;
            f(arg, res, iw, w, 0);
            for (long long i = 0; i < size; ++i) {
                if (stage == 0) total[i] = k[i];
                else total[i] += stage == 3 ? k[i] : k[i] * 2.0;
            }
        }
        for (long long i = 0; i < size; ++i) x[i] += total[i] * sixth;
        if (step % every == 0) for (long long i = 0; i < rows; ++i) *samples++ = x[i];
    }
}
"""


@dataclass(frozen=True, kw_only=True)
class RungeKutta:
    """An integrator of a slope function (x, drive, constants...) -> xdot."""

    function: ca.Function
    slopes: Callable[..., int]
    loop: Callable[..., None]

    def __call__(
        self,
        x0: Annotated[np.ndarray, "lanes size"],
        drive: Annotated[np.ndarray, "drives stages inputs"],
        drive_of: Annotated[np.ndarray, "lanes"],
        constants: list[Annotated[np.ndarray, "lanes _"]],
        *,
        step_s: float,
        every: int,
        rows: int,
    ) -> Annotated[np.ndarray, "lanes samples rows"]:
        """Return the first `rows` states at the start and after every `every` steps.

        drive: at the start, middle and end of each step. drive_of: index of each lane's drive. constants:
        inputs of the function after the last are 0.
        """
        f, (lanes, size) = self.function, x0.shape
        steps = drive.shape[1] // 2
        x0, drive, *constants = (np.ascontiguousarray(each, dtype=float) for each in (x0, drive, *constants))
        samples = np.empty((lanes, steps // every + 1, rows))
        arg, res = (ctypes.c_void_p * f.sz_arg())(), (ctypes.c_void_p * f.sz_res())()
        iw, work = (ctypes.c_longlong * (f.sz_iw() + 1))(), (ctypes.c_double * (4 * size + f.sz_w()))()
        sizes = [ctypes.c_longlong(n) for n in (size, drive.shape[2], steps, every, rows)]
        for lane in range(lanes):
            for i, each in enumerate(constants):
                arg[2 + i] = each[lane].ctypes.data
            of_lane = x0[lane], drive[drive_of[lane]], samples[lane]
            arrays = [ctypes.c_void_p(each.ctypes.data) for each in of_lane]
            self.loop(self.slopes, arg, res, iw, work, *sizes, ctypes.c_double(step_s), *arrays)
        return samples


def runge_kutta(function: ca.Function) -> RungeKutta | None:
    """Return the integrator in C of a slope function of dense columns; None where C does not work.

    Raises CodegenError as `compile_function` does.
    """

    def make(compiler: Compiler) -> RungeKutta:
        slopes = load_library(ctypes.CDLL, c_source(function), compiler)
        loop = load_library(ctypes.CDLL, _SOURCE, compiler).rk4
        loop.restype = None
        return RungeKutta(function=function, slopes=slopes[function.name()], loop=loop)

    return compiled(make)
