"""Linearised roll-outs: each step by central differences, then all steps chained.

A step has few inputs, so this takes about as long as forty roll-outs, for any number of steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.learn.adjoint import Rollouts
from trimtab.host.learn.lanes import LaneRollouts
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments

_PUSH = 0.05
"""m/s^2: step of differences by the acceleration."""

_SHARE = 0.02
"""Step of differences by a parameter, in typical sizes, and by a state, in sigmas."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised:
    """Roll-outs of segments, linearised step by step.

    states: the roll-outs. The slopes of the end of each step are by its start, by the accelerations at its
    start and at its end, and by the free parameters in typical sizes.
    """

    states: Annotated[np.ndarray, "segments nodes size"]
    by_state: Annotated[np.ndarray, "segments steps size size"]
    by_first: Annotated[np.ndarray, "segments steps size 3"]
    by_second: Annotated[np.ndarray, "segments steps size 3"]
    by_theta: Annotated[np.ndarray, "segments steps size parameters"]

    def chained(
        self, start: Annotated[np.ndarray, "segments size columns"]
    ) -> Annotated[np.ndarray, "segments steps 12 slopes"]:
        """Return the slopes of the predictions by the free parameters, then by changes of the start."""
        count, steps, size, parameters = self.by_theta.shape
        slope = np.concatenate([np.zeros((count, size, parameters)), start], axis=2)
        slopes = np.empty((count, steps, 12, slope.shape[2]))
        for k in range(steps):
            slope = self.by_state[:, k] @ slope
            slope[:, :, :parameters] += self.by_theta[:, k]
            slopes[:, k] = slope[:, :12]
        return slopes

    def products(
        self,
        weight: Annotated[np.ndarray, "12"],
        others: Annotated[np.ndarray, "segments steps 12 columns"],
    ) -> Annotated[np.ndarray, "segments products products"]:
        """Return the weighted products of all pairs of slopes of the predictions, summed over the steps.

        The first columns are the slopes by the accelerations, 3 for each node. `others` follow them. The sums
        run backwards in time, as in an adjoint, so the first slopes themselves are never formed.
        """
        count, steps, size, _ = self.by_state.shape
        first = 3 * (steps + 1)
        costate = np.zeros((count, size, first + others.shape[3]))
        out = np.zeros((count, costate.shape[2], costate.shape[2]))
        flat = (np.sqrt(weight)[:, None] * others).reshape(count, -1, others.shape[3])
        out[:, first:, first:] = flat.swapaxes(1, 2) @ flat
        weighted = weight[:, None] * others
        by_later = np.zeros((count, size, size))  # products of the slopes by the state at a node
        for k in range(steps, -1, -1):
            node, columns = slice(3 * k, 3 * k + 3), slice(3 * k, None)
            if k < steps:
                turned = self.by_state[:, k].swapaxes(1, 2)
                out[:, node, columns] = self.by_first[:, k].swapaxes(1, 2) @ costate[:, :, columns]
                costate[:, :, columns] = turned @ costate[:, :, columns]
                by_later = turned @ by_later @ self.by_state[:, k]
            if k > 0:
                arriving, pushed = self.by_second[:, k - 1], self.by_first[:, k - 1]
                if k > 1:
                    pushed = pushed + self.by_state[:, k - 1] @ self.by_second[:, k - 2]
                by_later[:, :12, :12] += np.diag(weight)
                costate[:, :12, node] += weight[:, None] * arriving[:, :12]
                costate[:, :12, first:] += weighted[:, k - 1]
                out[:, node, columns] += arriving.swapaxes(1, 2) @ costate[:, :, columns]
                costate[:, :, 3 * k - 3 : 3 * k] = by_later @ pushed
            out[:, columns, node] = out[:, node, columns].swapaxes(1, 2)
        return out


