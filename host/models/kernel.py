"""Roll-outs of phi as C over SIMD lanes: RK4 around phi and a network whose weights are data.

phi and the network's inputs and outputs are emitted from their SX graphs; the rest is `rollout.c`. Learning
adds the adjoint to the same C.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import casadi as ca
import numpy as np

from trimtab.host.codegen.compiler import Compiler, compiled
from trimtab.host.codegen.lanes import lane_source
from trimtab.host.codegen.ops import CASADI
from trimtab.host.codegen.simd import (
    LAYERS,
    RK4,
    aligned,
    lane_count,
    pointer,
    simd_library,
)
from trimtab.host.models.drive import DRIVE_ROWS
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi

_SOURCE = Path(__file__).parent / "rollout.c"


def source(phi: Phi, layout: Layout | None) -> str:
    """Return the C of roll-outs, which follows `trimtab.host.codegen.simd.PRELUDE`."""
    functions: dict[str, ca.Function] = {}
    sizes = {"SIZE": phi.size, "ROWS": DRIVE_ROWS[phi.drive], "NETWORK": int(layout is not None)}
    forward: list[str] = []
    if layout is not None:
        functions |= network_ends(layout)
        sizes |= {"SEEN": layout.sizes[0], "UNITS": sum(layout.hidden)}
        unit = weight = 0
        for inputs, outputs in pairwise(layout.sizes):
            out = unit + inputs
            forward.append(f"layer(xi + {weight}, s->u + {unit}, s->u + {out}, {inputs}, {outputs});")
            forward.append(f"for (int i = {out}; i < {out + outputs}; ++i) s->u[i] = vtanh(s->u[i]);")
            unit, weight = out, weight + outputs * (inputs + 1)
        forward.pop()  # the last layer is linear
    defines = [f"#define {name} {value}" for name, value in sizes.items()]
    defines.append(f"#define FORWARD {' '.join(forward)}")
    emitted = [lane_source(phi.function, "phi", ("flight", "theta"))]
    emitted += [lane_source(function, name) for name, function in functions.items()]
    return "\n".join([RK4, LAYERS, *emitted, *defines, _SOURCE.read_text(encoding="utf-8")])


def network_ends(layout: Layout) -> dict[str, ca.Function]:
    """Return the network's inputs and its acceleration as functions of v_ned and Theta."""
    state, out = ca.SX.sym("state", 6), ca.SX.sym("out", 3)
    seen = ca.vertcat(*layout.inputs(CASADI, ca.vertsplit(state)))
    given = ca.vertcat(*layout.acceleration(CASADI, ca.vertsplit(state), ca.vertsplit(out)))
    return {
        "seen": ca.Function("seen", [state], [ca.densify(seen)]),
        "given": ca.Function("given", [state, out], [ca.densify(given)]),
    }


class RolloutKernel:
    """The function `roll_out` of a library with `rollout.c`. lanes: of a group."""

    def __init__(self, library: ctypes.CDLL) -> None:
        library.roll_out.restype, library.stage_bytes.restype = None, ctypes.c_long
        library.roll_out_groups.restype = None
        self._roll_out: Callable[..., None] = library.roll_out
        self._groups: Callable[..., None] = library.roll_out_groups
        self.stage_bytes = int(library.stage_bytes())
        self.lanes = lane_count(library)

    def __call__(  # noqa: PLR0913 (the data of one problem)
        self,
        xi: Annotated[np.ndarray, "weights"] | None,
        x0: Annotated[np.ndarray, "size lanes"],
        drive: Annotated[np.ndarray, "stages inputs flights"],
        flight_of: Annotated[np.ndarray, "lanes"] | None,
        flight: Annotated[np.ndarray, "15 lanes"],
        theta: Annotated[np.ndarray, "parameters lanes"] | None,
        push: Annotated[np.ndarray, "stages 3 lanes"] | None,
        *,
        step_s: float,
        every: int,
        stages: np.ndarray | None,
        samples: Annotated[np.ndarray, "samples rows lanes"],
    ) -> None:
        """Roll out one group of lanes into `samples`, which may be a part of a larger array.

        drive: of as many flights as lanes, or of those that `flight_of` names. theta: None without
        parameters. stages: room for 4 stages of each step, which are stored; None to store nothing.
        """
        store = stages is not None
        room = aligned((self.stage_bytes // 2,)) if stages is None else stages
        self._roll_out(
            pointer(xi), pointer(x0), pointer(drive), ctypes.c_long(drive.shape[2]), pointer(flight_of),
            pointer(flight), pointer(theta), pointer(push), ctypes.c_long(len(drive) // 2),
            ctypes.c_double(step_s), ctypes.c_long(every), ctypes.c_int(store), pointer(room),
            ctypes.c_long(samples.shape[1]), ctypes.c_long(samples.strides[1] // (8 * self.lanes)),
            pointer(samples),
        )  # fmt: skip

    def groups(  # noqa: PLR0913 (the data of one problem)
        self,
        xi: Annotated[np.ndarray, "weights"],
        x0: Annotated[np.ndarray, "groups size lanes"],
        drive: Annotated[np.ndarray, "groups stages inputs lanes"],
        flight: Annotated[np.ndarray, "groups 15 lanes"],
        theta: Annotated[np.ndarray, "groups parameters lanes"],
        push: Annotated[np.ndarray, "groups stages 3 lanes"],
        *,
        step_s: float,
        every: int,
        samples: Annotated[np.ndarray, "groups nodes size lanes"],
    ) -> None:
        """Roll out all groups of lanes into `samples`, the states after each `every` steps, in one call."""
        room = aligned((self.stage_bytes // 2,))
        self._groups(
            ctypes.c_long(len(x0)), pointer(xi), pointer(x0), pointer(drive), pointer(flight),
            ctypes.c_long(flight.shape[1]), pointer(theta), ctypes.c_long(theta.shape[1]), pointer(push),
            ctypes.c_long(drive.shape[1] // 2), ctypes.c_double(step_s), ctypes.c_long(every),
            pointer(room), pointer(samples),
        )  # fmt: skip


def rollout_kernel(phi: Phi, layout: Layout | None) -> RolloutKernel | None:
    """Return the roll-outs of phi with a network of this layout; None for CasADi's virtual machine.

    Raises CodegenError where TRIMTAB_ENGINE requests C and that is not possible.
    """
    return compiled(lambda compiler: _made(phi, layout, compiler))


@lru_cache(maxsize=16)
def _made(phi: Phi, layout: Layout | None, compiler: Compiler) -> RolloutKernel:
    return RolloutKernel(simd_library(source(phi, layout), compiler))
