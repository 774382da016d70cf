"""Shooting intervals as C over SIMD lanes: values, slopes and Hessians with the network's by formula.

A lane is an interval. Dynamics, cost and path rows are emitted from their SX graphs. RK4, its sensitivities,
its adjoint and the network are loops in `kernel.c`. The network's weights are data, so neither learning nor
another course or limit rebuilds anything. `trimtab.host.shooting.stage` has the same derivatives without a
compiler.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import casadi as ca
import numpy as np

from trimtab.host.codegen import simd
from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.lanes import lane_source
from trimtab.host.codegen.simd import (
    LAYERS,
    RK4,
    aligned,
    lane_count,
    lanes_of,
    simd_library,
)
from trimtab.host.models import kernel as models_kernel
from trimtab.host.models.kernel import network_ends
from trimtab.host.models.network import Layout
from trimtab.host.shooting import stage
from trimtab.host.shooting.stage import NETWORK_INPUTS, StageModel

_SOURCE = Path(__file__).parent / "kernel.c"
_GENERATORS = (
    Path(__file__),
    _SOURCE,
    Path(stage.__file__),
    Path(models_kernel.__file__),
    Path(simd.__file__),
)
"""Files that make the C source, besides the prelude that every kernel has."""


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """Masks of the entries that may differ from zero.

    x_slope and hessian, an upper triangle, are by z = (x, u, h), path_slope by xu = (x, u).
    """

    x_slope: Annotated[np.ndarray, "states z"]
    path_slope: Annotated[np.ndarray, "rows xu"]
    hessian: Annotated[np.ndarray, "z z"]


@dataclass(frozen=True, kw_only=True)
class Kernel:
    """The library's functions over groups of lanes (`kernel.c`), and the order of their outputs.

    path_slope: rows and columns of its entries. rows: number of path rows. lanes: of a group.
    """

    values: Callable[..., None]
    slopes: Callable[..., None]
    hessians: Callable[..., None]
    pattern: Pattern
    path_slope: tuple[Annotated[np.ndarray, "entries"], Annotated[np.ndarray, "entries"]]
    rows: int
    lanes: int


def kernel(model: StageModel, compiler: Compiler) -> Kernel:
    """Return the kernel of a model, compiled or from the cache.

    Raises CodegenError where the compiler fails.
    """
    expressions = _Expressions(model)
    library = simd_library(expressions.key(), compiler, lambda: _Parts(expressions).source())
    for name in ("values", "slopes", "hessians"):
        getattr(library, name).restype = None
    nx, nu, rows = model.nx, model.nu, expressions.path.shape[0]
    nz = nx + nu + 1
    pattern = Pattern(
        x_slope=_exported(library, "X_SLOPE_MASK", (nx, nz)),
        path_slope=_exported(library, "PATH_SLOPE_MASK", (rows, nx + nu)),
        hessian=_exported(library, "Z_HESSIAN_MASK", (nz, nz)),
    )
    columns, entries = np.nonzero(pattern.path_slope.T)
    return Kernel(
        values=library.values,
        slopes=library.slopes,
        hessians=library.hessians,
        pattern=pattern,
        path_slope=(entries, columns),
        rows=rows,
        lanes=lane_count(library),
    )


def point_in_lanes(
    unknowns: int,
    h0_s: Annotated[np.ndarray, "intervals"],
    parameters: Annotated[np.ndarray, "parameters intervals"],
    lanes: int,
) -> Annotated[np.ndarray, "groups rows lanes"]:
    """Return the kernel's input: room for the unknowns, then the nominal steps and the parameters."""
    given = lanes_of(np.column_stack([h0_s, parameters.T]), lanes)
    z = aligned((len(given), unknowns + given.shape[1], lanes))
    z[:, unknowns:] = given
    return z


def kernel_key(model: StageModel) -> str:
    """Return a text that determines the kernel of a model, without deriving anything."""
    return _Expressions(model).key()


@cache
def _generators() -> str:
    """Return the hash of the program that makes the source."""
    files = b"".join(path.read_bytes() for path in _GENERATORS)
    return hashlib.sha256(files).hexdigest() + ca.CasadiMeta.version()


