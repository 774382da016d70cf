"""The radio processor: moves complete messages between a serial line and radio frames.

It does not decode payloads. The ground radio is a second instance, with the host's port as its serial line.
The vehicle's radio keeps the order of each component's messages: ground stations count a message that another
one overtook as lost.
"""

from __future__ import annotations

from collections import deque

from trimtab.firmware_model.mcu.uart import UartPort
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST_RADIO, VEHICLE_RADIO, RadioStats
from trimtab.protocol.stream import StreamSplitter
from trimtab.protocol.uwb import FramePacker
from trimtab.protocol.uwb_pieces import FRAME_BYTES, PIECE, Assembler

BAUD = 921_600
RX_BYTES = 4_096
TX_BYTES = 8_192
AIR_BYTES = 1_024
"""Buffer for bytes received over the air until the next tick. Frames that do not fit are lost and counted."""
STATS_US = 1_000_000
"""Interval of RADIO_STATS."""
REPEAT_US = 5_000
"""Time within which a frame equal to the last one is a duplicate of the channel."""
_PIECE = bytes([PIECE])


class RadioMcu:
    """One radio with a serial line. Only its tick moves bytes between the two sides.

    Ticks before `due_us` may be omitted. `due_us` is the earlier of `uart.due_us` and `radio_due_us`.

    Parameters
    ----------
    address
        System and component in RADIO_STATS, `messages.VEHICLE_RADIO` or `messages.HOST_RADIO`.
    poses
        Greatest number of poses that wait for a slot; 2 for poses at 200 Hz.
    baud, rx_bytes, tx_bytes, chunk_bytes, idle_us
        Parameters of the serial line; see `UartPort`.
    frame_bytes
        Payload of a radio frame.
    """

    def __init__(
        self,
        *,
        address: tuple[int, int] = VEHICLE_RADIO,
        poses: int = 1,
        baud: int = BAUD,
        rx_bytes: int = RX_BYTES,
        tx_bytes: int = TX_BYTES,
        chunk_bytes: int | None = None,
        idle_us: int = 0,
        frame_bytes: int = FRAME_BYTES,
    ) -> None:
        self.uart = UartPort(
            baud=baud, rx_bytes=rx_bytes, tx_bytes=tx_bytes, chunk_bytes=chunk_bytes, idle_us=idle_us
        )
        self._to_host = address == HOST_RADIO
        self.packer = FramePacker(poses=poses, frame_bytes=frame_bytes, in_order=not self._to_host)
        self.frames_sent = 0
        self.frames_received = 0
        self.air_overruns = 0
        self._splitter = StreamSplitter()
        self._assembler = Assembler()
        self._codec = Codec(*address)
        self._last_frame, self._last_frame_us = b"", 0
        self._air: deque[bytes] = deque()
        self._air_bytes = 0
        self._stats_us = STATS_US
        self.radio_due_us = STATS_US

    @property
    def due_us(self) -> int:
        """Time of the next tick that has work to do."""
        return min(self.uart.due_us, self.radio_due_us)

    @property
    def has_frame(self) -> bool:
        """Whether a frame waits for transmission."""
        return self.packer.waiting > 0

    @property
    def pose_waits(self) -> bool:
        """Whether a pose waits for transmission."""
        return bool(self.packer.poses)

    def tick(self, now_us: int) -> bool:
        """Move the bytes received since the last tick; return whether a frame waits for transmission."""
        if self._air:
            self._pass_down(now_us)
        uart = self.uart
        if now_us >= uart.due_us:
            for message in self._splitter.feed(uart.read(now_us)):
                self.packer.offer(message)
        if now_us >= self._stats_us:
            self._report(now_us)
        self.radio_due_us = 0 if self._air else self._stats_us
        return self.packer.waiting > 0

    def air_send(self, now_us: int) -> bytes | None:
        """Return the next frame (complete messages or a piece of a long one), or None if none waits."""
        frame = self.packer.take()
        if frame is not None:
            self.frames_sent += 1
        return frame

    def air_receive(self, frame: bytes, now_us: int) -> None:
        """Queue the frame's messages for the next tick; drop them if the buffer is full.

        A duplicate of the last frame is ignored: ground stations would count it as a gap of 255 messages.
        """
        if frame == self._last_frame and now_us - self._last_frame_us < REPEAT_US:
            return
        self._last_frame, self._last_frame_us = frame, now_us
        self.frames_received += 1
        if frame.startswith(_PIECE):
            message = self._assembler.receive(frame, now_us)
            if message is None:
                return
            frame = message
        size = len(frame)
        if self._air_bytes + size > AIR_BYTES:
            self.air_overruns += size
            return
        self._air.append(frame)
        self._air_bytes += size
        self.radio_due_us = 0

    def _pass_down(self, now_us: int) -> None:
        """Send received frames over the serial line. Frames that do not fit wait."""
        air, uart = self._air, self.uart
        free = uart.tx_free(now_us)
        while air and free >= len(air[0]):
            frame = air.popleft()
            self._air_bytes -= len(frame)
            uart.write(frame, now_us)
            free -= len(frame)

    def _report(self, now_us: int) -> None:
        """Send RADIO_STATS to the host: over the serial line from the ground radio, else over the air."""
        self._stats_us = now_us - now_us % STATS_US + STATS_US
        self._assembler.expire(now_us)
        message = self._codec.encode(
            RadioStats(
                self.frames_sent & 0xFFFF_FFFF,
                self.frames_received & 0xFFFF_FFFF,
                self.packer.packed & 0xFFFF_FFFF,
                self.packer.refused & 0xFFFF,
                self.packer.replaced & 0xFFFF,
                self._assembler.broken & 0xFFFF,
                (self.uart.overruns + self.air_overruns) & 0xFFFF,
                self._splitter.bad_bytes & 0xFFFF,
            )
        )
        if self._to_host:
            self.uart.write(message, now_us)
        else:
            self.packer.offer(message)
