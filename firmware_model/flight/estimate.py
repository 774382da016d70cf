"""The estimate as Flight sets it: by the first pose at rest, by each pose that comes, by calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.poses import PoseInput
from trimtab.firmware_model.flight.readiness import GyroCalibration
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.feedforward import PREDICTION_TIME

STILL = 1e-3
"""m/s and rad/s: a vehicle that is slower in both may have the same pose twice."""
_KNOWN = slice(law.EST_P.start, law.EST_Q.stop)


class Estimate:
    """Keeps the estimate in the engine's block `memory`, and what is on its way into it.

    `poses` are those that wait for a tick; `calibration` is the gyro's.
    """

    def __init__(self, inputs: Mapping[str, memoryview[float]], parameters: ParameterValues) -> None:
        self._parameters = parameters
        self.poses = PoseInput(inputs)
        self.calibration = GyroCalibration()
        self._memory = inputs["memory"]
        self._gyro, self._force = inputs["gyro"], inputs["specific_force"]
        self._feedforward = inputs["feedforward"]

    def begin(self) -> None:
        """Reset the estimate: nothing is known yet."""
        for k, value in enumerate(law.initial_memory()):
            self._memory[k] = value

    def offer(
        self,
        time_us: int,
        p: Sequence[float],
        q: Sequence[float],
        now_us: int,
        *,
        flying: bool,
        aloft: bool,
    ) -> bool:
        """Whether the pose waits for a tick now.

        While it is flying not where it strays from the estimate; aloft and in motion not where it repeats
        the last one: a camera system that sees nothing may go on sending what it saw last.
        """
        repeats = self.poses.repeats(p, q)
        if flying and (self._strays(time_us, p, q, now_us) or (repeats and aloft and self._moving())):
            return False
        return self.poses.offer(time_us, p, q, now_us)

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

    def calibrate(self, now_us: int) -> bool:
        """Whether this look completed the gyro's calibration; a bias above EST_BIAS_MAX is not believed."""
        memory, calibration, values = self._memory, self.calibration, self._parameters
        if not calibration.look(
            now_us,
            self._gyro,
            self._force,
            memory[law.GYRO_SUM],
            bias_max=values["EST_BIAS_MAX"],
            still_rate=values["ARM_GYRO_STILL"],
        ):
            return False
        assert calibration.bias is not None
        for k, value in enumerate(calibration.bias):
            memory[law.EST_BIAS.start + k] = value
        return True

    def _moving(self) -> bool:
        return math.hypot(*self._memory[law.EST_V]) > STILL or self._rate() > STILL

    def _rate(self) -> float:
        bias = self._memory[law.EST_BIAS]
        return math.hypot(*(g - b for g, b in zip(self._gyro, bias, strict=True)))

    def _strays(self, time_us: int, p: Sequence[float], q: Sequence[float], now_us: int) -> bool:
        """Whether the pose is far from what the estimate says about its moment, or of no numbers."""
        px, py, pz, vx, vy, vz, qw, qx, qy, qz = self._memory[_KNOWN]
        age_s = 1e-6 * (now_us - time_us) + self._feedforward[PREDICTION_TIME]
        values = self._parameters
        far_m = values["EST_JUMP_M"] + values["EST_JUMP_SPEED"] * 1e-6 * (time_us - self.poses.newest_us)
        x, y, z = p
        near = math.hypot(x - px + vx * age_s, y - py + vy * age_s, z - pz + vz * age_s) <= far_m
        w, x, y, z = q
        along, length = abs(w * qw + x * qx + y * qy + z * qz), math.hypot(w, x, y, z)
        jump = math.radians(values["EST_JUMP_DEG"])
        turn = min(jump + self._rate() * abs(age_s), math.pi)
        return not (near and along >= length * math.cos(0.5 * turn))

    def _set(self, p: Sequence[float], q: Sequence[float]) -> None:
        """Set the estimate to this pose, at rest; the gyro bias stays."""
        for k, value in enumerate((*p, 0.0, 0.0, 0.0, *q)):
            self._memory[k] = value