class _Expressions:
    """A model as SX expressions, from which everything in its kernel is derived."""

    @held_interrupts()
    def __init__(self, model: StageModel) -> None:
        self.model = model
        x, u, p = (
            ca.SX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("p", model.np))
        )
        self.x, self.u, self.p = x, u, p
        self.f = ca.densify(model.derivative(x, u, p))
        self.effort, self.path = model.effort(x, u, p), ca.densify(model.path(x, u, p))
        self.residual = ca.SX(3, 1) if model.residual is None else model.residual(x, p)

    def key(self) -> str:
        """Return a text that determines the kernel's C."""
        model, network = self.model, self.model.network
        graphs = [
            ca.Function("model", [self.x, self.u, self.p], [self.f, self.effort, self.path, self.residual])
        ]
        layout = None
        if network is not None:
            layout = network.layout.sizes
            ends = network_ends(network.layout)
            graphs += [ends["seen"], ends["given"]]
        words = (model.network_rows, model.residual is not None, layout, _generators(), RK4, LAYERS)
        return repr((words, *(graph.serialize() for graph in graphs)))


class _Parts:
    """The SX functions that the kernel is made of, and the patterns of their derivatives."""

    @held_interrupts()
    def __init__(self, expressions: _Expressions) -> None:
        self.model = model = expressions.model
        nx, nu = model.nx, model.nu
        x, u, p, f = expressions.x, expressions.u, expressions.p, expressions.f
        xu = ca.vertcat(x, u)
        by_x, by_u = ca.jacobian(f, x), ca.jacobian(f, u)
        kappa = ca.SX.sym("kappa", nx)
        hessian = ca.triu(ca.hessian(ca.dot(kappa, f), xu)[0])
        self.by_x, self.by_u = by_x.sparsity(), by_u.sparsity()
        self.f_hessian = hessian.sparsity()
        block = ca.Sparsity(nx + nu, nx + nu)
        if model.network is not None and model.network_rows is not None:
            indices = range(NETWORK_INPUTS.start, NETWORK_INPUTS.stop)
            pairs = [(i, j) for i in indices for j in indices if i <= j]
            block = ca.Sparsity.triplet(
                nx + nu, nx + nu, [pair[0] for pair in pairs], [pair[1] for pair in pairs]
            )
            self.f_hessian = self.f_hessian + block

        effort, path, d = expressions.effort, expressions.path, expressions.residual
        self.rows = path.shape[0]
        self.residual_rows = d.shape[0]
        sigma, mu = ca.SX.sym("sigma"), ca.SX.sym("mu", self.residual_rows)
        lam = ca.SX.sym("lam", self.rows)
        start_hessian = ca.triu(ca.hessian(sigma * effort + ca.dot(mu, d) + ca.dot(lam, path), xu)[0])
        by_path = ca.jacobian(path, xu)
        self.path, self.start_hessian = by_path.sparsity(), start_hessian.sparsity()
        jacobian = ca.densify(ca.jacobian(d, x))
        self.residual = ca.jacobian(d, x).sparsity()
        self.functions = {
            "f": ca.Function("f", [x, u, p], [f]),
            "df": _emitted("df", [x, u, p], [f, by_x.nz[:], by_u.nz[:]]),
            "ddf": _emitted("ddf", [x, u, p, kappa], [ca.project(hessian, self.f_hessian).nz[:]]),
            "own": _emitted("own", [x, u, p], [effort, d, path]),
            "down": _emitted(
                "down",
                [x, u, p],
                [effort, ca.gradient(effort, xu), d, ca.vec(jacobian.T), by_path.nz[:]],
            ),
            "ddown": _emitted("ddown", [x, u, p, sigma, mu, lam], [start_hessian.nz[:]]),
        }

    def pattern(self) -> Pattern:
        """Return the entries that may differ from zero: RK4 chains the patterns of the dynamics."""
        nx, nu = self.model.nx, self.model.nu
        nz = nx + nu + 1
        by_x, by_u = _mask(self.by_x), _mask(self.by_u)
        learned = np.zeros(nx, dtype=bool)
        if self.model.network is not None:
            learned[NETWORK_INPUTS] = True
            if self.model.network_rows is not None:
                by_x[self.model.network_rows] |= learned
        start = np.eye(nx, nz, dtype=bool)
        reached = start.copy()
        of_f = _mask(self.f_hessian)
        of_f |= of_f.T
        hessian = np.zeros((nz, nz), dtype=bool)
        slope = np.zeros((nx, nz), dtype=bool)
        for _ in range(4):
            spread = np.zeros((nx + nu, nz), dtype=bool)
            spread[:nx] = reached
            spread[nx:, nx : nx + nu] = np.eye(nu, dtype=bool)
            hessian |= _product(_product(spread.T, of_f), spread)
            change = _product(by_x, reached)
            change[:, nx : nx + nu] |= by_u
            slope |= change
            reached = start | change
            reached[:, -1] = True
        hessian[:, -1] |= slope.any(axis=0) | True
        start_hessian = np.zeros((nz, nz), dtype=bool)
        start_hessian[:-1, :-1] = _mask(self.start_hessian)
        if self.model.residual is not None:
            support = np.zeros(nz, dtype=bool)
            support[:nx] = _mask(self.residual).any(axis=0) | learned
            start_hessian |= np.outer(support, support)
        slope |= start
        slope[:, -1] = True
        return Pattern(x_slope=slope, path_slope=_mask(self.path), hessian=np.triu(hessian | start_hessian))

    def source(self) -> str:
        """Return the kernel's C, which follows `trimtab.host.codegen.simd.PRELUDE`."""
        model = self.model
        functions, network = dict(self.functions), model.network
        sizes = {
            "NX": model.nx,
            "NU": model.nu,
            "NP": model.np,
            "ROWS": self.rows,
            "NETWORK": int(network is not None),
            "NETWORK_ROW": -1 if model.network_rows is None else model.network_rows.start,
            "RESIDUAL": int(model.residual is not None),
            "D_ROWS": self.residual_rows,
        }
        defines: list[str] = []
        if network is not None:
            layout = network.layout
            functions |= _network_ends(layout)
            sizes |= {"SEEN": layout.sizes[0], "UNITS": sum(layout.hidden), "LAST": max(layout.sizes)}
            defines += _network_calls(layout)
        tables = []
        for name, pattern in (
            ("A", self.by_x),
            ("B", self.by_u),
            ("HESSIAN", self.f_hessian),
            ("PATH", self.path),
            ("OWN", self.start_hessian),
        ):
            rows, columns = _triplet(pattern)
            sizes[f"{name}_NNZ"] = max(1, len(rows))
            tables += [_table(f"{name}_ROW", rows), _table(f"{name}_COL", columns)]
        rows, columns = _triplet(self.f_hessian)
        first = NETWORK_INPUTS.start
        inside = (rows >= first) & (columns < NETWORK_INPUTS.stop)
        tables.append(_table("HESSIAN_BLOCK", np.where(inside, 6 * (rows - first) + columns - first, -1)))
        masks = self.pattern()
        tables += [
            _table("X_SLOPE_MASK", masks.x_slope, exported=True),
            _table("PATH_SLOPE_MASK", masks.path_slope, exported=True),
            _table("Z_HESSIAN_MASK", masks.hessian, exported=True),
        ]
        used = np.flatnonzero(_mask(self.by_x).any(axis=0)).tolist()
        if network is not None and model.network_rows is not None:
            used.append(NETWORK_INPUTS.start)
        sizes["FIRST"] = min(used, default=model.nx)
        active = np.unique(np.concatenate([rows, columns]))
        sizes["ACTIVE"] = len(active)
        tables.append(_table("ACTIVE_ROW", active))
        emitted = [lane_source(function, name) for name, function in functions.items()]
        defines = [f"#define {name} {value}" for name, value in sizes.items()] + defines
        return "\n".join([RK4, LAYERS, *emitted, *defines, *tables, _SOURCE.read_text(encoding="utf-8")])


