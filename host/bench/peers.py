"""The same gradient by JAX, and by diffrax on it: phi is traced from the same source, in double precision.

Compiled, vectorised over segments and warmed up, as their documentation has it. One thread, like ours.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np

from host.bench.timing import best_ms
from host.learn.adjoint import Gradient
from host.models.network import Layout
from host.models.phi import Phi
from host.models.segments import Segments

_AGREE = 1e-9
"""Largest difference of the gradients over the greatest entry."""


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
    """A row a peer: name, gradient_ms, build_s, differs (of its gradient from ours, over the greatest entry).

    None where JAX and diffrax are not installed. phi has no effects. Raises ValueError where JAX's gradient,
    which takes the same steps, is another one.
    """
    if importlib.util.find_spec("jax") is None or importlib.util.find_spec("diffrax") is None:
        return None
    # One thread: set before JAX is first imported.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax

    jax.config.update("jax_enable_x64", True)
    model = _Model(phi, layout, segments, weight)
    rows = []
    for name, loss, same in (
        ("JAX, RK4 in a scan", model.by_hand(), True),
        ("diffrax, Bosh3", model.by_diffrax("Bosh3"), False),
        ("diffrax, Tsit5", model.by_diffrax("Tsit5"), False),
    ):
        began = perf_counter()
        compiled = jax.jit(jax.value_and_grad(loss))
        gradient = np.array(jax.block_until_ready(compiled(xi))[1])
        build_s = perf_counter() - began
        differs = float(np.abs(gradient - ours.xi).max() / np.abs(ours.xi).max())
        if same and differs > _AGREE:
            raise ValueError(f"{name} has another gradient, by {differs:.2g} of the greatest entry")
        rows.append(
            {
                "name": name,
                "gradient_ms": best_ms(
                    lambda compiled=compiled: jax.block_until_ready(compiled(xi)), repeats=repeats
                ),
                "build_s": build_s,
                "differs": differs,
            }
        )
    return rows


class _Operations:
    """The law's operations on JAX arrays."""

    def __init__(self) -> None:
        import jax.numpy as jnp

        self.where, self.minimum, self.maximum, self.clip = jnp.where, jnp.minimum, jnp.maximum, jnp.clip
        self.sqrt, self.sin, self.cos, self.tan = jnp.sqrt, jnp.sin, jnp.cos, jnp.tan
        self.asin, self.atan2, self.exp, self.log = jnp.arcsin, jnp.arctan2, jnp.exp, jnp.log
        self.tanh, self.fabs, self.floor = jnp.tanh, jnp.abs, jnp.floor


class _Model:
    """phi with its network over all segments: states (size, S)."""

    def __init__(self, phi: Phi, layout: Layout, segments: Segments, weight: np.ndarray) -> None:
        import jax.numpy as jnp

        self._phi, self._layout, self._ops = phi, layout, _Operations()
        self._step_s, self._steps = segments.step_s, segments.steps
        self._x0 = jnp.asarray(segments.x0.T)
        self._drive = jnp.asarray(np.moveaxis(segments.drive, 0, 2))  # (2 N + 1, 22, S)
        self._constants = jnp.asarray(segments.constants.T)
        self._measured = jnp.asarray(np.moveaxis(segments.measured[:, 1:], 0, 2))  # (N, 12, S)
        self._weight = jnp.asarray(weight)[:, None]

    def by_hand(self) -> Callable[[Any], Any]:
        """The loss by RK4 in a scan over steps, the same steps as ours."""
        import jax

        h = self._step_s

        def loss(xi: Any) -> Any:
            def step(x: Any, drives: Any) -> tuple[Any, Any]:
                start, middle, end = drives
                k1 = self._rate(x, start, xi)
                k2 = self._rate(x + 0.5 * h * k1, middle, xi)
                k3 = self._rate(x + 0.5 * h * k2, middle, xi)
                k4 = self._rate(x + h * k3, end, xi)
                x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
                return x, x

            stages = (self._drive[:-1:2], self._drive[1::2], self._drive[2::2])
            _, states = jax.lax.scan(step, self._x0, stages)
            return self._loss(states)

        return loss

    def by_diffrax(self, solver: str) -> Callable[[Any], Any]:
        """The loss by a diffrax solver of this name at constant steps, the drive linear between its rows."""
        import diffrax
        import jax.numpy as jnp

        h = self._step_s
        times = h * np.arange(self._steps + 1)
        path = diffrax.LinearInterpolation(ts=0.5 * h * np.arange(2 * self._steps + 1), ys=self._drive)
        term = diffrax.ODETerm(lambda t, x, xi: self._rate(x, path.evaluate(t), xi))

        def loss(xi: Any) -> Any:
            found = diffrax.diffeqsolve(
                term,
                getattr(diffrax, solver)(),
                t0=0.0,
                t1=float(times[-1]),
                dt0=None,
                y0=self._x0,
                args=xi,
                saveat=diffrax.SaveAt(ts=jnp.asarray(times[1:])),
                stepsize_controller=diffrax.StepTo(ts=jnp.asarray(times)),
                max_steps=self._steps + 1,
            )
            return self._loss(found.ys)

        return loss

    def _loss(self, states: Any) -> Any:
        """Sum over segments of the mean over steps; states (N, size, S)."""
        import jax.numpy as jnp

        return jnp.sum(self._weight * (states[:, :12] - self._measured) ** 2) / self._steps

    def _rate(self, x: Any, drive: Any, xi: Any) -> Any:
        import jax.numpy as jnp

        rows = [jnp.broadcast_to(row, x.shape[1:]) for row in self._derivative(x, drive, xi)]
        return jnp.stack(rows)

    def _derivative(self, x: Any, drive: Any, xi: Any) -> list[Any]:
        import jax.numpy as jnp

        values: Any = jnp.stack(self._layout.seen(self._ops, list(x[3:9])))
        start, sizes = 0, self._layout.sizes
        for k, (inputs, outputs) in enumerate(pairwise(sizes)):
            if k:
                values = jnp.tanh(values)
            stop = start + outputs * (inputs + 1)
            weights = xi[start:stop].reshape(outputs, inputs + 1)
            values = weights[:, :-1] @ values + weights[:, -1:]
            start = stop
        pushed = self._layout.given(self._ops, list(x[3:9]), list(values))
        return self._phi.derivative(
            self._ops, list(x), list(drive), list(self._constants), [], acceleration_ned=pushed
        )
