"""The host's end of the link, without I/O: bytes in, messages out; heartbeats and clock comparison by itself.

Everything that asks and waits for an answer is a Task (host.link.tasks); one is under way at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from host.link.clock import ClockSync
from protocol import messages as m
from protocol.codec import Codec
from protocol.messages import Message

HEARTBEAT_US = 1_000_000
TIMESYNC_US = 97_000
"""No multiple of the radio's slots or of what the vehicle sends by itself: requests that always meet them
alike would wait alike, one way longer than the other.
"""
TIMESYNC_FIRST_US = 25_000
"""Interval until the clock comparison has settled."""
REBOOT_TICKS = 1_000
"""A tick that runs back by more is a reboot; by less, a message that was overtaken."""
NEVER_US = 1 << 62
_VEHICLE_SYSTEM = m.VEHICLE[0]


class Client:
    """One host at one vehicle.

    Attributes:
        codec: counts what was sent, received, lost, repeated. clock: the vehicle's clock against the host's.
        heartbeat, status: the newest of the vehicle, None before the first.
        ground_radio: whether the host's own radio reports.
        radio_counts: radio frames sent up, received there, sent down, received here, as the two radios
        reported them last within one second; None before. texts: what the vehicle said, oldest first, the
        last 50. heard_us: when the vehicle was last heard. others: MAVLink systems that were heard and are
        neither the vehicle nor its radios.
    """

    def __init__(self) -> None:
        self.codec = Codec(*m.HOST)
        self.clock = ClockSync()
        self.heartbeat: m.Heartbeat | None = None
        self.status: m.FcStatus | None = None
        self.ground_radio = False
        self.radio_counts: tuple[int, int, int, int] | None = None
        self.texts: list[tuple[int, str]] = []
        self.heard_us: int | None = None
        self.others: set[int] = set()
        self.next_deadline_us = 0
        self._ground: m.RadioStats | None = None
        self._out: list[bytes] = []
        self._heartbeat_us = 0
        self._timesync_us = 0
        self._handlers: dict[type, Callable[[Any, int], bool]] = {
            m.Heartbeat: self._on_heartbeat,
            m.Timesync: self._on_timesync,
            m.FcStatus: self._on_status,
            m.StatusText: self._on_text,
            m.RadioStats: self._on_radio,
            m.Ping: self._on_ping,
        }

    def receive(self, data: bytes, now_us: int) -> list[Message]:
        """The messages of the vehicle and both radios that `data` completes, without overtaken statuses."""
        found = []
        handlers = self._handlers
        for message in self.codec.decode(data):
            if message._header.srcSystem == _VEHICLE_SYSTEM:
                self.heard_us = now_us
            elif not isinstance(message, m.RadioStats):
                self.others.add(message.get_srcSystem())
                continue
            handler = handlers.get(type(message))
            if handler is None or handler(message, now_us):
                found.append(message)
        return found

    def send(self, message: Message) -> None:
        """Queues a message. Raises ValueError where a field does not fit."""
        self._out.append(self.codec.encode(message))

    def advance(self, now_us: int) -> None:
        """Queues what is due by itself: HEARTBEAT at 1 Hz, TIMESYNC every 97 ms."""
        if now_us >= self._heartbeat_us:
            self._heartbeat_us = now_us + HEARTBEAT_US
            self.send(m.host_heartbeat())
        if now_us >= self._timesync_us:
            self._timesync_us = now_us + (TIMESYNC_US if self.clock.settled else TIMESYNC_FIRST_US)
            self.send(m.Timesync(0, now_us * 1000))
        self.next_deadline_us = min(self._heartbeat_us, self._timesync_us)

    def take(self) -> bytes:
        """The bytes to be written to the port."""
        if not self._out:
            return b""
        out, self._out = self._out, []
        return b"".join(out)

    def _on_heartbeat(self, message: m.Heartbeat, now_us: int) -> bool:
        if message.get_srcComponent() != m.VEHICLE[1] or not m.is_vehicle(message):
            return False
        self.heartbeat = message
        return True

    def _on_timesync(self, message: m.Timesync, now_us: int) -> bool:
        if message.tc1 == 0:
            self.send(m.Timesync(now_us * 1000, message.ts1))
        else:
            self.clock.answer(message.ts1 // 1000, message.tc1 // 1000, now_us)
        return False

    def _on_status(self, message: m.FcStatus, now_us: int) -> bool:
        last = self.status
        if last is not None and last.tick - REBOOT_TICKS < message.tick <= last.tick:
            return False
        self.status = message
        return True

    def _on_text(self, message: m.StatusText, now_us: int) -> bool:
        self.texts.append((message.severity, message.text))
        del self.texts[:-50]
        return True

    def _on_radio(self, message: m.RadioStats, now_us: int) -> bool:
        if message.get_srcSystem() != _VEHICLE_SYSTEM:
            self.ground_radio = True
            self._ground = message
        elif self._ground is not None:
            ground, self._ground = self._ground, None
            self.radio_counts = (
                ground.frames_sent,
                message.frames_received,
                message.frames_sent,
                ground.frames_received,
            )
        return False

    def _on_ping(self, message: m.Ping, now_us: int) -> bool:
        if message.target_system == 0:
            self.send(m.Ping(message.time_usec, message.seq, *m.VEHICLE))
        return False
