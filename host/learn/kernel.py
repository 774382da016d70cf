"""Paper Algorithm 1 as C over SIMD lanes: roll-out (eq. 7), adjoint (eq. 8), gradient (eq. 9).

A lane is a segment. phi, its vector-Jacobian products and the network's inputs and outputs are emitted from
their SX graphs. The network's layers are loops over weights that are data, so learning rebuilds nothing. A
roll-out stores its stages, and the adjoint goes back over them. The gradient by the weights is one product of
each layer's inputs and its costates.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np

from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.ops import CASADI
from trimtab.host.codegen.simd import LAYERS, lane_source, simd_library
from trimtab.host.models.drive import DRIVE_ROWS
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi

MEASURED = 12
"""States compared with the flight: p, v, Theta, body rate."""

_SOURCE = Path(__file__).parent / "kernel.c"


@dataclass(frozen=True, kw_only=True)
class Kernel:
    """The library's two functions over one group of lanes, and the bytes of a stage."""

    roll_out: Callable[..., None]
    adjoint: Callable[..., None]
    stage_bytes: int


def kernel(phi: Phi, layout: Layout, compiler: Compiler) -> Kernel:
    """Return Algorithm 1 for phi with a network of this layout, compiled or from the cache.

    Raises CodegenError where the compiler fails.
    """
    library = simd_library(source(phi, layout), compiler)
    library.roll_out.restype = library.adjoint.restype = None
    library.stage_bytes.restype = ctypes.c_long
    return Kernel(roll_out=library.roll_out, adjoint=library.adjoint, stage_bytes=int(library.stage_bytes()))


def source(phi: Phi, layout: Layout) -> str:
    """Return the kernel's C, which follows `trimtab.host.codegen.simd.PRELUDE`."""
    functions = {"phi": phi.function, "products": vector_jacobian(phi.function), **_network_ends(layout)}
    sizes = layout.sizes
    forward, backward, gradients = [], [], []
    u, w = 0, 0
    layers = []
    for inputs, outputs in pairwise(sizes):
        layers.append((u, w, inputs, outputs))
        u, w = u + inputs, w + outputs * (inputs + 1)
    last = len(layers) - 1
    for k, (u, w, inputs, outputs) in enumerate(layers):
        out = u + inputs
        forward.append(f"layer(xi + {w}, s->u + {u}, s->u + {out}, {inputs}, {outputs});")
        if k < last:
            forward.append(f"for (int i = {out}; i < {out + outputs}; ++i) s->u[i] = vtanh(s->u[i]);")
        gradients.append(
            f"products_of(gradient + {w}, stages, 4 * steps, {u}, {out - sizes[0]}, {inputs}, {outputs});"
        )
    for k, (u, w, inputs, outputs) in reversed(list(enumerate(layers))):
        out = u + inputs
        back = out - sizes[0]
        backward.append(f"layer_back(xi + {w}, s->back + {back}, to, {inputs}, {outputs});")
        if k:
            before = back - inputs
            backward.append(
                f"for (int i = 0; i < {inputs}; ++i) "
                f"s->back[{before} + i] = to[i] * (1.0 - s->u[{u} + i] * s->u[{u} + i]);"
            )
    sizes_of = {
        "SIZE": phi.size,
        "ROWS": DRIVE_ROWS[phi.drive],
        "THETA": len(phi.theta_names),
        "SEEN": sizes[0],
        "UNITS": sum(layout.hidden),
        "GIVEN": 3,
        "MEASURED": MEASURED,
    }
    defines = [f"#define {name} {value}" for name, value in sizes_of.items()]
    calls = {"FORWARD": forward, "BACKWARD": backward, "GRADIENTS": gradients}
    defines += [f"#define {name} {' '.join(lines)}" for name, lines in calls.items()]
    emitted = [lane_source(function, name) for name, function in functions.items()]
    return "\n".join([LAYERS, *emitted, *defines, _SOURCE.read_text(encoding="utf-8")])


def vector_jacobian(phi: ca.Function) -> ca.Function:
    """Return the function of phi's inputs and a row l to its vector-Jacobian products.

    These are l' dphi/dx, l' dphi/d(acceleration) and l' dphi/dtheta, by CasADi's reverse mode. Without theta
    its product is one 0.
    """
    inputs = phi.sx_in()
    row = ca.SX.sym("row", phi.size1_out(0))
    rate = phi(*inputs)
    products = [ca.densify(ca.jtimes(rate, inputs[i], row, True)) for i in (0, 4, 3)]
    if not products[2].numel():
        products[2] = ca.densify(ca.SX(1, 1))
    return ca.Function("products", [*inputs, row], ca.cse(products))


def _network_ends(layout: Layout) -> dict[str, ca.Function]:
    """Return the network's inputs and its acceleration as functions, with their vector-Jacobian products."""
    state, push = ca.SX.sym("state", 6), ca.SX.sym("push", layout.sizes[0])
    out, pull = ca.SX.sym("out", 3), ca.SX.sym("pull", 3)
    network_inputs = ca.densify(ca.vertcat(*layout.inputs(CASADI, ca.vertsplit(state))))
    acceleration = ca.densify(
        ca.vertcat(*layout.acceleration(CASADI, ca.vertsplit(state), ca.vertsplit(out)))
    )
    back = [ca.densify(ca.jtimes(acceleration, of, pull, True)) for of in (state, out)]
    return {
        "seen": ca.Function("seen", [state], [network_inputs]),
        "given": ca.Function("given", [state, out], [acceleration]),
        "seen_back": ca.Function(
            "seen_back", [state, push], [ca.densify(ca.jtimes(network_inputs, state, push, True))]
        ),
        "given_back": ca.Function("given_back", [state, out, pull], ca.cse(back)),
    }


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return the address of an array's numbers."""
    return ctypes.c_void_p(array.ctypes.data)


def pointers(array: np.ndarray) -> list[ctypes.c_void_p]:
    """Return the addresses of an array's rows, one for each index of its first axis."""
    first, stride = array.ctypes.data, array.strides[0]
    return [ctypes.c_void_p(first + k * stride) for k in range(len(array))]
