"""Algorithm 1 over SIMD lanes: roll-outs and gradients of a batch of segments by the compiled kernel."""

from __future__ import annotations

import ctypes
from functools import partial
from typing import Annotated

import numpy as np

from trimtab.host.codegen.compiler import Compiler, compiled
from trimtab.host.codegen.simd import aligned, lanes_of, pointer, rows_of
from trimtab.host.learn.adjoint import Gradient, Pushed, Rollouts, check_split
from trimtab.host.learn.kernel import MEASURED, kernel
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
        self.phi, self.layout, self.split = phi, layout, phi.substeps(step_s)
        self.step_s = step_s / self.split
        self.weight = np.asarray(weight, dtype=float)
        self._kernel = kernel(phi, layout, compiler)
        self._lanes = self._kernel.roll_out.lanes
        self._theta = aligned((max(1, len(theta)), self._lanes))
        self._theta[: len(theta)] = np.asarray(theta)[:, None]
        self._roll = partial(self._kernel.roll_out, step_s=self.step_s, every=self.split)
        self._stages = aligned((0,))

    def roll_out(
        self,
        segments: Segments,
        x0: Annotated[np.ndarray, "segments size"],
        xi: Annotated[np.ndarray, "weights"],
    ) -> Annotated[np.ndarray, "nodes segments size"]:
        """Return the states from the starts x0: equation 7."""
        xi = np.ascontiguousarray(xi, dtype=float)
        inputs = (lanes_of(rows, self._lanes) for rows in (x0, segments.drive, segments.constants))
        states = self._states(segments)
        for x, d, c, out in zip(*inputs, states, strict=True):
            self._roll(xi, x, d, None, c, self._theta, None, stages=None, samples=out)
        return np.moveaxis(rows_of(states, segments.count), 0, 1)

    def pushed(self, segments: Segments) -> Pushed:
        """Return roll-outs of these segments, each with its theta and acceleration, without the network."""
        check_split(segments, self.split)
        drive, flight = (lanes_of(rows, self._lanes) for rows in (segments.drive, segments.constants))
        groups, steps = len(drive), segments.steps
        states = aligned((groups, steps + 1, self.phi.size, self._lanes))
        xi = np.zeros(self.layout.size)

        def roll(x0: np.ndarray, theta: np.ndarray, push: np.ndarray) -> np.ndarray:
            start, thetas, pushes = (lanes_of(rows, self._lanes) for rows in (x0, theta, push))
            self._kernel.roll_out.groups(
                xi,
                start,
                drive,
                flight,
                thetas,
                pushes,
                step_s=self.step_s,
                every=self.split,
                samples=states,
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
        lanes, weight = self._lanes, self.weight / segments.steps
        rows = (x0, segments.drive, segments.constants, segments.measured)
        start, drive, flight, measured = (lanes_of(part, lanes) for part in rows)
        steps = self.split * segments.steps
        states, stages = self._states(segments), self._room(steps)
        weights = aligned((len(states), MEASURED, lanes))
        weights[:] = 2.0 * weight[:, None]
        weights[-1, :, segments.count - len(states) * lanes + lanes :] = 0.0  # lanes without a segment
        by_lane = aligned((len(xi), lanes))
        of_xi, costate = np.zeros(len(xi)), aligned((len(states), self.phi.size, lanes))
        of_theta = aligned((len(states), *self._theta.shape))
        for g, x in enumerate(states):
            self._roll(xi, start[g], drive[g], None, flight[g], self._theta, None, stages=stages, samples=x)
            self._kernel.adjoint(
                *map(pointer, (xi, drive[g], flight[g], self._theta)), ctypes.c_long(steps),
                ctypes.c_double(self.step_s), ctypes.c_long(self.split),
                *map(pointer, (stages, x, measured[g], weights[g], costate[g], by_lane, of_xi, of_theta[g])),
            )  # fmt: skip
        # By segments, so that the sum does not depend on the number of lanes.
        error = rows_of(states[:, 1:, :MEASURED], segments.count) - segments.measured[:, 1:]
        loss = float((weight * error**2).sum())
        return Gradient(
            loss=loss,
            xi=of_xi,
            x0=rows_of(costate, segments.count),
            theta=rows_of(of_theta, segments.count).sum(0)[: len(self.phi.theta_names)],
        )

    def _states(self, segments: Segments) -> np.ndarray:
        """Return room for the states (groups, N + 1, size, lanes). Raises ValueError as `check_split`."""
        check_split(segments, self.split)
        groups = -(-segments.count // self._lanes)
        return aligned((groups, segments.steps + 1, self.phi.size, self._lanes))

    def _room(self, steps: int) -> np.ndarray:
        """Return room for the stages of one group, which stays in the cache from group to group."""
        size = 4 * steps * self._kernel.roll_out.stage_bytes // 8
        if self._stages.size != size:
            self._stages = aligned((size,))
        return self._stages
