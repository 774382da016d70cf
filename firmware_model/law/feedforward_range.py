"""Ranges of a feed-forward: checked by the host when it makes one, and on board before one is accepted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from trimtab.firmware_model.law import feedforward as law
from trimtab.firmware_model.law.ops import FLOAT, Vector
from trimtab.firmware_model.law.rotations import euler_to_matrix

GAIN_RANGE = (0.3, 3.0)
"""Bounds of the gain (actual over nominal thrust)."""
BIAS_MAX = 5.0
"""Greatest bias, m/s^2."""
DRAG_MAX = 5.0
"""Greatest linear (1/s) and quadratic (1/m) drag coefficient."""
OFFSET_MAX = 0.2
"""Greatest attitude offset, rad."""
PREDICTION_MAX_S = 0.1
WIND_MAX = 15.0
"""Greatest component of the wind, m/s."""
EXPONENT_MAX = 5.0
"""Greatest magnitude of the voltage exponent."""
NETWORK_MAX = 5.0
"""Greatest residual acceleration of a network, m/s^2."""
NETWORK_SPEED = 10.0
"""Greatest speed (m/s) at which a network is checked."""
NETWORK_TILT = 1.0
"""Greatest tilt (rad) at which a network is checked."""

_ZERO = (0.0, 0.0, 0.0)
_DIAGONAL = math.sqrt(0.5)
_CARDINAL = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
_DIRECTIONS = (
    _ZERO,
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
    *((n, e, 0.0) for n, e in _CARDINAL),
    *((_DIAGONAL * (n - e), _DIAGONAL * (n + e), 0.0) for n, e in _CARDINAL),
)


class Excess(NamedTuple):
    """A quantity of a feed-forward that is out of range, its value and the bound that it exceeds."""

    quantity: str
    value: float
    bound: float


def out_of_range(
    block: Sequence[float], weights: Vector, layers: Sequence[int], *, body_frame: bool
) -> Excess | None:
    """Return the first quantity out of range, or None.

    block: as in `trimtab.firmware_model.law.feedforward`. weights, layers: of the network; empty without one.
    """
    for quantity, values, (low, high) in (
        ("gain", (block[law.GAIN],), GAIN_RANGE),
        ("bias", block[law.BIAS], (-BIAS_MAX, BIAS_MAX)),
        ("drag", (*block[law.LINEAR], *block[law.QUADRATIC]), (-DRAG_MAX, DRAG_MAX)),
        ("attitude offset", block[law.ATTITUDE_OFFSET], (-OFFSET_MAX, OFFSET_MAX)),
        ("prediction time", (block[law.PREDICTION_TIME],), (0.0, PREDICTION_MAX_S)),
        ("wind", block[law.WIND], (-WIND_MAX, WIND_MAX)),
        ("voltage exponent", (block[law.VOLTAGE_EXPONENT],), (-EXPONENT_MAX, EXPONENT_MAX)),
    ):
        for value in values:
            if not low <= value <= high:
                return Excess(quantity, value, low if value < low else high)
    if layers:
        speed, tilt = block[law.REGION][:2]
        speed, tilt = min(speed, NETWORK_SPEED), min(tilt, NETWORK_TILT)
        accel = _greatest_output(weights, layers, speed, tilt, body_frame=body_frame)
        if not accel <= NETWORK_MAX:
            return Excess("acceleration of the network", accel, NETWORK_MAX)
    return None


def _greatest_output(
    weights: Vector, layers: Sequence[int], speed: float, tilt: float, *, body_frame: bool
) -> float:
    """Return the greatest residual acceleration (m/s^2) of a network over samples, or the first out of range.

    The samples are rest and `speed` (m/s) in ten directions, level and at `tilt` (rad) of roll and pitch, at
    four headings.
    """
    yaws = (0.0,) if body_frame else (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi)
    tilts = ((0.0, 0.0), (tilt, 0.0), (-tilt, 0.0), (0.0, tilt), (0.0, -tilt))
    greatest = 0.0
    for direction, (roll, pitch), yaw in product(_DIRECTIONS, tilts, yaws):
        R = euler_to_matrix(FLOAT, (roll, pitch, yaw))
        v = tuple(speed * part for part in direction)
        motion = law.FlatMotion(v, _ZERO, R, _ZERO)
        accel = law.network_residual(FLOAT, weights, layers, motion, body_frame=body_frame).accel_ned
        size = math.hypot(*accel)
        if not size <= NETWORK_MAX:
            return size
        greatest = max(greatest, size)
    return greatest
