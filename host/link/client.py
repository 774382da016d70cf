"""The host's end of the link, without I/O: bytes in, messages out.

The client sends heartbeats and clock requests by itself. Every request that waits for an answer is a Task
(trimtab.host.link.tasks). One task runs at a time.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from trimtab.host.link.clock import ClockSync
from trimtab.host.link.keys import StationKey
from trimtab.protocol import messages as m
from trimtab.protocol import unsigned
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.parameter_wire import decode
from trimtab.protocol.signing import SIMULATED_EPOCH, Signer, Verdict, Verifier
from trimtab.protocol.upload import CHUNK_BYTES, SIGNED_CHUNK_BYTES

_MASK32, _MASK16 = 0xFFFF_FFFF, 0xFFFF
HEARTBEAT_US = 1_000_000
TIMESYNC_US = 97_000
"""Interval of clock requests.

It is not a multiple of the radio's slot time or of a telemetry interval. Otherwise every request would wait
equally long for its slot, and one direction would always look slower than the other.
"""
TIMESYNC_FIRST_US = 25_000
"""Interval of clock requests until the clock comparison has settled."""
REBOOT_TICKS = 1_000
"""A tick counter that drops by more than this means a reboot; by less, messages that arrived out of order."""
NEVER_US = 1 << 62
_VEHICLE_SYSTEM = m.VEHICLE[0]


class RadioCounts(NamedTuple):
    """Counters of the two radios.

    Frames are counted by direction. The other counters add both radios: messages refused, poses replaced by
    newer ones, messages broken, bytes lost to full buffers, and bytes that belong to no message.
    """

    up_sent: int
    up_received: int
    down_sent: int
    down_received: int
    refused: int
    replaced: int
    broken: int
    overruns: int
    bad_bytes: int

    @classmethod
    def of(cls, ground: m.RadioStats, vehicle: m.RadioStats) -> RadioCounts:
        """Return the counters of both radios' reports."""
        return cls(
            ground.frames_sent,
            vehicle.frames_received,
            vehicle.frames_sent,
            ground.frames_received,
            ground.refused + vehicle.refused,
            ground.replaced + vehicle.replaced,
            ground.broken + vehicle.broken,
            ground.uart_overruns + vehicle.uart_overruns,
            ground.bad_bytes + vehicle.bad_bytes,
        )

    def since(self, before: RadioCounts) -> RadioCounts:
        """Return the increments since `before`, allowing for counters that wrap."""
        frames = [(b - a) & _MASK32 for a, b in zip(before[:4], self[:4], strict=True)]
        return RadioCounts(*frames, *((b - a) & _MASK16 for a, b in zip(before[4:], self[4:], strict=True)))


