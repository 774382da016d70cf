"""Monitor of the failsafe conditions and of touchdown: times and counters for the failsafe table."""

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
"""Height (m) above the take-off floor below which a descent ends immediately, unless poses are late. In wind
a vehicle descends tilted, and attitude control would tip it over on the floor within a quarter of a second.
"""
HOP_SPEED = 0.5
"""Speed of a climb (m/s) above which a low height is no touchdown: without thrust the vehicle would hop."""
CLEAR_HEIGHT = 0.15
"""Height (m) above the floor below which the vehicle only climbs vertically, so it does not drag its feet."""
TOUCH_FORCE = 1.0
"""Least excess of the specific force over rotor thrust (m/s^2) that indicates contact with the floor."""
TOUCH_FORCE_MAX = 2.0
"""Greatest excess (m/s^2) that contact may require: near the floor the ground effect increases thrust."""
LEVEL = 0.94
"""Least cosine of the tilt at which thrust and force are compared: beyond it, inflow changes the thrust."""
_SATURATED_SHARE = 0.9  # of the ticks between two updates
_FLIGHT_GAIN = 0.005  # of the thrust ratio in each update: a time constant of 2 s
_DESCENT_GAIN = 0.02  # likewise in a level descent: 0.5 s
TOUCH_US = 200_000
"""Time for which a sign of touchdown must last."""
SURE_TOUCH_US = 1_000_000
"""Time for which the floor's force must last while the vehicle still seems to sink."""

