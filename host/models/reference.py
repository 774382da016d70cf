"""The reference as arrays: flat outputs at any times, and the feed-forward along them."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from trimtab.firmware_model.law import feedforward as law_feedforward
from trimtab.firmware_model.law.dfbc import FlatState
from trimtab.firmware_model.law.step import feedforward_terms, flat_motion
from trimtab.host.codegen.ops import NUMPY
from trimtab.host.log.tracking import ReferencePath
from trimtab.protocol.blobs import FeedForward, Reference

FLAT_ROWS = 14
"""p, v, a, j (NED), yaw, yaw rate."""
FEEDFORWARD_ROWS = 6
"""Residual acceleration fed forward and its derivative (NED)."""


def flat_outputs(
    reference: Reference | ReferencePath, t_s: Annotated[np.ndarray, "times"]
) -> Annotated[np.ndarray, "14 times"]:
    """Return p, v, a, j in NED, yaw and yaw rate at times since the reference's start.

    Before the start and after the end, the end nodes apply. For many calls, give a `ReferencePath`.
    """
    path = reference if isinstance(reference, ReferencePath) else ReferencePath(reference)
    t_us: Any = 1e6 * np.asarray(t_s, dtype=float)
    return np.ascontiguousarray(path.at(t_us).T)


def feedforward_rows(
    flat: Annotated[np.ndarray, "14 times"], feedforward: FeedForward | None
) -> Annotated[np.ndarray, "6 times"]:
    """Return the residual acceleration fed forward along flat outputs, and its derivative, as on board."""
    rows = np.zeros((FEEDFORWARD_ROWS, flat.shape[1]))
    if feedforward is None:
        return rows
    reference = FlatState(flat[0:3], flat[3:6], flat[6:9], flat[9:12], flat[12], flat[13])  # type: ignore[arg-type]
    network = law_feedforward.NO_RESIDUAL
    if feedforward.layers:
        motion, _ = flat_motion(NUMPY, reference)
        network = law_feedforward.network_residual(
            NUMPY,
            feedforward.weights,
            feedforward.layers,
            motion,
            body_frame=feedforward.body_frame,
            with_jerk=feedforward.feeds_jerk,
        )
    accel, jerk, _ = feedforward_terms(NUMPY, block(feedforward), reference, network)
    rows[:] = np.array([np.broadcast_to(row, flat.shape[1]) for row in (*accel, *jerk)])
    return rows


def thrust_gain(
    feedforward: FeedForward | None, voltage_ratio: Annotated[np.ndarray, "times"] | float
) -> Annotated[np.ndarray, "times"]:
    """Return the gain (actual over nominal thrust) of the law at battery voltages over full voltage."""
    coefficients = block(feedforward)
    gain, exponent = coefficients[law_feedforward.GAIN], coefficients[law_feedforward.VOLTAGE_EXPONENT]
    return law_feedforward.gain_at_voltage(NUMPY, gain, exponent, np.asarray(voltage_ratio, dtype=float))


def block(feedforward: FeedForward | None) -> tuple[float, ...]:
    """Return the law's block of a feed-forward: its form (a), or the neutral one, and its region."""
    if feedforward is None:
        return law_feedforward.NEUTRAL
    return law_feedforward.full_block(feedforward.block, feedforward.region)
