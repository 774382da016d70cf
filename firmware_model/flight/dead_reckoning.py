"""Dead reckoning of velocity and height while no poses arrive.

An accelerometer bias of 0.1 m/s^2 becomes 0.7 m/s after seven seconds. While poses arrive, the estimator
removes it by corrections; their mean is the bias, with the opposite sign. Without poses, it is applied in
their place.

Quick turns with late poses disturb the estimated gyro bias for ten seconds, and 0.015 rad/s becomes 4 deg in
five. A true bias changes slowly. Without poses, one that has followed the estimate slowly takes its place.
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
BIAS_RATE = 2e-4
"""Greatest change of the gyro bias (rad/s^2, each axis), from warming for example."""
NEAR_M, DRIFT = 0.1, 0.15
"""Greatest height (m) of a touchdown, and its growth (m/s) with the time without poses."""
_FIRST = 20  # intervals without a correction that the mean begins with: one alone is mostly noise

_TICK_S = 1e-6 * TICK_US


class DeadReckoning:
    """Learns the mean correction of the velocity and the gyro bias, and applies them while no poses arrive.

    memory: the engine's block `memory`. `correction`: mean acceleration (m/s^2, NED) that the estimator adds
    to the measured one. `bias`: gyro bias (rad/s, FRD) that changes by BIAS_RATE at most.
    """

    def __init__(self, memory: memoryview[float]) -> None:
        self._memory = memory
        self.correction = [0.0, 0.0, 0.0]
        self.bias = [0.0, 0.0, 0.0]
        self._count = _FIRST
        self._start_us: int | None = None
        self._R = (0.0,) * 9
        self._v = self._force_sum = (0.0, 0.0, 0.0)

    def learn(self, now_us: int) -> None:
        """Measure the correction over the last LEARN_US, once they have passed. Poses must have arrived.

        A longer interval is left out: it may hold a landing.
        """
        start_us = self._start_us
        if start_us is not None and now_us - start_us < LEARN_US:
            return
        if start_us is not None and now_us - start_us >= 2 * LEARN_US:
            start_us = None
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

    def calibrated(self) -> None:
        """Take the gyro bias of a calibration."""
        self.bias = list(self._memory[law.EST_BIAS])

    def follow_bias(self, seconds: float) -> None:
        """Follow the estimated gyro bias for this time, with poses."""
        most = BIAS_RATE * seconds
        for k, value in enumerate(self._memory[law.EST_BIAS]):
            self.bias[k] += min(max(value - self.bias[k], -most), most)

    def pause(self) -> None:
        """Leave out the time until the next call of `learn`."""
        self._start_us = None

    def start(self, lost_s: float, parameters: Mapping[str, float]) -> None:
        """Apply the gyro bias, and the correction of the time since the last pose.

        A bias b also leaves an error b EST_POS / EST_VEL in the velocity while poses arrive: the corrections
        of the velocity are -b, so those of the position are -b EST_POS / EST_VEL.
        """
        for k, value in enumerate(self.bias):
            self._memory[law.EST_BIAS.start + k] = value
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
