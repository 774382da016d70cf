"""The gradient of `trimtab.host.learn.adjoint` by JAX and by diffrax, in double precision on one core.

Both differentiate one derivative, written for them (`apps.bench.jax_loop`), vectorised over segments,
compiled, and timed once warm. Their gradients are compared with ours.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import numpy as np

from trimtab.host.apps.bench.timing import best_ms
from trimtab.host.learn.adjoint import Gradient
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments

SAME, CLOSE = 1e-9, 5e-2
"""Greatest difference of a gradient from ours over the greatest entry: in the same steps, and in others."""


def measure(
    phi: Phi,
    layout: Layout,
    segments: Segments,
    xi: np.ndarray,
    weight: np.ndarray,
    ours: Gradient,
    *,
    repeats: int,
) -> list[dict[str, Any]] | None:
    """Return a row for each peer: name, gradient_ms, build_s, differs; None if JAX or diffrax is missing.

    `differs` is the difference of its gradient from ours over the greatest entry. `weight` (12,) is that of
    the loss. Raises ValueError if a gradient differs from ours, or for a phi or layout that is not in JAX.
    """
    if not installed():
        return None
    rows = []
    with _one_thread():
        from trimtab.host.apps.bench import jax_rollouts as rollouts
        from trimtab.host.apps.bench.jax_loop import JaxLoop

        loop, arrays = JaxLoop(phi, layout), rollouts.arrays_of(segments)
        for name, (integrator, same_steps) in rollouts.PEERS.items():
            compiled = rollouts.loss_and_gradient(loop, integrator, step_s=segments.step_s, weight=weight)

            def run(compiled: Any = compiled) -> np.ndarray:
                return np.asarray(compiled(xi, arrays)[1])

            began = perf_counter()
            gradient = run()
            build_s = perf_counter() - began
            differs = float(np.abs(gradient - ours.xi).max() / np.abs(ours.xi).max())
            if not differs <= (SAME if same_steps else CLOSE):
                raise ValueError(f"{name}: the gradient differs by {differs:.2g} of the greatest entry")
            gradient_ms = best_ms(run, repeats=repeats)
            rows.append({"name": name, "gradient_ms": gradient_ms, "build_s": build_s, "differs": differs})
    return rows


def installed() -> bool:
    """Return whether JAX and diffrax can be imported."""
    return all(importlib.util.find_spec(name) is not None for name in ("jax", "diffrax"))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let JAX run on the processor with one thread, if it starts inside this context."""
    wanted = {"NPROC": "1", "JAX_PLATFORMS": "cpu"}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