class Client:
    """The link of one host to one vehicle.

    Parameters
    ----------
    key
        With a key, all messages are signed, and only signed messages of the vehicle are received. The radios
        have no key; their counters are received unsigned.

    Attributes
    ----------
    key
        The key, or None.
    codec
        Encodes and decodes messages; counts those sent, received, lost and repeated.
    clock
        Offset of the vehicle's clock against the host's.
    heartbeat, status
        Newest message of each type from the vehicle; None before the first.
    ground_radio
        Whether the host's radio reports its counters.
    radio_counts
        Counters of the last pair of reports from both radios; None before the first pair.
    bytes_sent, bytes_received
        Bytes on the port.
    texts
        The vehicle's last 50 status texts as (severity, text), oldest first.
    text_count
        Number of status texts received in total.
    heard_us
        Host time of the last message from the vehicle; None before the first.
    parameters
        Values that the vehicle has reported last, by name.
    unsigned
        Whether an unsigned message of the vehicle was refused.
    others
        MAVLink system ids received that belong neither to the vehicle nor to its radios.
    """

    def __init__(self, key: StationKey | None = None) -> None:
        self.codec = Codec(*m.HOST, accepts_unsigned=unsigned.host_accepts)
        self.key = key
        self.clock = ClockSync()
        self.heartbeat: m.Heartbeat | None = None
        self.status: m.FcStatus | None = None
        self.ground_radio = False
        self.radio_counts: RadioCounts | None = None
        self.bytes_sent = 0
        self.bytes_received = 0
        self.texts: list[tuple[int, str]] = []
        self.text_count = 0
        self.heard_us: int | None = None
        self.parameters: dict[str, float] = {}
        self.unsigned = False
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
            m.ParamValue: self._on_parameter,
            m.RadioStats: self._on_radio,
            m.Ping: self._on_ping,
        }
        self.set_epoch(SIMULATED_EPOCH)

    @property
    def chunk_bytes(self) -> int:
        """Bytes of a blob in one UPLOAD_CHUNK, so that the message fits one radio frame."""
        return CHUNK_BYTES if self.key is None else SIGNED_CHUNK_BYTES

    def set_epoch(self, epoch: int) -> None:
        """Set the timestamp of signatures at time 0. Call this before the first message."""
        if self.key is not None:
            self.codec.signer = Signer(self.key.key, link_id=0, epoch=epoch)
            self.codec.verifier = Verifier(self.key.key, epoch=epoch)

    def set_time(self, now_us: int) -> None:
        """Set the time by which the following messages are signed and verified."""
        if self.codec.signer is not None and self.codec.verifier is not None:
            self.codec.signer.advance(now_us)
            self.codec.verifier.advance(now_us)

    def receive(self, data: bytes, now_us: int) -> list[Message]:
        """Return the messages of the vehicle and both radios that `data` completes.

        Messages that the client handles by itself and statuses older than the newest are left out.
        """
        self.bytes_received += len(data)
        messages = []
        handlers = self._handlers
        decoded = self.codec.decode(data)
        for verdict, frame in self.codec.refused:
            self.unsigned |= verdict is Verdict.UNSIGNED and frame[5] == _VEHICLE_SYSTEM
        for message in decoded:
            if message.get_msgbuf()[5] == _VEHICLE_SYSTEM:  # the system of its sender
                self.heard_us = now_us
            elif not isinstance(message, m.RadioStats):
                self.others.add(message.get_srcSystem())
                continue
            handler = handlers.get(type(message))
            if handler is None or handler(message, now_us):
                messages.append(message)
        return messages

    def send(self, message: Message) -> None:
        """Queue a message. Raises ValueError if a field is out of range."""
        self._out.append(self.codec.encode(message))

    def advance(self, now_us: int) -> None:
        """Queue the periodic messages that are due: HEARTBEAT at 1 Hz, TIMESYNC every 97 ms."""
        if now_us >= self._heartbeat_us:
            self._heartbeat_us = now_us + HEARTBEAT_US
            self.send(m.host_heartbeat())
        if now_us >= self._timesync_us:
            self._timesync_us = now_us + (TIMESYNC_US if self.clock.settled else TIMESYNC_FIRST_US)
            self.send(m.Timesync(0, now_us * 1000))
        self.next_deadline_us = min(self._heartbeat_us, self._timesync_us)

    def take(self) -> bytes:
        """Return the bytes to write to the port, and clear the queue."""
        if not self._out:
            return b""
        out, self._out = self._out, []
        data = b"".join(out)
        self.bytes_sent += len(data)
        return data

    def texts_since(self, count: int, least: int = mavlink.MAV_SEVERITY_DEBUG) -> list[str]:
        """Return the status texts received since `text_count` was `count`, at most the last 50.

        least: least MAV_SEVERITY of them; a lower number is more severe.
        """
        new = self.text_count - count
        return [text for severity, text in self.texts[-new:] if severity <= least] if new > 0 else []

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
        self.text_count += 1
        self.texts.append((message.severity, message.text))
        del self.texts[:-50]
        return True

    def _on_parameter(self, message: m.ParamValue, now_us: int) -> bool:
        with contextlib.suppress(ValueError):  # of an unknown type
            value = decode(message.param_value, message.param_type)
            if math.isfinite(value):
                self.parameters[message.param_id] = value
        return True

    def _on_radio(self, message: m.RadioStats, now_us: int) -> bool:
        if message.get_srcSystem() != _VEHICLE_SYSTEM:
            self.ground_radio = True
            self._ground = message
        elif self._ground is not None:
            ground, self._ground = self._ground, None
            self.radio_counts = RadioCounts.of(ground, message)
        return False

    def _on_ping(self, message: m.Ping, now_us: int) -> bool:
        if message.target_system == 0:
            self.send(m.Ping(message.time_usec, message.seq, *m.VEHICLE))
        return False
