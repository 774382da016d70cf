"""MAVSDK as a test watches it: its plugins for one vehicle, and a condition that its subscriptions wake."""

# pyright: reportMissingImports=false
# MAVSDK is of the extra `clients`.

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class Watched:
    """MAVSDK's plugins for one vehicle, and waiting for what its subscriptions tell.

    Attributes:
        place: north, east, down of the last position. positions: how many have come. armed, landed_state,
        health, mode: the last told. modes: all flight modes told.
    """

    def __init__(self, system: Any) -> None:
        from mavsdk.plugins.action import Action
        from mavsdk.plugins.info import Info
        from mavsdk.plugins.offboard import Offboard
        from mavsdk.plugins.param import Param
        from mavsdk.plugins.telemetry import Telemetry

        self.system = system
        self.action, self.info, self.param = Action(system), Info(system), Param(system)
        self.offboard, self.telemetry = Offboard(system), Telemetry(system)
        self.place = (0.0, 0.0, 0.0)
        self.speed = (0.0, 0.0, 0.0)
        self.yaw_deg = 0.0
        self.positions = 0
        self.armed = False
        self.mode: Any = None
        self.modes: set[Any] = set()
        self.landed_state: Any = None
        self.health: Any = None
        self.battery_v = 0.0
        self.texts: list[str] = []
        self._changed = threading.Condition()
        watch = self.telemetry
        watch.subscribe_position_velocity_ned(self._take(self._move))
        watch.subscribe_attitude_euler(self._take(lambda now: self._set("yaw_deg", now.yaw_deg)))
        watch.subscribe_armed(self._take(lambda now: self._set("armed", now)))
        watch.subscribe_landed_state(self._take(lambda now: self._set("landed_state", now)))
        watch.subscribe_flight_mode(self._take(self._fly_mode))
        watch.subscribe_health(self._take(lambda now: self._set("health", now)))
        watch.subscribe_battery(self._take(lambda now: self._set("battery_v", now.voltage_v)))
        watch.subscribe_status_text(self._take(lambda now: self.texts.append(now.text)))

    def _take(self, act: Callable[[Any], None]) -> Callable[[Any, Any], None]:
        def on_data(data: Any, _: Any) -> None:
            with self._changed:
                act(data)
                self._changed.notify_all()

        return on_data

    def _set(self, name: str, value: Any) -> None:
        setattr(self, name, value)

    def _fly_mode(self, now: Any) -> None:
        self.mode = now
        self.modes.add(now)

    def _move(self, now: Any) -> None:
        self.positions += 1
        self.place = (now.position.north_m, now.position.east_m, now.position.down_m)
        self.speed = (now.velocity.north_m_s, now.velocity.east_m_s, now.velocity.down_m_s)

    def until(self, condition: Callable[[], bool]) -> None:
        """Waits until the condition holds; it is looked at when something is told."""
        with self._changed:
            self._changed.wait_for(condition)

    def take_off(self, height_m: float) -> None:
        """Armed as soon as it may be, then in the air at that height."""
        from mavsdk.plugins.telemetry import LandedState

        self.until(lambda: self.health is not None and self.health.is_armable)
        self.telemetry.set_rate_position_velocity_ned(20.0)
        self.action.arm()
        self.action.set_takeoff_altitude(height_m)
        self.action.takeoff()
        self.until(lambda: self.landed_state == LandedState.IN_AIR)
        assert abs(self.place[2] + height_m) < 0.15

    def land(self) -> None:
        """Back on the floor and disarmed."""
        self.action.land()
        self.until(lambda: not self.armed)
