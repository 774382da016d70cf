"""Roll-outs of segments as C over SIMD lanes: the programs of a segment model in loops of `segments.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import casadi
import numpy as np

from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.lanes import lane_source
from trimtab.host.codegen.simd import aligned, lane_count, pointer, simd_library

_SOURCE = Path(__file__).parent / "segments.c"
_CONSTANT = ("z", "nuisances")
"""Inputs that stay constant over a segment."""


class SegmentKernel:
    """The functions of `segments.c` for the programs "step", "rotors" and "memory" of a segment model.

    Raises CodegenError where the compiler fails.
    """

    def __init__(self, programs: Mapping[str, casadi.Function], compiler: Compiler) -> None:
        step = programs["step"]
        sizes = {
            "PARAMETERS": step.size1_in("z"),
            "NUISANCES": step.size1_in("nuisances"),
            "MEMORY": step.size1_in("memory"),
        }
        self._memory = sizes["MEMORY"]
        emitted = [
            lane_source(function, name, [each for each in function.name_in() if each in _CONSTANT])
            for name, function in programs.items()
        ]
        defines = [f"#define {name} {value}" for name, value in sizes.items()]
        source = "\n".join([*emitted, *defines, _SOURCE.read_text(encoding="utf-8")])
        self._library = simd_library(source, compiler)
        self._library.roll_out.restype = self._library.along_paths.restype = None
        self._width = lane_count(self._library)

    def roll_out(  # noqa: PLR0913 (the data of one problem)
        self,
        *,
        command: Annotated[np.ndarray, "segments commands 4"],
        delay: Annotated[np.ndarray, "lanes"],
        series: Annotated[np.ndarray, "segments steps 21"],
        per_bin: int,
        x0: Annotated[np.ndarray, "12 lanes segments"],
        theta_scaled: Annotated[np.ndarray, "parameters lanes"],
        memory: Annotated[np.ndarray, "memory lanes segments"],
        nuisances: Annotated[np.ndarray, "nuisances lanes segments"],
        bins: Annotated[np.ndarray, "bins 6 lanes"] | None,
    ) -> Annotated[np.ndarray, "segments steps 12 lanes"]:
        """Return the predicted measurements, with arguments as of `..rollout.roll_out`.

        command: those before the last steps are the run-up of the rotors. delay: of the commands, in steps.
        series: attitude, body rate, voltage, time, shift and disturbance of every step. per_bin: steps in a
        bin.
        """
        lanes, (segments, steps) = x0.shape[1], series.shape[:2]
        whole, share = np.divmod(delay, 1.0)
        columns = self._columns(theta_scaled)
        groups = columns.shape[1] // self._width
        by_lane = [
            self._columns(array.transpose(2, 0, 1)) if array.size else None
            for array in (x0, memory, nuisances)
        ]
        command, series = np.ascontiguousarray(command), np.ascontiguousarray(series)
        whole = np.ascontiguousarray(self._columns(whole), dtype=ctypes.c_long)
        share, added = self._columns(share), None if bins is None else self._columns(bins)
        predicted = aligned((segments, steps, 12, groups * self._width))
        before = command.shape[1] - steps
        counts = [ctypes.c_long(n) for n in (segments, groups, before, steps, per_bin)]
        start, states, errors = by_lane
        self._library.roll_out(
            *counts,
            *map(
                pointer,
                (command, whole, share, series, start, columns, states, errors, added, predicted),
            ),
        )
        return predicted[..., :lanes]

    def along_paths(
        self,
        theta_scaled: Annotated[np.ndarray, "parameters lanes"],
        paths: Annotated[np.ndarray, "flights samples 12"],
        dt_s: float,
    ) -> Annotated[np.ndarray, "flights samples memory lanes"]:
        """Return the states of the effects along measured paths with samples every `dt_s`."""
        columns, paths = self._columns(theta_scaled), np.ascontiguousarray(paths)
        groups = columns.shape[1] // self._width
        states = aligned((*paths.shape[:2], self._memory, groups * self._width))
        counts = [ctypes.c_long(n) for n in (len(paths), groups, paths.shape[1])]
        self._library.along_paths(
            *counts, ctypes.c_double(dt_s), pointer(columns), pointer(paths), pointer(states)
        )
        return states[..., : theta_scaled.shape[1]]

    def _columns(self, array: Annotated[np.ndarray, "... lanes"]) -> Annotated[np.ndarray, "... padded"]:
        """Return the array aligned for vectors, in whole groups of lanes, the last one repeated."""
        lanes = array.shape[-1]
        out = aligned((*array.shape[:-1], -(-lanes // self._width) * self._width))
        out[..., :lanes], out[..., lanes:] = array, array[..., -1:]
        return out
