"""Notices trouble and touchdown: deadlines and counters behind the failsafe table."""

from __future__ import annotations

import math

from firmware_model.failsafe import CONDITIONS, Condition
from firmware_model.parameters import ParameterValues
from firmware_model.supervisor import Event
from firmware_model.uart import NEVER_US

TOUCH_HEIGHT = 0.25
"""m above the floor below which a descent may have ended."""
FLOOR_HEIGHT = 0.03
"""m above the floor it took off from below which a descent is over at once. Against wind a vehicle comes down
leaning: what levels and holds it in the air tips it over on the floor, in a quarter of a second.
"""
TOUCH_SPEED = 0.15
"""m/s below which a descending vehicle has been stopped by something."""
TOUCH_FORCE = 1.0
"""m/s^2 by which specific force exceeds what the rotors give where something else carries the vehicle."""
_RATIO_SHARE = 0.02  # of each look's thrust ratio
TOUCH_US = 200_000
"""Time a sign of touchdown must last."""


class Watch:
    """Which conditions of the table have lasted for their timeouts. Times are compared, not counted."""

    def __init__(self, parameters: ParameterValues) -> None:
        self.pose_us = 0
        self.host_us = 0
        self.setpoint_us = NEVER_US  # where none are followed, none are lost
        self._level_us = 0  # when tilt was last within bounds
        self._aloft_us = 0  # when there was last no sign of touchdown
        self.thrust_ratio = 1.0  # real over commanded thrust, as last seen in normal flight
        self.configure(parameters)

    def configure(self, parameters: ParameterValues) -> None:
        """Nothing comes back; timeouts and bounds are read anew."""
        self._timeouts = tuple(
            (row, parameters.us(row.timeout)) for row in CONDITIONS if row.timeout is not None
        )
        self._cos_tilt = math.cos(math.radians(parameters["FS_TILT_DEG"]))
        self.pose_lost_us = parameters.us("FS_MOCAP_S")

    def start(self, now_us: int) -> None:
        """Nothing comes back; whatever comes from now on counts from now."""
        self._level_us = self._aloft_us = now_us

    def struck(self, now_us: int, cos_tilt: float) -> list[Condition]:
        """The conditions that hold, by the table's order."""
        if cos_tilt >= self._cos_tilt:
            self._level_us = now_us
        since = {
            Event.TILTED: self._level_us,
            Event.MOCAP_LOST: self.pose_us,
            Event.LINK_LOST: self.host_us,
            Event.SETPOINTS_LOST: self.setpoint_us,
        }
        return [row for row, timeout_us in self._timeouts if now_us - since[row.event] > timeout_us]

    def landed(self, now_us: int, *, height: float, speed: float, descending: bool) -> bool:
        """Whether a vehicle that knows its height (m) and speed (m/s) has come down."""
        stopped = self._lasting(now_us, descending and height < TOUCH_HEIGHT and speed < TOUCH_SPEED)
        return stopped or height < FLOOR_HEIGHT

    def aloft(self, *, force: float, thrust: float) -> None:
        """Nothing comes back; in normal flight this force went with this thrust, over mass (m/s^2, up)."""
        ratio = min(max(force / max(thrust, 1.0), 0.5), 2.0)
        self.thrust_ratio += _RATIO_SHARE * (ratio - self.thrust_ratio)

    def carried(self, now_us: int, *, force: float, thrust: float) -> bool:
        """Whether something carries the vehicle: more force over mass than thrust gave aloft (m/s^2, up)."""
        return self._lasting(now_us, force - self.thrust_ratio * thrust > TOUCH_FORCE)

    def _lasting(self, now_us: int, sign: bool) -> bool:
        if not sign:
            self._aloft_us = now_us
        return now_us - self._aloft_us >= TOUCH_US
