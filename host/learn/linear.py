"""Linearised roll-outs: each step by central differences, then all steps chained.

A step has few inputs, so this takes about as long as forty roll-outs, for any number of steps.
"""

from __future__ import annotations

from collections.abc import Sequence
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


def linearised(
    engine: Rollouts | LaneRollouts,
    segments: Segments,
    start: Annotated[np.ndarray, "segments size"],
    acceleration: Annotated[np.ndarray, "segments nodes 3"],
    theta: Annotated[np.ndarray, "parameters"],
    free: Sequence[int],
    sigma: Annotated[np.ndarray, "segments size"],
) -> tuple[
    Annotated[np.ndarray, "segments rows"],
    Annotated[np.ndarray, "segments rows columns"],
    Annotated[np.ndarray, "segments rows size"],
]:
    """Return the predictions, 12 rows for each step, with their slopes.

    The slopes are by node accelerations and free parameters, and by sigmas of the start. Each step is
    linearised by central differences about the roll-out, and the steps are chained.
    """
    count, nodes = acceleration.shape[:2]
    steps, size = nodes - 1, engine.phi.size
    thetas = np.repeat(theta[None], count, axis=0)
    states = engine.pushed(segments)(start, thetas, between(acceleration))
    by_state, by_first, by_second, by_theta = _step_slopes(
        engine, segments, states, acceleration, theta, free, sigma
    )
    moved = np.empty((count, steps, 12, 3 * nodes + len(free)))
    shifted = np.empty((count, steps, 12, size))
    by_u, by_start = np.zeros((count, size, 3 * nodes + len(free))), sigma[:, None, :] * np.eye(size)
    for k in range(steps):
        reached = 3 * (k + 1)
        by_u[:, :, :reached] = by_state[:, k] @ by_u[:, :, :reached]
        by_u[:, :, 3 * nodes :] = by_state[:, k] @ by_u[:, :, 3 * nodes :] + by_theta[:, k]
        by_u[:, :, 3 * k : reached] += by_first[:, k]
        by_u[:, :, reached : reached + 3] += by_second[:, k]
        by_start = by_state[:, k] @ by_start
        moved[:, k], shifted[:, k] = by_u[:, :12], by_start[:, :12]
    base = states[:, 1:, :12].reshape(count, -1)
    return base, moved.reshape(count, 12 * steps, -1), shifted.reshape(count, 12 * steps, -1)


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
    rows = np.arange(count * steps)
    segment, step = rows // steps, rows % steps
    single = Segments(
        step_s=segments.step_s,
        x0=states[:, :-1].reshape(-1, size),
        measured=np.zeros((len(rows), 2, 12)),
        sigma=segments.sigma[segment],
        drive=segments.drive[segment[:, None], 2 * step[:, None] + np.arange(3)],
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
            results.append(roll(start, thetas, between(ends))[:, 1])
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


def between(nodes: Annotated[np.ndarray, "... nodes 3"]) -> Annotated[np.ndarray, "... stages 3"]:
    """Return the values at nodes with their means half way between."""
    out = np.empty((*nodes.shape[:-2], 2 * nodes.shape[-2] - 1, nodes.shape[-1]))
    out[..., 0::2, :] = nodes
    out[..., 1::2, :] = 0.5 * (nodes[..., 1:, :] + nodes[..., :-1, :])
    return out


def effect_scales(phi: Phi) -> Annotated[np.ndarray, "parameters"]:
    """Return the typical sizes of the parameters of phi's effects."""
    return np.array([p.typical for effect in phi.effects for p in effect.parameters])
