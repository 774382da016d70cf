"""Inputs of the estimator: initialization, poses and gyro calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.poses import AGE_MAX_US, ClashDetector, PoseInput
from trimtab.firmware_model.flight.readiness import GyroCalibration
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.feedforward import PREDICTION_TIME

STILL = 1e-3
"""Speed (m/s) and body rate (rad/s) below which two identical poses in succession are plausible."""
CLASH_M = 0.05
"""Distance from the estimate above which a rejected pose may come from another source."""
_POSITION_AND_VELOCITY = slice(law.EST_P.start, law.EST_V.stop)


class Estimate:
    """Sets the estimate in the engine's block `memory` and passes poses to the estimator.

    `poses`: poses that wait for a tick. `calibration`: calibration of the gyro. `clash`: whether poses of two
    sources have arrived in this flight. `in_a_row`: number of poses used since one set the estimate, or was
    far from it.
    """

    def __init__(self, inputs: Mapping[str, memoryview[float]], parameters: ParameterValues) -> None:
        self._parameters = parameters
        self.poses = PoseInput(inputs)
        self.calibration = GyroCalibration()
        self.clash = ClashDetector()
        self.in_a_row = 0
        self._memory = inputs["memory"]
        self._gyro, self._force = inputs["gyro"], inputs["specific_force"]
        self._feedforward = inputs["feedforward"]

    def reset(self) -> None:
        """Reset the estimate to the origin at rest."""
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
        armed: bool,
    ) -> bool:
        """Queue a pose for the next tick; return False if it is rejected.

        While armed, a pose far from the estimate is rejected. In flight and in motion, a repetition of the
        previous pose is rejected: a camera system that has lost the vehicle may repeat its last pose. That
        holds in a take-off too, in which the repeated pose itself keeps the estimate on the floor. Once
        poses of two sources were detected, every pose is rejected: nobody knows which source is right.
        """
        repeats = self.poses.repeats(p, q)
        far = self._is_outlier(time_us, p, q, now_us)
        if not armed:
            if far:
                self.in_a_row = 0
            return self.poses.offer(time_us, p, q, now_us)
        frozen = flying and repeats and self._moving()
        accepted = not (frozen or self.clash.found or far) and self.poses.offer(time_us, p, q, now_us)
        # A rejected pose near the estimate contradicts nothing: it was repeated, or forwarded twice. Neither
        # does one that is too old: the vehicle has moved on.
        current = now_us - time_us <= AGE_MAX_US
        if accepted or (current and not self._distance(time_us, p, now_us) <= CLASH_M):
            self.clash.update(accepted, now_us, round(self._parameters["EST_CLASH"]))
        return accepted

    def take_pose(self, now_us: int, restart_us: int | None) -> bool:
        """Put the oldest waiting pose into the engine's inputs; return False if it set the estimate instead.

        The first pose sets the estimate. So does a pose that follows the previous one after more than
        `restart_us` (None: never).
        """
        pose, before_us = self.poses.take()
        if before_us is None or (restart_us is not None and pose[0] - before_us > restart_us):
            self._set(pose[1], pose[2])
            self.in_a_row = 1
            return False
        self.in_a_row += 1
        self.poses.show(pose, before_us, now_us)
        return True

    def calibrate(self, now_us: int) -> bool:
        """Continue the gyro calibration; return whether it is complete. Rejects a bias above EST_BIAS_MAX."""
        memory, calibration, values = self._memory, self.calibration, self._parameters
        if not calibration.update(
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
        (x, y, z), (bias_x, bias_y, bias_z) = self._gyro, self._memory[law.EST_BIAS]
        return math.hypot(x - bias_x, y - bias_y, z - bias_z)

    def _distance(self, time_us: int, p: Sequence[float], now_us: int) -> float:
        """Return the distance (m) of a pose from the estimate at its time; NaN if it is not finite."""
        px, py, pz, vx, vy, vz = self._memory[_POSITION_AND_VELOCITY]
        age_s = 1e-6 * (now_us - time_us) + self._feedforward[PREDICTION_TIME]
        x, y, z = p
        return math.hypot(x - px + vx * age_s, y - py + vy * age_s, z - pz + vz * age_s)

    def _is_outlier(self, time_us: int, p: Sequence[float], q: Sequence[float], now_us: int) -> bool:
        """Return whether the pose is not finite or far from the estimate at its time."""
        qw, qx, qy, qz = self._memory[law.EST_Q]
        age_s = 1e-6 * (now_us - time_us) + self._feedforward[PREDICTION_TIME]
        values = self._parameters
        jump_m = values["EST_JUMP_M"] + values["EST_JUMP_SPEED"] * 1e-6 * (time_us - self.poses.newest_us)
        near = self._distance(time_us, p, now_us) <= jump_m
        w, x, y, z = q
        along, length = abs(w * qw + x * qx + y * qy + z * qz), math.hypot(w, x, y, z)
        jump = math.radians(values["EST_JUMP_DEG"])
        turn = min(jump + self._rate() * abs(age_s), math.pi)
        return not (near and along >= length * math.cos(0.5 * turn))

    def _set(self, p: Sequence[float], q: Sequence[float]) -> None:
        """Set the estimate to this pose at rest; the gyro bias is unchanged."""
        for k, value in enumerate((*p, 0.0, 0.0, 0.0, *q)):
            self._memory[k] = value
