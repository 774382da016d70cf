"""Algorithm 1 over SIMD lanes: roll-outs and gradients of a batch of segments by the compiled kernel."""

from __future__ import annotations

import ctypes
from functools import partial
from typing import Annotated

import numpy as np

from trimtab.host.codegen.compiler import Compiler, compiled
from trimtab.host.codegen.simd import aligned, lanes_of, pointer, rows_of
from trimtab.host.learn.adjoint import Gradient, Pushed, Rollouts, check_step
from trimtab.host.learn.kernel import MEASURED, kernel, pointers
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
        self._lanes = self._kernel.roll_out.lanes
        self._theta = aligned((max(1, len(theta)), self._lanes))
        self._theta[: len(theta)] = np.asarray(theta)[:, None]
        self._roll = partial(self._kernel.roll_out, step_s=step_s, every=1)
        self._stages = aligned((0,))

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
        drive, flight = (lanes_of(rows, self._lanes) for rows in (segments.drive, segments.constants))
        groups, steps = len(drive), segments.steps
        states = aligned((groups, steps + 1, self.phi.size, self._lanes))
        xi = np.zeros(self.layout.size)

        def roll(x0: np.ndarray, theta: np.ndarray, push: np.ndarray) -> np.ndarray:
            start, thetas, pushes = (lanes_of(rows, self._lanes) for rows in (x0, theta, push))
            self._kernel.roll_out.groups(
                xi, start, drive, flight, thetas, pushes, step_s=self.step_s, samples=states
            )
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
        # By segments, so that sums do not depend on the number of lanes.
        pull = rows_of(states, segments.count)[:, :, :MEASURED] - segments.measured
        weight = self.weight / segments.steps
        pull[:, 0] = 0.0
        loss = float((weight * pull**2).sum())
        pull = lanes_of(2.0 * weight * pull, self._lanes)
        unused = len(states) * self._lanes - segments.count
        pull[-1, :, :, self._lanes - unused :] = 0.0
        of_xi, costate = np.zeros(len(xi)), aligned((len(states), self.phi.size, self._lanes))
        of_theta = aligned((len(states), *self._theta.shape))
        weights, theta = pointer(xi), pointer(self._theta)
        steps, step_s = ctypes.c_long(segments.steps), ctypes.c_double(self.step_s)
        rows = (drive, flight, self._stages, pull, costate, of_theta)
        for d, c, stages, vjp, back, theta_back in zip(*map(pointers, rows), strict=True):
            self._kernel.adjoint(
                weights, d, c, theta, steps, step_s, stages, vjp, back, pointer(of_xi), theta_back,
            )  # fmt: skip
        return Gradient(
            loss=loss,
            xi=of_xi,
            x0=rows_of(costate, segments.count),
            theta=rows_of(of_theta, segments.count).sum(0)[: len(self.phi.theta_names)],
        )

    def _rolled(
        self, segments: Segments, x0: np.ndarray, xi: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Return states (groups, N + 1, size, lanes), drive and constants over lanes; store the stages."""
        start, drive, flight = (
            lanes_of(rows, self._lanes) for rows in (x0, segments.drive, segments.constants)
        )
        groups, steps = len(start), segments.steps
        states = aligned((groups, steps + 1, self.phi.size, self._lanes))
        need = (groups, 4 * steps * self._kernel.roll_out.stage_bytes // 8)
        if self._stages.shape != need:
            self._stages = aligned(need)
        for x, d, c, stages, out in zip(start, drive, flight, self._stages, states, strict=True):
            self._roll(xi, x, d, None, c, self._theta, None, stages=stages, samples=out)
        return states, (drive, flight)
