"""What must hold before the vehicle may arm, and the gyro calibration that is part of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from firmware_model.law.constants import GRAVITY
from firmware_model.law.step import GYRO_COUNTS, TICK_S

WINDOW_US = 500_000
"""Stillness that a calibration takes."""
STILL_RATE = 0.15
"""rad/s by which a gyro sample may differ from the window's first."""
STILL_FORCE = 1.0
"""m/s^2 by which the length of the specific force may differ from g."""
ARM_TILT_DEG = 20.0
"""Greatest tilt at arming."""


class GyroCalibration:
    """The gyro's bias as its mean over the first window in which the vehicle stood still.

    Look at it now and then with a sample and the law's running sums; the mean is over every tick in between.
    """

    def __init__(self) -> None:
        self.bias: tuple[float, float, float] | None = None
        self._start_us = -1
        self._first: Sequence[float] = ()
        self._sums: Sequence[float] = ()

    def look(
        self, now_us: int, gyro: Sequence[float], force: Sequence[float], sums: Sequence[float], most: float
    ) -> bool:
        """Whether this look completed the calibration.

        Args:
            gyro, force: samples of this tick, FRD. sums: the law's gyro sums, in counts, up to this tick.
            most: greatest bias (rad/s) that is believed.
        """
        if self.bias is not None:
            return False
        still = abs(math.hypot(*force) - GRAVITY) < STILL_FORCE
        if self._start_us >= 0:
            still = still and all(abs(a - b) < STILL_RATE for a, b in zip(gyro, self._first, strict=True))
        if not still:
            self._start_us = -1
            return False
        if self._start_us < 0:
            self._start_us, self._first, self._sums = now_us, tuple(gyro), tuple(sums)
            return False
        elapsed_us = now_us - self._start_us
        if elapsed_us < WINDOW_US:
            return False
        per_count = TICK_S / (GYRO_COUNTS * elapsed_us * 1e-6)
        x, y, z = ((b - a) * per_count for a, b in zip(self._sums, sums, strict=True))
        if max(abs(x), abs(y), abs(z)) > most:
            self._start_us = -1  # turning steadily
            return False
        self.bias = (x, y, z)
        return True


def refusal(*, calibrated: bool, has_pose: bool, cos_tilt: float) -> str | None:
    """Why the vehicle must not arm, None where it may."""
    if not calibrated:
        return "gyro not calibrated: keep still"
    if not has_pose:
        return "no mocap"
    if cos_tilt < math.cos(math.radians(ARM_TILT_DEG)):
        return "tilted"
    return None
