"""The estimate as Flight sets it: by the first pose at rest, by each pose that comes, by calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from firmware_model.law import step as law
from firmware_model.poses import PoseInput
from firmware_model.readiness import GyroCalibration

STILL = 1e-3
"""m/s and rad/s: a vehicle that is slower in both may have the same pose twice."""


class Estimate:
    """Keeps the estimate in the engine's block `memory`, and what is on its way into it.

    `poses` are those that wait for a tick; `calibration` is the gyro's.
    """

    def __init__(self, inputs: Mapping[str, memoryview[float]]) -> None:
        self.poses = PoseInput(inputs)
        self.calibration = GyroCalibration()
        self._memory = inputs["memory"]
        self._gyro, self._force = inputs["gyro"], inputs["specific_force"]

    def begin(self) -> None:
        """Nothing comes back; nothing is known yet."""
        for k, value in enumerate(law.initial_memory()):
            self._memory[k] = value

    def offer(
        self, time_us: int, p: Sequence[float], q: Sequence[float], now_us: int, *, aloft: bool
    ) -> bool:
        """Whether the pose waits for a tick now; one that repeats the last is none in the air."""
        return self.poses.offer(time_us, p, q, now_us, moving=aloft and self._moving())

    def take_pose(self, now_us: int, restart_us: int | None) -> bool:
        """Whether the oldest waiting pose is in the engine's inputs, for one tick.

        The first pose of all sets the estimate instead, and so does one that follows on the pose before by
        more than `restart_us` (None: never).
        """
        pose, before_us = self.poses.take()
        if before_us is None or (restart_us is not None and pose[0] - before_us > restart_us):
            self._set(pose[1], pose[2])
            return False
        self.poses.show(pose, before_us, now_us)
        return True

    def calibrate(self, now_us: int, most: float) -> bool:
        """Whether this look completed the gyro's calibration; a bias above `most` (rad/s) is not believed."""
        memory, calibration = self._memory, self.calibration
        if not calibration.look(now_us, self._gyro, self._force, memory[law.GYRO_SUM], most):
            return False
        assert calibration.bias is not None
        for k, value in enumerate(calibration.bias):
            memory[law.EST_BIAS.start + k] = value
        return True

    def _moving(self) -> bool:
        memory, gyro = self._memory, self._gyro
        rate = (g - b for g, b in zip(gyro, memory[law.EST_BIAS], strict=True))
        return math.hypot(*memory[law.EST_V]) > STILL or math.hypot(*rate) > STILL

    def _set(self, p: Sequence[float], q: Sequence[float]) -> None:
        """The estimate is this pose, at rest; the gyro bias stays."""
        for k, value in enumerate((*p, 0.0, 0.0, 0.0, *q)):
            self._memory[k] = value