def _emitted(name: str, inputs: list[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
    """Return a function of dense columns; an output without entries becomes one zero."""
    columns = [
        ca.densify(ca.vec(output)) if output.numel() else ca.densify(ca.SX(1, 1)) for output in outputs
    ]
    return ca.Function(name, inputs, ca.cse(columns))


def _triplet(pattern: ca.Sparsity) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = pattern.get_triplet()
    return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)


def _mask(pattern: ca.Sparsity) -> np.ndarray:
    mask = np.zeros(pattern.shape, dtype=bool)
    mask[_triplet(pattern)] = True
    return mask


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a.astype(np.int64) @ b.astype(np.int64) > 0


def _table(name: str, numbers: np.ndarray, *, exported: bool = False) -> str:
    values = ", ".join(map(str, numbers.astype(np.int64).ravel().tolist())) or "0"
    return f"{'' if exported else 'static '}const int {name}[] = {{{values}}};"


def _exported(library: ctypes.CDLL, name: str, shape: tuple[int, int]) -> np.ndarray:
    """Return a mask that the library holds."""
    numbers = (ctypes.c_int * (shape[0] * shape[1])).in_dll(library, name)
    return np.array(numbers, dtype=bool).reshape(shape)


def _network_ends(layout: Layout) -> dict[str, ca.Function]:
    """Return the network's inputs from v_ned and Theta, its acceleration from its outputs, and derivatives.

    `kernel.c` calls them by these names. seen(state): inputs (n,). dseen(state): (n, 6). ddseen(state, eta):
    Hessian (6, 6) of eta' seen. given(state, out): acceleration (3,). dgiven(state, out): (3, 6), (3, 3).
    ddgiven(state, out, mu): Hessian of mu' given, by state and state (6, 6), by out and state (3, 6).
    Matrices are columns, row by row.
    """
    ends = network_ends(layout)
    state, out = ca.SX.sym("state", 6), ca.SX.sym("out", 3)
    mu, eta = ca.SX.sym("mu", 3), ca.SX.sym("eta", layout.sizes[0])
    seen, given = ends["seen"](state), ends["given"](state, out)
    slope = ca.gradient(ca.dot(mu, given), state)
    derivatives = {
        "dseen": ([state], [ca.jacobian(seen, state)]),
        "ddseen": ([state, eta], [ca.hessian(ca.dot(eta, seen), state)[0]]),
        "dgiven": ([state, out], [ca.jacobian(given, state), ca.jacobian(given, out)]),
        "ddgiven": ([state, out, mu], [ca.jacobian(slope, state), ca.jacobian(slope, out).T]),
    }
    for name, (inputs, outputs) in derivatives.items():
        ends[name] = _emitted(name, inputs, [output.T for output in outputs])
    return ends


def _network_calls(layout: Layout) -> list[str]:
    """Return the layers' calls, as macros."""
    forward, slopes, hessians = [], [], []
    layers = []  # places of its weights, units and inputs
    unit = weight = 0
    source = "n->s"
    for inputs, outputs in pairwise(layout.sizes):
        layers.append((weight, unit, source, inputs, outputs))
        source, unit, weight = f"n->a + {unit}", unit + outputs, weight + outputs * (inputs + 1)
    *hidden, (out_weight, _, out_source, out_inputs, _) = layers
    for k, (weight, unit, source, inputs, outputs) in enumerate(hidden):
        forward.append(f"layer(xi + {weight}, {source}, n->a + {unit}, {inputs}, {outputs});")
        forward.append(f"for (int j = {unit}; j < {unit + outputs}; ++j) n->a[j] = vtanh(n->a[j]);")
        if k == 0:
            slopes.append(
                f"for (int j = 0; j < {outputs}; ++j) for (int q = 0; q < SEEN; ++q) "
                f"n->before[j * SEEN + q] = splat(xi[{weight} + j * (SEEN + 1) + q]);"
            )
        else:
            slopes.append(
                f"layer_slope(xi + {weight}, wide, n->before + {unit} * SEEN, {inputs}, {outputs}, SEEN);"
            )
        slopes.append(
            f"for (int j = 0; j < {outputs}; ++j) for (int q = 0; q < SEEN; ++q) wide[j * SEEN + q] = "
            f"(1.0 - n->a[{unit} + j] * n->a[{unit} + j]) * n->before[({unit} + j) * SEEN + q];"
        )
    forward.append(f"layer(xi + {out_weight}, {out_source}, n->out, {out_inputs}, 3);")
    slopes.append(f"layer_slope(xi + {out_weight}, wide, n->slope, {out_inputs}, 3, SEEN);")
    hessians.append(f"layer_back(xi + {out_weight}, out_mu, back, {out_inputs}, 3);")
    for weight, unit, _, inputs, outputs in reversed(hidden):
        hessians.append(
            f"units_hessian(n->a + {unit}, back, n->before + {unit} * SEEN, {outputs}, inner); "
            f"for (int j = 0; j < {outputs}; ++j) back[j] *= 1.0 - n->a[{unit} + j] * n->a[{unit} + j]; "
            f"layer_back(xi + {weight}, back, to, {inputs}, {outputs}); "
            f"memcpy(back, to, sizeof(V) * {inputs});"
        )
    calls = {"FORWARD": forward, "SLOPES": slopes, "HESSIANS": hessians}
    return [f"#define {name} {' '.join(lines)}" for name, lines in calls.items()]
