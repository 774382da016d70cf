"""Notices trouble and touchdown: deadlines and counters behind the failsafe table."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.failsafe import CONDITIONS, Condition
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.supervisor import Event

FLOOR_HEIGHT = 0.03
"""m above the floor it took off from below which a descent is over at once. Against wind a vehicle comes down
leaning: what levels and holds it in the air tips it over on the floor, in a quarter of a second.
"""
TOUCH_FORCE = 1.0
"""m/s^2 by which specific force must exceed what the rotors give, at least, where something else carries the
vehicle.
"""
TOUCH_FORCE_MOST = 2.0
"""m/s^2 by which it need not exceed that, however much the floor gives: near it air cushions rotors."""
LEVEL = 0.94
"""Cosine of the tilt up to which thrust is compared with force: beyond, air flows through the rotors."""
_NEARLY_EVERY = 0.9  # of the ticks between two looks
_ALOFT_SHARE = 0.005  # of each look's thrust ratio: a memory of 2 s
_DESCENT_SHARE = 0.02  # likewise: 0.5 s
TOUCH_US = 200_000
"""Time a sign of touchdown must last."""


Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""(low, high) of north, east and down, m."""


def fence(parameters: Mapping[str, float], margin_m: float = 0.0) -> Box:
    """Return the flight volume, larger by a margin on every side."""
    n, e, d = (
        (parameters[f"FENCE_{axis}_MIN"] - margin_m, parameters[f"FENCE_{axis}_MAX"] + margin_m)
        for axis in "NED"
    )
    return n, e, d


def within(p: Sequence[float], box: Box) -> bool:
    """Whether the position lies in the box."""
    return all(low <= x <= high for x, (low, high) in zip(p, box, strict=True))


class Seen(NamedTuple):
    """What conditions are judged by, at one look.

    cos_tilt: of the estimate. age_us: of the newest pose used, None before the first. p: estimated position
    (NED). battery_v: as measured; what is not finite counts as not measured. imu: gyro and specific force as
    read. flight_ticks, saturated_ticks: counts.
    """

    cos_tilt: float
    age_us: int | None
    p: tuple[float, float, float]
    battery_v: float
    imu: tuple[float, ...]
    flight_ticks: int
    saturated_ticks: int