def linearised(
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    start: Annotated[np.ndarray, "segments size"],
    acceleration: Annotated[np.ndarray, "segments nodes 3"],
    theta: Annotated[np.ndarray, "parameters"],
    free: Sequence[int],
    sigma: Annotated[np.ndarray, "segments size"],
) -> Linearised:
    """Return the roll-outs from `start`, linearised by central differences of each step.

    sigma: scale of changes of the state.
    """
    thetas = np.repeat(theta[None], segments.count, axis=0)
    states = engine.pushed(segments)(start, thetas, between(acceleration, segments.split))
    by_state, by_first, by_second, by_theta = _step_slopes(
        engine, segments, states, acceleration, theta, free, sigma
    )
    return Linearised(
        states=states, by_state=by_state, by_first=by_first, by_second=by_second, by_theta=by_theta
    )


def _step_slopes(
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    states: np.ndarray,
    acceleration: np.ndarray,
    theta: np.ndarray,
    free: Sequence[int],
    sigma: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the slopes (S, N, size, columns) of the end of each step.

    They are by its start, by the acceleration at its start and at its end, and by the free parameters in
    typical sizes.
    """
    count, steps, size = states.shape[0], states.shape[1] - 1, states.shape[2]
    stages = 2 * segments.split
    rows = np.arange(count * steps)
    segment, step = rows // steps, rows % steps
    single = Segments(
        step_s=segments.step_s,
        x0=states[:, :-1].reshape(-1, size),
        measured=np.zeros((len(rows), 2, 12)),
        sigma=segments.sigma[segment],
        drive=segments.drive[segment[:, None], stages * step[:, None] + np.arange(stages + 1)],
        constants=segments.constants[segment],
        flight=segments.flight[segment],
        vectors=segments.vectors,
    )
    roll = engine.pushed(single)
    start, thetas = single.x0.copy(), np.repeat(theta[None], len(rows), axis=0)
    ends = np.stack([acceleration[:, :-1], acceleration[:, 1:]], axis=2).reshape(-1, 2, 3)

    def slope(array: np.ndarray, column: int, reach: np.ndarray | float) -> np.ndarray:
        """Return the slope (S N, size) by a column of an array that the roll-out reads."""
        centre = array[:, column].copy()
        results = []
        for sign in (1.0, -1.0):
            array[:, column] = centre + sign * reach
            results.append(roll(start, thetas, between(ends, segments.split))[:, 1])
        array[:, column] = centre
        return (results[0] - results[1]) / (2.0 * np.reshape(reach, (-1, 1)))

    def stacked(columns: list[np.ndarray]) -> np.ndarray:
        """Return slopes as one array (S, N, size, columns)."""
        if not columns:
            return np.zeros((count, steps, size, 0))
        return np.stack(columns, axis=-1).reshape(count, steps, size, -1)

    flat, spread, scale = ends.reshape(-1, 6), _SHARE * sigma[segment], effect_scales(engine.phi)
    by_push = stacked([slope(flat, i, _PUSH) for i in range(6)])
    return (
        stacked([slope(start, i, spread[:, i]) for i in range(size)]),
        by_push[..., :3],
        by_push[..., 3:],
        stacked([scale[i] * slope(thetas, i, _SHARE * scale[i]) for i in free]),
    )


def between(nodes: Annotated[np.ndarray, "... nodes 3"], split: int) -> Annotated[np.ndarray, "... stages 3"]:
    """Return the values at nodes, and between them on straight lines at 2 * split - 1 equal distances."""
    stages = 2 * split
    out = np.empty((*nodes.shape[:-2], stages * (nodes.shape[-2] - 1) + 1, nodes.shape[-1]))
    out[..., ::stages, :] = nodes
    for k in range(1, stages):
        share = k / stages
        out[..., k::stages, :] = (1.0 - share) * nodes[..., :-1, :] + share * nodes[..., 1:, :]
    return out


def effect_scales(phi: Phi) -> Annotated[np.ndarray, "parameters"]:
    """Return the typical sizes of the parameters of phi's effects."""
    return np.array([p.typical for effect in phi.effects for p in effect.parameters])
