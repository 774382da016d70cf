"""The reference as arrays: flat outputs at any times, with what is fed forward along them on board."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from firmware_model.law import feedforward as law_feedforward
from firmware_model.law.dfbc import Reference as FlatOutputs
from firmware_model.law.flatness import flat_attitude
from firmware_model.law.reference import hermite_yaw, septic
from firmware_model.law.rotations import matrix_to_euler
from firmware_model.law.step import feedforward_terms
from host.codegen.ops import NUMPY
from protocol.blobs import FeedForward, Reference

FLAT_ROWS = 14
"""p, v, a, j (NED), yaw, yaw rate."""
FEEDFORWARD_ROWS = 6
"""Residual acceleration fed forward and its derivative (NED)."""


def flat_outputs(reference: Reference, t_s: np.ndarray) -> np.ndarray:
    """(14, n): p, v, a, j in NED, yaw and yaw rate at times (n,) since the reference's start.

    Before its start and after its end the first and last position are held, at rest; so is yaw outside its
    nodes.
    """
    t = np.asarray(t_s, dtype=float)
    nodes = reference.nodes_ned()
    times = np.array([node.t_us for node in nodes]) * 1e-6
    states = np.array([node.state for node in nodes]).T
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    inside = np.clip(t, times[0], times[-1])
    p, v, a, j, _ = septic(times[k + 1] - times[k], inside - times[k], states[:, k], states[:, k + 1])  # type: ignore[arg-type]
    moving = ((t >= times[0]) & (t <= times[-1])).astype(float)
    rows = [*p, *(row * moving for row in (*v, *a, *j)), *_yaw(reference, t)]
    return np.array(rows)


def feedforward_rows(flat: np.ndarray, feedforward: FeedForward | None) -> np.ndarray:
    """(6, n): the residual acceleration fed forward along the flat outputs (14, n), and its derivative.

    The network's share has no derivative, on board as here.
    """
    rows = np.zeros((FEEDFORWARD_ROWS, flat.shape[1]))
    if feedforward is None:
        return rows
    reference = FlatOutputs(flat[0:3], flat[3:6], flat[6:9], flat[9:12], flat[12], flat[13])  # type: ignore[arg-type]
    network: Sequence[Any] = (0.0, 0.0, 0.0)
    if feedforward.layers:
        R, _ = flat_attitude(NUMPY, reference.a, reference.yaw)
        angles = matrix_to_euler(NUMPY, R)
        network = law_feedforward.network(NUMPY, feedforward.weights, feedforward.layers, reference.v, angles)
    accel, jerk = feedforward_terms(NUMPY, block(feedforward), reference, network)
    rows[:] = np.array([np.broadcast_to(row, flat.shape[1]) for row in (*accel, *jerk)])
    return rows


def block(feedforward: FeedForward | None) -> tuple[float, ...]:
    """Form (a) of a feed-forward; the neutral block where it has none."""
    if feedforward is None or feedforward.block is None:
        return law_feedforward.NEUTRAL
    return feedforward.block


def _yaw(reference: Reference, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Yaw and yaw rate at times (n,)."""
    nodes = reference.yaw_nodes()
    times = np.array([node.t_us for node in nodes]) * 1e-6
    yaw = np.array([node.yaw for node in nodes])
    rate = np.array([node.yaw_rate for node in nodes])
    if len(nodes) == 1:
        return np.full(t.shape, yaw[0]), np.zeros(t.shape)
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    inside = np.clip(t, times[0], times[-1])
    value, slope = hermite_yaw(
        times[k + 1] - times[k], inside - times[k], yaw[k], rate[k], yaw[k + 1], rate[k + 1]
    )
    return value, slope * ((t >= times[0]) & (t <= times[-1]))