class Watch:
    """Which conditions of the table have lasted for their times. Times are compared, not counted.

    `pose_us`, `host_us`, `setpoint_us`: when a pose was last used, the host heard, a setpoint heard.
    """

    def __init__(self, parameters: ParameterValues) -> None:
        self.pose_us = 0
        self.host_us = 0
        self.setpoint_us = NEVER_US  # where none are followed, none are lost
        self.volts: float | None = None  # smoothed
        self.thrust_ratio = 1.0  # real over nominal thrust, as seen in the air
        self._level_us = 0  # when tilt was last within bounds
        self._aloft_us = 0  # when there was last no sign of touchdown
        self._fresh_us = 0  # when the newest pose was last fresh
        self._inside_us = 0
        self._free_us = 0  # when the motors last were not saturated
        self._charged_us = 0
        self._imu: tuple[float, ...] = ()
        self._imu_us = 0  # when its sample last changed
        self._look_us = 0
        self._ticks = (0, 0)
        self._late: deque[int] = deque()
        self.configure(parameters)

    def configure(self, parameters: ParameterValues) -> None:
        """Read times and bounds from the parameters."""
        self._timeouts = tuple(
            (row, parameters.us(row.timeout) if row.lasting else 0)
            for row in CONDITIONS
            if row.timeout is not None
            and not (row.event is Event.IMU_STUCK and parameters["FS_IMU_S"] == 0.0)
        )
        self._cos_tilt = math.cos(math.radians(parameters["FS_TILT_DEG"]))
        self.pose_lost_us = parameters.us("FS_MOCAP_S")
        self._age_us = parameters.us("FS_AGE_S")
        self._land_height, self._stop_speed = parameters["LAND_HEIGHT"], parameters["LAND_STOP_SPEED"]
        share, empty, full = (parameters[name] for name in ("FS_BAT_SHARE", "BAT_EMPTY_V", "BAT_FULL_V"))
        self._low_v = empty + share * (full - empty) if share > 0.0 else -math.inf
        self._smooth_us = parameters.us("FS_BAT_S")
        self._fence = fence(parameters, parameters["FS_FENCE_M"])
        self._late_us = parameters.us("FS_LOOP_S")
        self._late = deque(self._late, maxlen=round(parameters["FS_LOOP_MAX"]))

    def start(self, now_us: int) -> None:
        """Start all counters now."""
        self._level_us = self._aloft_us = now_us

    def late(self, now_us: int) -> None:
        """Record that the tick at `now_us` came late."""
        self._late.append(now_us)

    def see(self, now_us: int, seen: Seen) -> None:
        """Record the present state of the vehicle."""
        if seen.cos_tilt >= self._cos_tilt:
            self._level_us = now_us
        if seen.age_us is None or seen.age_us <= self._age_us:
            self._fresh_us = now_us
        if within(seen.p, self._fence):
            self._inside_us = now_us
        ticks, saturated = (
            b - a for a, b in zip(self._ticks, (seen.flight_ticks, seen.saturated_ticks), strict=True)
        )
        self._ticks = (seen.flight_ticks, seen.saturated_ticks)
        if saturated < _NEARLY_EVERY * ticks or not ticks:
            self._free_us = now_us
        if seen.imu != self._imu:
            self._imu, self._imu_us = seen.imu, now_us
        passed_us = now_us - self._look_us
        self._look_us = now_us
        if math.isfinite(seen.battery_v):  # one sample that is no number would stay for good
            if self.volts is None:
                self.volts = seen.battery_v
            self.volts += (seen.battery_v - self.volts) * passed_us / (self._smooth_us + passed_us)
        if self.volts is None or self.volts >= self._low_v:
            self._charged_us = now_us

    def holding(self) -> list[Condition]:
        """Return the conditions that held at the last look, by the table's order."""
        late, now_us = self._late, self._look_us
        overrun = len(late) == late.maxlen and now_us - late[0] <= self._late_us
        since = {
            Event.TILTED: self._level_us,
            Event.IMU_STUCK: self._imu_us,
            Event.MOCAP_LOST: self.pose_us,
            Event.MOCAP_LATE: self._fresh_us,
            Event.FENCE_LEFT: self._inside_us,
            Event.SATURATED: self._free_us,
            Event.BATTERY_LOW: self._charged_us,
            Event.LOOP_OVERRUN: late[0] if overrun else now_us,
            Event.LINK_LOST: self.host_us,
            Event.SETPOINTS_LOST: self.setpoint_us,
        }
        return [row for row, timeout_us in self._timeouts if now_us - since[row.event] > timeout_us]

    def landed(self, now_us: int, *, height: float, speed: float, descending: bool) -> bool:
        """Whether a vehicle that knows its height (m) and speed (m/s) has come down."""
        stopped = self._lasting(
            now_us, descending and height < self._land_height and speed < self._stop_speed
        )
        return stopped or height < FLOOR_HEIGHT

    def aloft(self, *, force: float, thrust: float, share: float = _ALOFT_SHARE) -> None:
        """Record force and thrust over mass (m/s^2, up) of level flight.

        thrust: what the rotors give by their nominal lag; what is commanded is ahead of the force.
        """
        ratio = min(max(force / max(thrust, 1.0), 0.5), 2.0)
        self.thrust_ratio += share * (ratio - self.thrust_ratio)

    def carried(self, now_us: int, *, force: float, thrust: float, floor: float, learn: bool) -> bool:
        """Whether something carries the vehicle: more force over mass than thrust gave aloft (m/s^2, up).

        floor: the excess that a floor would make. learn: whether what comes on slowly is no floor but what
        thrust is worth there: air at other heights, a line that slackens, the cushion over the floor.
        """
        bound = min(max(0.5 * floor, TOUCH_FORCE), TOUCH_FORCE_MOST)
        sign = force - self.thrust_ratio * thrust > bound
        if learn and not sign:
            self.aloft(force=force, thrust=thrust, share=_DESCENT_SHARE)
        return self._lasting(now_us, sign)

    def _lasting(self, now_us: int, sign: bool) -> bool:
        if not sign:
            self._aloft_us = now_us
        return now_us - self._aloft_us >= TOUCH_US
