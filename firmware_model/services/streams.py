"""Telemetry in MAVLink's own messages, for ground stations that know nothing of Trimtab.

None of it is on the air while Trimtab's host alone speaks. A heartbeat of another station, or its request for
a rate, starts it at modest rates; it ends, and rates asked for are forgotten, once no such station has been
heard for a while. Rates have a ceiling each, so that all together leave room for what flies the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.services import stock
from trimtab.firmware_model.services.telemetry import HEARTBEAT_US, STATUS_US
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink

STATION_US = 5_000_000
"""Silence after which other stations count as gone."""
_OFF = -1
_ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
_DENIED = mavlink.MAV_RESULT_DENIED
_UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED


@dataclass(frozen=True, kw_only=True)
class Stream:
    """One message: its interval by default, -1 for none, and the least one that can be asked for (us)."""

    default_us: int
    least_us: int
    make: Callable[[Flight, int, float], Message]
    """From the flight, the time (us) and the battery's voltage."""


STREAMS: Mapping[int, Stream] = {
    m.SysStatus.id: Stream(default_us=1_000_000, least_us=500_000, make=stock.sys_status),
    m.BatteryStatus.id: Stream(default_us=1_000_000, least_us=500_000, make=stock.battery_status),
    m.ExtendedSysState.id: Stream(default_us=1_000_000, least_us=500_000, make=stock.extended_sys_state),
    m.HomePosition.id: Stream(default_us=_OFF, least_us=500_000, make=stock.home_position),
    m.Attitude.id: Stream(default_us=250_000, least_us=50_000, make=stock.attitude),
    m.AttitudeQuaternion.id: Stream(default_us=250_000, least_us=50_000, make=stock.attitude_quaternion),
    m.LocalPositionNed.id: Stream(default_us=250_000, least_us=50_000, make=stock.local_position),
    m.Odometry.id: Stream(default_us=_OFF, least_us=200_000, make=stock.odometry),
}
"""By message id."""

OWN: Mapping[int, int] = {
    m.FcControl.id: 10_000,
    m.FcEstimate.id: 10_000,
    m.FcObserver.id: 10_000,
    m.FcStatus.id: STATUS_US,
    m.Heartbeat.id: HEARTBEAT_US,
}
"""Intervals of what is sent to every host (us). They can be made longer, not shorter and not endless."""
OWN_MOST_US = 1_000_000
ASKED_MOST_US = 1_800_000_000
"""Longest interval of other messages: MESSAGE_INTERVAL has room for it."""

GROUPS: Mapping[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        m.SysStatus.id,
        m.BatteryStatus.id,
        m.ExtendedSysState.id,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (m.LocalPositionNed.id,),
    mavlink.MAV_DATA_STREAM_EXTRA1: (m.Attitude.id, m.AttitudeQuaternion.id),
}
"""What REQUEST_DATA_STREAM sets, by group; the group of all sets them all."""


