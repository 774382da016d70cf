"""Algorithm 1 over SIMD lanes: roll-outs and gradients of a batch of segments by the compiled kernel."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from trimtab.host.codegen.compiler import Compiler, compiled
from trimtab.host.codegen.simd import LANES, aligned, lanes_of, rows_of
from trimtab.host.learn.adjoint import Gradient, Pushed, Rollouts, check_step
from trimtab.host.learn.kernel import MEASURED, kernel, pointer, pointers
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments


def rollouts(
    phi: Phi,
    layout: Layout,
    theta: Annotated[np.ndarray, "parameters"],
    *,
    batch: int,
    step_s: float,
    weight: Annotated[np.ndarray, "12"],
) -> Rollouts | LaneRollouts:
    """Return Algorithm 1 for batches of up to `batch` segments: in C where a compiler works, else by CasADi.

    Raises CodegenError where TRIMTAB_ENGINE requests C and that is not possible.
    """
    made = compiled(
        lambda compiler: LaneRollouts(phi, layout, theta, step_s=step_s, weight=weight, compiler=compiler)
    )
    if made is not None:
        return made
    return Rollouts(phi, layout, theta, batch=batch, step_s=step_s, weight=weight)


class LaneRollouts:
    """`Rollouts` in C: equal up to rounding. Raises CodegenError where it cannot be compiled."""

    def __init__(
        self,
        phi: Phi,
        layout: Layout,
        theta: Annotated[np.ndarray, "parameters"],
        *,
        step_s: float,
        weight: Annotated[np.ndarray, "12"],
        compiler: Compiler,
    ) -> None:
        check_step(phi, step_s)
        self.phi, self.layout, self.step_s = phi, layout, step_s
        self.weight = np.asarray(weight, dtype=float)
        self._kernel = kernel(phi, layout, compiler)
        self._theta = aligned((max(1, len(theta)), LANES))
        self._theta[: len(theta)] = np.asarray(theta)[:, None]
        self._stages, self._still = aligned((0,)), aligned((0,))

    def roll_out(
        self,
        segments: Segments,
        x0: Annotated[np.ndarray, "segments size"],
        xi: Annotated[np.ndarray, "weights"],
    ) -> Annotated[np.ndarray, "nodes segments size"]:
        """Return the states from the starts x0: equation 7."""
        states, _ = self._rolled(segments, x0, np.ascontiguousarray(xi, dtype=float))
        return np.moveaxis(rows_of(states, segments.count), 0, 1)

    def pushed(self, segments: Segments) -> Pushed:
        """Return roll-outs of these segments, each with its theta and acceleration, without the network."""
        drive, flight = (lanes_of(rows) for rows in (segments.drive, segments.constants))
        groups, steps = len(drive), segments.steps
        states, xi = aligned((groups, steps + 1, self.phi.size, LANES)), np.zeros(self.layout.size)
        stages = aligned((self._kernel.stage_bytes // 2,))

        def roll(x0: np.ndarray, theta: np.ndarray, push: np.ndarray) -> np.ndarray:
            start, pushes = lanes_of(x0), lanes_of(push)
            thetas = aligned((groups, max(1, theta.shape[1]), LANES))
            thetas[:, : theta.shape[1]] = lanes_of(theta) if theta.shape[1] else 0.0
            inputs = (*map(pointers, (start, drive, flight, thetas, pushes)), [pointer(stages)] * groups)
            self._roll(xi, steps, (*inputs, pointers(states)), store=False)
            return rows_of(states, len(x0))

        return roll

    def gradient(
        self,
        segments: Segments,
        x0: Annotated[np.ndarray, "segments size"],
        xi: Annotated[np.ndarray, "weights"],
    ) -> Gradient:
        """Return loss and gradient: the roll-out, then the adjoint backwards (equations 8 and 9)."""
        xi = np.ascontiguousarray(xi, dtype=float)
        states, (drive, flight) = self._rolled(segments, x0, xi)
        measured = lanes_of(segments.measured)
        pull = states[:, :, :MEASURED] - measured
        weight = (self.weight / segments.steps)[:, None]
        unused = len(states) * LANES - segments.count
        if unused:
            pull[-1, :, :, LANES - unused :] = 0.0
        pull[:, 0] = 0.0
        loss = float((weight * pull**2).sum())
        pull *= 2.0 * weight
        pull = _aligned(pull)
        of_xi, of_theta = np.zeros(len(xi)), np.zeros(len(self._theta))
        costate, theta_back = aligned((len(states), self.phi.size, LANES)), aligned(self._theta.shape)
        weights, theta, still = pointer(xi), pointer(self._theta), pointer(self._still)
        steps, step_s = ctypes.c_long(segments.steps), ctypes.c_double(self.step_s)
        rows = (drive, flight, self._stages, pull, costate)
        for d, c, stages, vjp, back in zip(*map(pointers, rows), strict=True):
            self._kernel.adjoint(
                weights, d, c, theta, still, steps, step_s, stages, vjp, back, pointer(of_xi),
                pointer(theta_back),
            )  # fmt: skip
            of_theta += theta_back.sum(1)
        return Gradient(
            loss=loss,
            xi=of_xi,
            x0=rows_of(costate, segments.count),
            theta=of_theta[: len(self.phi.theta_names)],
        )

    def _rolled(
        self, segments: Segments, x0: np.ndarray, xi: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Return states (groups, N + 1, size, LANES), drive and constants over lanes; store the stages."""
        start, drive, flight = (lanes_of(rows) for rows in (x0, segments.drive, segments.constants))
        groups, steps = len(start), segments.steps
        states = aligned((groups, steps + 1, self.phi.size, LANES))
        need = (groups, 4 * steps * self._kernel.stage_bytes // 8)
        if self._stages.shape != need:
            self._stages, self._still = aligned(need), aligned((2 * steps + 1, 3, LANES))
        shared = ([pointer(array)] * groups for array in (self._theta, self._still))
        inputs = (*map(pointers, (start, drive, flight)), *shared, pointers(self._stages))
        self._roll(xi, steps, (*inputs, pointers(states)), store=True)
        return states, (drive, flight)

    def _roll(
        self, xi: np.ndarray, steps: int, rows: Sequence[Sequence[ctypes.c_void_p]], *, store: bool
    ) -> None:
        """Roll out each group. rows: addresses of start, drive, constants, theta, push, stages, states."""
        weights = pointer(xi)
        sizes = ctypes.c_long(steps), ctypes.c_double(self.step_s), ctypes.c_int(store)
        for *inputs, stages, states in zip(*rows, strict=True):
            self._kernel.roll_out(weights, *inputs, *sizes, stages, states)


def _aligned(array: np.ndarray) -> np.ndarray:
    out = aligned(array.shape)
    out[:] = array
    return out
