"""Dead reckoning of velocity and height while no poses arrive.

An accelerometer bias of 0.1 m/s^2 becomes 0.7 m/s after seven seconds. While poses arrive, the estimator
removes it by corrections; their mean is the bias, with the opposite sign. Without poses, it is applied in
their place.
"""

from __future__ import annotations

from collections.abc import Mapping

from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import mat_vec, quat_to_matrix
from trimtab.protocol.telemetry import TICK_US

LEARN_US = 50_000
"""Interval over which corrections are measured."""
MEAN_S = 2.0
"""Time constant of the mean of corrections."""
CORRECTION_MAX = 0.5
"""Greatest correction (m/s^2, each axis); a good accelerometer needs less, and faulty poses feign more."""
NEAR_M, DRIFT = 0.1, 0.15
"""Greatest height (m) of a touchdown, and its growth (m/s) with the time without poses."""
_FIRST = 20  # intervals without a correction that the mean begins with: one alone is mostly noise

_TICK_S = 1e-6 * TICK_US


class DeadReckoning:
    """Learns the mean correction of the velocity, and applies it while no poses arrive.

    memory: the engine's block `memory`. `correction`: mean acceleration (m/s^2, NED) that the estimator adds
    to the measured one.
    """

    def __init__(self, memory: memoryview[float]) -> None:
        self._memory = memory
        self.correction = [0.0, 0.0, 0.0]
        self._count = _FIRST
        self._start_us: int | None = None
        self._R = (0.0,) * 9
        self._v = self._force_sum = (0.0, 0.0, 0.0)

    def learn(self, now_us: int) -> None:
        """Measure the correction since the last call, if LEARN_US have passed. Poses must have arrived."""
        start_us = self._start_us
        if start_us is not None and now_us - start_us < LEARN_US:
            return
        memory = self._memory
        R = quat_to_matrix(FLOAT, memory[law.EST_Q])
        vx, vy, vz = memory[law.EST_V]
        sx, sy, sz = memory[law.FORCE_SUM]
        if start_us is not None:
            dt = 1e-6 * (now_us - start_us)
            x, y, z = self._force_sum
            scale = 0.5 * _TICK_S / law.FORCE_COUNTS  # half: the mean of two attitudes
            force = (scale * (sx - x), scale * (sy - y), scale * (sz - z))
            north, east, down = mat_vec([a + b for a, b in zip(R, self._R, strict=True)], force)
            x, y, z = self._v
            self._average(dt, (vx - x - north, vy - y - east, vz - z - down - GRAVITY * dt))
        self._start_us, self._R, self._v, self._force_sum = now_us, R, (vx, vy, vz), (sx, sy, sz)

    def pause(self) -> None:
        """Leave out the time until the next call of `learn`."""
        self._start_us = None

    def start(self, lost_s: float, parameters: Mapping[str, float]) -> None:
        """Apply the correction of the time since the last pose.

        A bias b also leaves an error b EST_POS / EST_VEL in the velocity while poses arrive: the corrections
        of the velocity are -b, so those of the position are -b EST_POS / EST_VEL.
        """
        self.apply(lost_s + parameters["EST_POS"] / parameters["EST_VEL"])

    def apply(self, seconds: float) -> None:
        """Add the correction of this time, which ends now, to velocity and position."""
        memory = self._memory
        for k, correction in enumerate(self.correction):
            memory[law.EST_P.start + k] += 0.5 * correction * seconds * seconds
            memory[law.EST_V.start + k] += correction * seconds

    def _average(self, dt: float, change: tuple[float, float, float]) -> None:
        self._count += 1
        share = max(1.0 / self._count, dt / MEAN_S)
        for k, value in enumerate(change):
            measured = min(max(value / dt, -CORRECTION_MAX), CORRECTION_MAX)
            self.correction[k] += share * (measured - self.correction[k])


def near_floor_m(lost_us: int) -> float:
    """Return the dead-reckoned height (m) below which a force may be the floor's, this long after a pose."""
    return NEAR_M + DRIFT * 1e-6 * lost_us