class Streams:
    """Sends stock telemetry while other stations than Trimtab's host are heard.

    Parameters
    ----------
    send
        puts a message on the line. battery_v: its present voltage.

    `slowed` are the intervals (us) of own messages that were made longer, by message id.
    """

    def __init__(
        self, *, flight: Flight, send: Callable[[Message], None], battery_v: Callable[[], float]
    ) -> None:
        self.slowed: dict[int, int] = {}
        self._flight = flight
        self._send = send
        self._battery_v = battery_v
        self._asked: dict[int, int] = {}
        self._due_us: dict[int, int] = {}
        self._own_due_us: dict[int, int] = {}
        self._next_us = NEVER_US
        self._gone_us = 0
        self._home: tuple[float, float, float] | None = None  # as it was told last

    def requests(self) -> dict[int, Callable[[int], Message]]:
        """Return what MAV_CMD_REQUEST_MESSAGE may ask for here, by message id."""
        return {number: lambda now_us, number=number: self._make(number, now_us) for number in STREAMS}

    def commands(self) -> dict[int, Callable[[m.CommandLong, int], int]]:
        """Return the commands that are answered here: MAV_RESULT from a command and the time."""
        return {
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._get_home,
        }

    def heartbeat(self, message: m.Heartbeat, now_us: int) -> None:
        """Note the heartbeat of a station other than Trimtab's host."""
        if not m.is_vehicle(message) and not m.is_own_host(message):
            self._heard(now_us)

    def data_stream(self, message: m.RequestDataStream, now_us: int) -> None:
        """Start a group of messages at a rate in Hz, or stop it."""
        everything = message.req_stream_id == mavlink.MAV_DATA_STREAM_ALL
        numbers = sum(GROUPS.values(), ()) if everything else GROUPS.get(message.req_stream_id, ())
        rate = message.req_message_rate if message.start_stop else 0
        for number in numbers:
            self._ask(number, 1_000_000 // rate if rate else _OFF)
        self._heard(now_us)

    def look(self, now_us: int) -> None:
        """Send what is due, and the home position after it moved."""
        home = self._flight.home_ned
        moved, self._home = home is not self._home, home
        if now_us < self._next_us and not moved:
            return
        if now_us >= self._gone_us:
            self._stop()
            return
        if moved:
            self._send(self._make(m.HomePosition.id, now_us))
        self._next_us = self._gone_us
        for number, stream in STREAMS.items():
            interval_us = self._asked.get(number, stream.default_us)
            if interval_us == _OFF:
                continue
            if now_us >= self._due_us.get(number, 0):
                self._due_us[number] = now_us - now_us % interval_us + interval_us
                self._send(self._make(number, now_us))
            self._next_us = min(self._next_us, self._due_us[number])

    def own_due(self, number: int, now_us: int) -> bool:
        """Whether one of the own messages is to be sent at this look, were it due by its usual rate."""
        interval_us = self.slowed.get(number)
        if interval_us is None:
            return True
        if now_us < self._own_due_us.get(number, 0):
            return False
        self._own_due_us[number] = now_us - now_us % interval_us + interval_us
        return True

    def interval_us(self, number: int) -> int:
        """Present interval of a message, -1 where it is not sent, 0 where it is not known here."""
        if number in OWN:
            return self.slowed.get(number, OWN[number])
        stream = STREAMS.get(number)
        if stream is None:
            return 0
        return self._asked.get(number, stream.default_us)

    # Inside.

    def _heard(self, now_us: int) -> None:
        self._gone_us = now_us + STATION_US
        self._next_us = 0

    def _stop(self) -> None:
        self._next_us = NEVER_US
        for memory in (self._asked, self._due_us, self.slowed, self._own_due_us):
            memory.clear()

    def _make(self, number: int, now_us: int) -> Message:
        return STREAMS[number].make(self._flight, now_us, self._battery_v())

    def _ask(self, number: int, interval_us: int) -> None:
        """Set the interval (us) as far as it may be chosen; 0 for the default, -1 for none."""
        self._due_us.pop(number, None)
        if number in OWN:
            if interval_us == 0 or 0 < interval_us <= OWN[number]:
                self.slowed.pop(number, None)
            else:
                self.slowed[number] = OWN_MOST_US if interval_us < 0 else min(interval_us, OWN_MOST_US)
        elif interval_us == 0:
            self._asked.pop(number, None)
        else:
            bounded_us = min(max(interval_us, STREAMS[number].least_us), ASKED_MOST_US)
            self._asked[number] = bounded_us if interval_us > 0 else _OFF

    def _set_interval(self, message: m.CommandLong, now_us: int) -> int:
        number, interval_us = message.param1, message.param2
        if number not in STREAMS and number not in OWN:
            return _UNSUPPORTED
        if not (interval_us == _OFF or 0 <= interval_us < math.inf):  # no number fits neither
            return _DENIED
        self._ask(int(number), round(interval_us))
        self._heard(now_us)
        return _ACCEPTED

    def _get_interval(self, message: m.CommandLong, now_us: int) -> int:
        number = message.param1
        if not 0 <= number <= 0xFFFF:
            return _DENIED
        self._send(m.MessageInterval(int(number), self.interval_us(int(number))))
        return _ACCEPTED

    def _get_home(self, message: m.CommandLong, now_us: int) -> int:
        self._send(self._make(m.HomePosition.id, now_us))
        return _ACCEPTED
