"""Paper Algorithm 1 as C over SIMD lanes: roll-out (eq. 7), adjoint (eq. 8), gradient (eq. 9).

A lane is a segment. The roll-out is that of `trimtab.host.models.kernel`. It stores its stages, and the
adjoint goes back over them. The vector-Jacobian products of phi and of the network's ends are emitted from
their SX graphs. The network's weights are data, so learning rebuilds nothing. The gradient by the weights is
one product of each layer's inputs and its costates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import casadi as ca

from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.lanes import lane_source
from trimtab.host.codegen.simd import simd_library
from trimtab.host.models.kernel import RolloutKernel, network_ends
from trimtab.host.models.kernel import source as rollout_source
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi

MEASURED = 12
"""States compared with the flight: p, v, Theta, body rate."""

_SOURCE = Path(__file__).parent / "kernel.c"


@dataclass(frozen=True, kw_only=True)
class Kernel:
    """The library's functions over one group of lanes."""

    roll_out: RolloutKernel
    adjoint: Callable[..., None]


def kernel(phi: Phi, layout: Layout, compiler: Compiler) -> Kernel:
    """Return Algorithm 1 for phi with a network of this layout, compiled or from the cache.

    Raises CodegenError where the compiler fails.
    """
    library = simd_library(source(phi, layout), compiler)
    library.adjoint.restype = None
    return Kernel(roll_out=RolloutKernel(library), adjoint=library.adjoint)


def source(phi: Phi, layout: Layout) -> str:
    """Return the kernel's C, which follows `trimtab.host.codegen.simd.PRELUDE`."""
    functions = {"products": vector_jacobian(phi.function), **_network_ends_back(layout)}
    sizes = layout.sizes
    backward, gradients = [], []
    u, w = 0, 0
    for k, (inputs, outputs) in enumerate(pairwise(sizes)):
        back = u + inputs - sizes[0]
        gradients.append(
            f"products_of(by_lane + {w}, first, costates, count, {u}, {back}, {inputs}, {outputs});"
        )
        before = back - inputs
        through_tanh = (
            f"for (int i = 0; i < {inputs}; ++i) "
            f"units[{before} + i] = to[i] * (1.0 - s->u[{u} + i] * s->u[{u} + i]);"
        )
        layer_back = f"layer_back(xi + {w}, units + {back}, to, {inputs}, {outputs});"
        backward.append(f"{layer_back} {through_tanh}" if k else layer_back)
        u, w = u + inputs, w + outputs * (inputs + 1)
    defines = [
        f"#define THETA {len(phi.theta_names)}",
        f"#define MEASURED {MEASURED}",
        f"#define WEIGHTS {layout.size}",
        f"#define BACKWARD {' '.join(reversed(backward))}",
        f"#define GRADIENTS {' '.join(gradients)}",
    ]
    emitted = [lane_source(function, name) for name, function in functions.items()]
    return "\n".join([rollout_source(phi, layout), *emitted, *defines, _SOURCE.read_text(encoding="utf-8")])


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


def _network_ends_back(layout: Layout) -> dict[str, ca.Function]:
    """Return the vector-Jacobian products of the network's inputs and of its acceleration."""
    state, push = ca.SX.sym("state", 6), ca.SX.sym("push", layout.sizes[0])
    out, pull = ca.SX.sym("out", 3), ca.SX.sym("pull", 3)
    ends = network_ends(layout)
    seen, acceleration = ends["seen"](state), ends["given"](state, out)
    back = [ca.densify(ca.jtimes(acceleration, of, pull, True)) for of in (state, out)]
    return {
        "seen_back": ca.Function(
            "seen_back", [state, push], [ca.densify(ca.jtimes(seen, state, push, True))]
        ),
        "given_back": ca.Function("given_back", [state, out, pull], ca.cse(back)),
    }
