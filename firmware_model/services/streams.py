"""Telemetry in standard MAVLink messages, for other ground stations than Trimtab's host.

The vehicle sends no such telemetry while it receives Trimtab's host only. A heartbeat or a rate request of
another station starts it at low rates. It stops, and requested rates are reset, after no such station has
been heard for STATION_US. Each rate has an upper bound, so the sum leaves enough capacity for flight control.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.services import global_position, stock
from trimtab.firmware_model.services.commands import Outcome
from trimtab.firmware_model.services.telemetry import HEARTBEAT_US, STATUS_US
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink

STATION_US = 5_000_000
"""Silence after which other stations count as disconnected."""
_OFF = -1
_ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
_DENIED = mavlink.MAV_RESULT_DENIED
_UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED


@dataclass(frozen=True, kw_only=True)
class Stream:
    """A message with its default interval (-1: not sent) and its shortest interval (us)."""

    default_us: int
    min_us: int
    make: Callable[[Flight, int, float], Message]
    """Returns the message, given the flight, the time (us) and the battery voltage."""


STREAMS: Mapping[int, Stream] = {
    m.SysStatus.id: Stream(default_us=1_000_000, min_us=500_000, make=stock.sys_status),
    m.BatteryStatus.id: Stream(default_us=1_000_000, min_us=500_000, make=stock.battery_status),
    m.ExtendedSysState.id: Stream(default_us=1_000_000, min_us=500_000, make=stock.extended_sys_state),
    m.HomePosition.id: Stream(default_us=_OFF, min_us=500_000, make=stock.home_position),
    m.Attitude.id: Stream(default_us=250_000, min_us=50_000, make=stock.attitude),
    m.AttitudeQuaternion.id: Stream(default_us=250_000, min_us=50_000, make=stock.attitude_quaternion),
    m.LocalPositionNed.id: Stream(default_us=250_000, min_us=50_000, make=stock.local_position),
    m.GlobalPosition.id: Stream(default_us=250_000, min_us=250_000, make=global_position.global_position),
    m.VfrHud.id: Stream(default_us=1_000_000, min_us=500_000, make=global_position.vfr_hud),
    m.Altitude.id: Stream(default_us=1_000_000, min_us=500_000, make=global_position.altitude),
    m.GpsGlobalOrigin.id: Stream(default_us=_OFF, min_us=1_000_000, make=global_position.gps_global_origin),
    m.Odometry.id: Stream(default_us=_OFF, min_us=200_000, make=stock.odometry),
}
"""Streams by message id."""

PERIODIC_INTERVALS_US: Mapping[int, int] = {
    m.FcControl.id: 10_000,
    m.FcEstimate.id: 10_000,
    m.FcObserver.id: 10_000,
    m.FcRotors.id: 10_000,
    m.FcStatus.id: STATUS_US,
    m.Heartbeat.id: HEARTBEAT_US,
}
"""Shortest intervals (us) of the messages to every host, by message id. A station may request longer ones."""
PRIVATE_INTERVAL_MAX_US = 1_000_000
"""Longest interval of the messages in PERIODIC_INTERVALS_US."""
INTERVAL_MAX_US = 1_800_000_000
"""Longest interval of other messages: it fits into MESSAGE_INTERVAL."""

GROUPS: Mapping[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        m.SysStatus.id,
        m.BatteryStatus.id,
        m.ExtendedSysState.id,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (m.LocalPositionNed.id, m.GlobalPosition.id),
    mavlink.MAV_DATA_STREAM_EXTRA1: (m.Attitude.id, m.AttitudeQuaternion.id),
    mavlink.MAV_DATA_STREAM_EXTRA2: (m.VfrHud.id, m.Altitude.id),
}
"""Messages that REQUEST_DATA_STREAM starts, by group. MAV_DATA_STREAM_ALL starts all groups."""


class Streams:
    """Sends standard telemetry while other stations than Trimtab's host are heard.

    Parameters
    ----------
    send
        Sends a message.
    battery_v
        Returns the battery voltage.
    may_act
        Returns whether a station may slow the messages to every host now.

    Attributes
    ----------
    slowed
        Intervals (us) of the messages in PERIODIC_INTERVALS_US that were lengthened, by message id.
    """

    def __init__(
        self,
        *,
        flight: Flight,
        send: Callable[[Message], None],
        battery_v: Callable[[], float],
        may_act: Callable[[tuple[int, int]], bool],
    ) -> None:
        self.slowed: dict[int, int] = {}
        self._flight = flight
        self._send = send
        self._battery_v = battery_v
        self._may_act = may_act
        self._requested: dict[int, int] = {}
        self._due_us: dict[int, int] = {}
        self._private_due_us: dict[int, int] = {}
        self._next_us = NEVER_US
        self._stop_us = 0
        self._home: tuple[float, float, float] | None = None  # as sent last

    def requests(self) -> dict[int, Callable[[int], Message]]:
        """Return functions that make the messages for MAV_CMD_REQUEST_MESSAGE, by message id."""
        return {number: lambda now_us, number=number: self._make(number, now_us) for number in STREAMS}

    def commands(self) -> dict[int, Callable[[m.CommandLong, int], Outcome]]:
        """Return command handlers by command; each returns its outcome, given the message and the time."""
        return {
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._get_home,
        }

    def heartbeat(self, message: m.Heartbeat, now_us: int) -> None:
        """Record the heartbeat of a station other than Trimtab's host."""
        if not m.is_vehicle(message) and not m.is_own_host(message):
            self._station_heard(now_us)

    def data_stream(self, message: m.RequestDataStream, now_us: int) -> None:
        """Start a group of messages at a rate in Hz, or stop the group."""
        everything = message.req_stream_id == mavlink.MAV_DATA_STREAM_ALL
        numbers = sum(GROUPS.values(), ()) if everything else GROUPS.get(message.req_stream_id, ())
        rate = message.req_message_rate if message.start_stop else 0
        for number in numbers:
            self._request(number, 1_000_000 // rate if rate else _OFF)
        self._station_heard(now_us)

    def update(self, now_us: int) -> None:
        """Send the messages that are due, and the home position after a change."""
        home = self._flight.home_ned
        moved, self._home = home is not self._home, home
        if now_us < self._next_us and not moved:
            return
        if now_us >= self._stop_us:
            self._stop()
            return
        if moved:
            self._send(self._make(m.HomePosition.id, now_us))
        self._next_us = self._stop_us
        for number, stream in STREAMS.items():
            interval_us = self._requested.get(number, stream.default_us)
            if interval_us == _OFF:
                continue
            if now_us >= self._due_us.get(number, 0):
                self._due_us[number] = now_us - now_us % interval_us + interval_us
                self._send(self._make(number, now_us))
            self._next_us = min(self._next_us, self._due_us[number])

    def periodic_due(self, number: int, now_us: int) -> bool:
        """Return whether a message that is due by its usual interval is also due by its requested one."""
        interval_us = self.slowed.get(number)
        if interval_us is None:
            return True
        if now_us < self._private_due_us.get(number, 0):
            return False
        self._private_due_us[number] = now_us - now_us % interval_us + interval_us
        return True

    def interval_us(self, number: int) -> int:
        """Return the present interval (us) of a message: -1 if it is not sent, 0 if it is unknown."""
        if number in PERIODIC_INTERVALS_US:
            return self.slowed.get(number, PERIODIC_INTERVALS_US[number])
        stream = STREAMS.get(number)
        if stream is None:
            return 0
        return self._requested.get(number, stream.default_us)

    # Internals.

    def _station_heard(self, now_us: int) -> None:
        self._stop_us = now_us + STATION_US
        self._next_us = 0

    def _stop(self) -> None:
        self._next_us = NEVER_US
        for memory in (self._requested, self._due_us, self.slowed, self._private_due_us):
            memory.clear()

    def _make(self, number: int, now_us: int) -> Message:
        return STREAMS[number].make(self._flight, now_us, self._battery_v())

    def _request(self, number: int, interval_us: int) -> None:
        """Set an interval (us) within its bounds. 0 restores the default, -1 stops the message."""
        self._due_us.pop(number, None)
        if number in PERIODIC_INTERVALS_US:
            if interval_us == 0 or 0 < interval_us <= PERIODIC_INTERVALS_US[number]:
                self.slowed.pop(number, None)
            else:
                longest_us = PRIVATE_INTERVAL_MAX_US
                self.slowed[number] = longest_us if interval_us < 0 else min(interval_us, longest_us)
        elif interval_us == 0:
            self._requested.pop(number, None)
        else:
            bounded_us = min(max(interval_us, STREAMS[number].min_us), INTERVAL_MAX_US)
            self._requested[number] = bounded_us if interval_us > 0 else _OFF

    def _set_interval(self, message: m.CommandLong, now_us: int) -> int:
        number, interval_us = message.param1, message.param2
        if number not in STREAMS and number not in PERIODIC_INTERVALS_US:
            return _UNSUPPORTED
        if not (interval_us == _OFF or 0 <= interval_us < math.inf):  # also rejects NaN
            return _DENIED
        if number in PERIODIC_INTERVALS_US and not self._may_act(m.sender_of(message)):
            return mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        self._request(int(number), round(interval_us))
        self._station_heard(now_us)
        return _ACCEPTED

    def _get_interval(self, message: m.CommandLong, now_us: int) -> Outcome:
        number = message.param1
        if not 0 <= number <= 0xFFFF:
            return _DENIED
        return _ACCEPTED, m.MessageInterval(int(number), self.interval_us(int(number)))

    def _get_home(self, message: m.CommandLong, now_us: int) -> Outcome:
        return _ACCEPTED, self._make(m.HomePosition.id, now_us)
