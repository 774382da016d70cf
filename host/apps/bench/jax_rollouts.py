"""Roll-outs of segments and their loss in JAX, by RK4 in a scan and by diffrax.

Both are tuned for speed. RK4 is the fastest form we found: a scan over steps and within it one over stages,
which stores only matrix products for the backward pass. diffrax uses constant steps, without error estimate,
and a checkpoint for every step, as its documentation advises for speed.
"""

# pyright: reportMissingImports=false
# JAX and diffrax are the extra `bench`.

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from trimtab.host.apps.bench.jax_loop import JaxLoop, Weights
from trimtab.host.models.segments import Segments

Rate = Callable[[Any, Any, Weights], Any]
"""(x (S, size), drive (S, 23), weights) -> xdot (S, size)."""
Integrator = Callable[[Rate, Any, Any, Weights, float], Any]
"""(rate, x0 (S, size), drive (2 N + 1, S, 23), weights, step in s) -> states (N, S, size)."""


def arrays_of(segments: Segments) -> tuple[Any, ...]:
    """Return starts (S, size), drive (2 N + 1, S, 23), constants (S, 15) and later states (N, S, 12)."""
    drive, measured = segments.drive.swapaxes(0, 1), segments.measured[:, 1:].swapaxes(0, 1)
    return tuple(jnp.asarray(array) for array in (segments.x0, drive, segments.constants, measured))


def loss_and_gradient(
    loop: JaxLoop, integrator: Integrator, *, step_s: float, weight: np.ndarray
) -> Callable[[Any, tuple[Any, ...]], Any]:
    """Return a function of (xi (m,), `arrays_of` segments): loss and gradient, compiled at its first call.

    `weight` (12,) is the diagonal L of the loss (paper equation 3).
    """
    derivative = jax.vmap(loop.derivative, in_axes=(0, 0, 0, None))

    def loss(xi: Any, arrays: tuple[Any, ...]) -> Any:
        x0, drive, flight, measured = arrays
        states = integrator(
            lambda x, row, weights: derivative(x, row, flight, weights), x0, drive, loop.weights(xi), step_s
        )
        return jnp.sum(weight * (states[..., : len(weight)] - measured) ** 2) / len(measured)

    return jax.jit(jax.value_and_grad(loss))


def by_scan(rate: Rate, x0: Any, drive: Any, weights: Weights, step_s: float) -> Any:
    """Return an `Integrator`: RK4, the steps that `trimtab.host.learn.adjoint` takes."""
    reaches = step_s * jnp.array([0.0, 0.5, 0.5, 1.0])
    shares = step_s / 6.0 * jnp.array([1.0, 2.0, 2.0, 1.0])

    def stage(carry: Any, now: Any) -> tuple[Any, None]:
        (x, slope, after), (row, reach, share) = carry, now
        slope = rate(x + reach * slope, row, weights)
        return (x, slope, after + share * slope), None

    frugal = jax.checkpoint(stage, policy=jax.checkpoint_policies.dots_saveable)

    def step(x: Any, rows: Any) -> tuple[Any, Any]:
        (_, _, x), _ = jax.lax.scan(frugal, (x, jnp.zeros_like(x), x), (rows, reaches, shares))
        return x, x

    start, middle, end = drive[:-1:2], drive[1::2], drive[2::2]
    return jax.lax.scan(step, x0, jnp.stack((start, middle, middle, end), axis=1))[1]


def by_diffrax(solver: diffrax.AbstractSolver) -> Integrator:
    """Return an `Integrator`: a diffrax solver with the same steps and a drive linear between its rows."""

    def integrate(rate: Rate, x0: Any, drive: Any, weights: Weights, step_s: float) -> Any:
        steps = len(drive) // 2
        path = diffrax.LinearInterpolation(ts=0.5 * step_s * jnp.arange(len(drive)), ys=drive)
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, x, weights: rate(x, path.evaluate(t), weights)),
            solver,
            t0=0.0,
            t1=steps * step_s,
            dt0=step_s,
            y0=x0,
            args=weights,
            saveat=diffrax.SaveAt(steps=True),
            adjoint=diffrax.RecursiveCheckpointAdjoint(checkpoints=steps),
            max_steps=steps,
            throw=False,
        )
        return found.ys

    return integrate


PEERS: dict[str, tuple[Integrator, bool]] = {
    "JAX, RK4 in a scan": (by_scan, True),
    "diffrax, Bosh3": (by_diffrax(diffrax.Bosh3()), False),
    "diffrax, Tsit5": (by_diffrax(diffrax.Tsit5()), False),
}
"""Integrator by name, and whether it takes the same steps as ours."""
