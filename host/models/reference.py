"""The reference as arrays: flat outputs at any times, and the feed-forward along them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from trimtab.firmware_model.law import feedforward as law_feedforward
from trimtab.firmware_model.law.dfbc import FlatState
from trimtab.firmware_model.law.flatness import flat_attitude
from trimtab.firmware_model.law.rotations import matrix_to_euler
from trimtab.firmware_model.law.step import feedforward_terms
from trimtab.host.codegen.ops import NUMPY
from trimtab.host.log.tracking import reference_at
from trimtab.protocol.blobs import FeedForward, Reference

FLAT_ROWS = 14
"""p, v, a, j (NED), yaw, yaw rate."""
FEEDFORWARD_ROWS = 6
"""Residual acceleration fed forward and its derivative (NED)."""


def flat_outputs(
    reference: Reference, t_s: Annotated[np.ndarray, "times"]
) -> Annotated[np.ndarray, "14 times"]:
    """Return p, v, a, j in NED, yaw and yaw rate at times since the reference's start.

    Before the start and after the end, the end nodes apply.
    """
    t_us: Any = 1e6 * np.asarray(t_s, dtype=float)
    return np.ascontiguousarray(reference_at(reference, t_us).T)


def feedforward_rows(
    flat: Annotated[np.ndarray, "14 times"], feedforward: FeedForward | None
) -> Annotated[np.ndarray, "6 times"]:
    """Return the residual acceleration fed forward along flat outputs, and its derivative.

    The network's share has no derivative, as on board.
    """
    rows = np.zeros((FEEDFORWARD_ROWS, flat.shape[1]))
    if feedforward is None:
        return rows
    reference = FlatState(flat[0:3], flat[3:6], flat[6:9], flat[9:12], flat[12], flat[13])  # type: ignore[arg-type]
    network: Sequence[Any] = (0.0, 0.0, 0.0)
    if feedforward.layers:
        R, _ = flat_attitude(NUMPY, reference.a, reference.yaw)
        angles = matrix_to_euler(NUMPY, R)
        network = law_feedforward.network(NUMPY, feedforward.weights, feedforward.layers, reference.v, angles)
    accel, jerk = feedforward_terms(NUMPY, block(feedforward), reference, network)
    rows[:] = np.array([np.broadcast_to(row, flat.shape[1]) for row in (*accel, *jerk)])
    return rows


def block(feedforward: FeedForward | None) -> tuple[float, ...]:
    """Return form (a) of a feed-forward; the neutral block where it has none."""
    if feedforward is None or feedforward.block is None:
        return law_feedforward.NEUTRAL
    return feedforward.block