_EVENTS = (
    Event.TILTED,
    Event.IMU_STUCK,
    Event.MOCAP_LOST,
    Event.MOCAP_LATE,
    Event.FENCE_LEFT,
    Event.SATURATED,
    Event.BATTERY_LOW,
    Event.LOOP_OVERRUN,
    Event.LINK_LOST,
    Event.SETPOINTS_LOST,
)
_TIMED = tuple(row for row in CONDITIONS if row.timeout is not None)
assert tuple(row.event for row in _TIMED) == _EVENTS, "the times are given in this order"

Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""(low, high) of north, east and down, m."""


def fence(parameters: Mapping[str, float], margin_m: float = 0.0) -> Box:
    """Return the flight volume, enlarged by a margin on every side."""
    n, e, d = (
        (parameters[f"FENCE_{axis}_MIN"] - margin_m, parameters[f"FENCE_{axis}_MAX"] + margin_m)
        for axis in "NED"
    )
    return n, e, d


def within(p: Sequence[float], box: Box) -> bool:
    """Return whether a position lies in the box."""
    (south, north), (west, east), (top, bottom) = box
    return south <= p[0] <= north and west <= p[1] <= east and top <= p[2] <= bottom


class Observation(NamedTuple):
    """State of the vehicle at one update, from which the conditions are evaluated.

    Parameters
    ----------
    cos_tilt
        Cosine of the estimated tilt.
    age_us
        Age of the newest pose used; None before the first.
    p
        Estimated position, NED.
    battery_v
        Measured voltage; a value that is not finite counts as missing.
    imu
        Samples of gyro and accelerometer.
    flight_ticks, saturated_ticks
        Numbers of ticks since power-up.
    """

    cos_tilt: float
    age_us: int | None
    p: tuple[float, float, float]
    battery_v: float
    imu: tuple[float, ...]
    flight_ticks: int
    saturated_ticks: int


class ConditionMonitor:
    """Evaluates which conditions of the failsafe table have lasted for their times, by timestamps.

    `pose_us`, `host_us`, `setpoint_us`: times of the last pose used, ground station message and setpoint.
    `has_key`: whether the vehicle holds a key of message signing.
    """

    def __init__(self, parameters: ParameterValues) -> None:
        self.pose_us = 0
        self.host_us = 0
        self.setpoint_us = NEVER_US  # while no setpoints are followed
        self.has_key = False
        self.volts: float | None = None  # smoothed
        self.thrust_ratio = 1.0  # actual over nominal thrust, estimated in flight
        # Times of the last update at which:
        self._level_us = 0  # tilt was within its bound
        self._no_touch_us = 0  # there was no sign of touchdown
        self._recent_us = 0  # the newest pose was within its age bound
        self._inside_us = 0  # the position was within the fence
        self._unsaturated_us = 0  # the motors were not saturated
        self._charged_us = 0  # the battery was above its bound
        self._imu_us = 0  # the IMU sample changed
        self._imu: tuple[float, ...] = ()
        self._update_us = 0
        self._flight_ticks = self._saturated_ticks = 0
        self._late_ticks_us: deque[int] = deque()
        self.configure(parameters)

    def configure(self, parameters: ParameterValues) -> None:
        """Read times and bounds from the parameters."""
        self._timeouts_us = [parameters.us(str(row.timeout)) if row.lasting else 0 for row in _TIMED]
        if parameters["FS_IMU_S"] == 0.0:
            self._timeouts_us[_EVENTS.index(Event.IMU_STUCK)] = NEVER_US
        self._cos_tilt = math.cos(math.radians(parameters["FS_TILT_DEG"]))
        self.pose_lost_us = parameters.us("FS_MOCAP_S")
        self._age_us = parameters.us("FS_AGE_S")
        self._land_height, self._stop_speed = parameters["LAND_HEIGHT"], parameters["LAND_STOP_SPEED"]
        share, empty, full = (parameters[name] for name in ("FS_BAT_SHARE", "BAT_EMPTY_V", "BAT_FULL_V"))
        self._low_v = empty + share * (full - empty) if share > 0.0 else -math.inf
        self._smooth_us = parameters.us("FS_BAT_S")
        self._fence = fence(parameters, parameters["FS_FENCE_M"])
        self._late_window_us = parameters.us("FS_LOOP_S")
        self._late_ticks_us = deque(self._late_ticks_us, maxlen=round(parameters["FS_LOOP_MAX"]))

    def start(self, now_us: int) -> None:
        """Restart the times of tilt and touchdown at the start of a phase."""
        self._level_us = self._no_touch_us = now_us

    def record_late_tick(self, now_us: int) -> None:
        """Record a late tick."""
        self._late_ticks_us.append(now_us)

    def observe(self, now_us: int, observation: Observation) -> None:
        """Record the present state of the vehicle."""
        if observation.cos_tilt >= self._cos_tilt:
            self._level_us = now_us
        if observation.age_us is None or observation.age_us <= self._age_us:
            self._recent_us = now_us
        if within(observation.p, self._fence):
            self._inside_us = now_us
        ticks = observation.flight_ticks - self._flight_ticks
        saturated = observation.saturated_ticks - self._saturated_ticks
        self._flight_ticks, self._saturated_ticks = observation.flight_ticks, observation.saturated_ticks
        if saturated < _SATURATED_SHARE * ticks or not ticks:
            self._unsaturated_us = now_us
        if observation.imu != self._imu:
            self._imu, self._imu_us = observation.imu, now_us
        elapsed_us = now_us - self._update_us
        self._update_us = now_us
        battery_v = observation.battery_v
        if math.isfinite(battery_v):  # a NaN would persist in the smoothed voltage
            if self.volts is None:
                self.volts = battery_v
            self.volts += (battery_v - self.volts) * elapsed_us / (self._smooth_us + elapsed_us)
        if self.volts is None or self.volts >= self._low_v:
            self._charged_us = now_us

    def active_conditions(self) -> list[Condition]:
        """Return the conditions active at the last update, in the order of the table."""
        late, now_us = self._late_ticks_us, self._update_us
        overrun = len(late) == late.maxlen and now_us - late[0] <= self._late_window_us
        since_us = (  # in the order of _EVENTS
            self._level_us,
            self._imu_us,
            self.pose_us,
            self._recent_us,
            self._inside_us,
            self._unsaturated_us,
            self._charged_us,
            late[0] if overrun else now_us,
            self.host_us,
            self.setpoint_us,
        )
        lasting = zip(_TIMED, since_us, self._timeouts_us, strict=True)
        return [row for row, start_us, timeout_us in lasting if now_us - start_us > timeout_us]

    def update_touchdown(
        self, now_us: int, *, height: float, v: Sequence[float], reference_below: bool, carried: bool
    ) -> bool:
        """Update the detection of touchdown by height (m) and v (m/s, NED); return whether it has happened.

        reference_below: whether the reference is more than 5 cm below the vehicle. carried: whether the force
        exceeds the thrust. A vehicle that turns from a climb to a descent is slow as well, but not carried.
        While poses are late, height alone is no sign: it may be wrong by decimetres.
        """
        slow = math.hypot(*v) < self._stop_speed
        stopped = reference_below and carried and height < self._land_height and slow
        low = height < FLOOR_HEIGHT and self._recent_us == self._update_us and v[2] > -HOP_SPEED
        return self._touch_lasted(now_us, stopped) or low

    def update_thrust_ratio(self, *, force: float, thrust: float, share: float = _FLIGHT_GAIN) -> None:
        """Update the thrust ratio from force and thrust over mass (m/s^2, up) in level flight.

        thrust: commanded thrust after the nominal rotor lag. share: gain of the update.
        """
        ratio = min(max(force / max(thrust, 1.0), 0.5), 2.0)
        self.thrust_ratio += share * (ratio - self.thrust_ratio)

    def excess(self, force: float, thrust: float) -> float:
        """Return how far force exceeds thrust over mass (m/s^2, up), by the thrust ratio."""
        return force - self.thrust_ratio * thrust

    def update_support(
        self,
        now_us: int,
        *,
        force: float,
        thrust: float,
        expected_excess: float,
        learn: bool,
        near: bool,
        stopped: bool,
    ) -> bool:
        """Update with force and thrust over mass (m/s^2, up); return whether the floor carries the vehicle.

        expected_excess: how far force exceeds thrust (m/s^2) once the floor carries the vehicle. learn:
        whether a slow change of the excess updates the thrust ratio. Such changes come from an air flow that
        varies with height, a tether that slackens, or ground effect. near: whether the floor can be this
        high. stopped: whether the dead-reckoned descent has stopped; without that, the force must last
        longer.
        """
        bound = min(max(0.5 * expected_excess, TOUCH_FORCE), TOUCH_FORCE_MAX)
        touching = near and self.excess(force, thrust) > bound
        if learn and not touching:
            self.update_thrust_ratio(force=force, thrust=thrust, share=_DESCENT_GAIN)
        return self._touch_lasted(now_us, touching, TOUCH_US if stopped else SURE_TOUCH_US)

    def _touch_lasted(self, now_us: int, touching: bool, least_us: int = TOUCH_US) -> bool:
        if not touching:
            self._no_touch_us = now_us
        return now_us - self._no_touch_us >= least_us
