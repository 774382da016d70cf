"""Serial lines between processors: limited baud rate and finite buffers, computed from timestamps.

No code runs per byte. The sender records when the line starts to carry its bytes. The receiver computes, when
it reads, how many of them have arrived. Times are exact: integers, time in us multiplied by the baud rate.
"""

from __future__ import annotations

from collections import deque

from trimtab.firmware_model.clock import NEVER_US

_BITS_PER_BYTE = 10  # one start bit, eight data bits, one stop bit
_BYTE_UNITS = _BITS_PER_BYTE * 1_000_000
_SEGMENTS_MAX = 256  # writes that may be on the line before arrived bytes move to the receive buffer


class UartPort:
    """One processor's end of a serial line: a transmitter and a receive buffer of finite size.

    A byte that arrives while the receive buffer is full is lost and counted in `overruns`. A write that does
    not fit into the transmit buffer is refused as a whole and counted in `refused`, so no message is
    truncated.

    `due_us` is the time of the receiver's interrupt. As with DMA reception, the interrupt is raised when the
    line becomes idle or a chunk is full. A processor that compares its clock with `due_us` needs no other
    polling.

    Parameters
    ----------
    baud
        Baud rate of the transmitter, bit/s.
    rx_bytes
        Size of the receive buffer.
    tx_bytes
        Size of the transmit buffer.
    chunk_bytes
        Number of bytes that raises the interrupt; half the receive buffer by default.
    idle_us
        Time without a byte after which the line counts as idle.
    wired
        Whether the line is a cable to the host, which needs physical access, rather than a line to a radio.
    """

    def __init__(
        self,
        *,
        baud: int,
        rx_bytes: int,
        tx_bytes: int,
        chunk_bytes: int | None = None,
        idle_us: int = 0,
        wired: bool = False,
    ) -> None:
        for name, value in (("baud", baud), ("rx_bytes", rx_bytes), ("tx_bytes", tx_bytes)):
            if value <= 0:
                raise ValueError(f"{name} must be positive, not {value}")
        self.baud = baud
        self.rx_bytes = rx_bytes
        self.tx_bytes = tx_bytes
        self.wired = wired
        self.due_us = NEVER_US
        self.overruns = 0
        self.refused = 0
        self._chunk = min(chunk_bytes or max(1, rx_bytes // 2), rx_bytes)
        self._idle_us = idle_us
        self._peer: UartPort | None = None
        self._peer_baud = 0
        self._busy_until = 0  # end of the last byte written, in units of 1/baud us
        self._incoming: deque[tuple[int, int, bytes]] = deque()  # (start and end in peer units, bytes)
        self._taken = 0  # bytes of the first incoming segment that have arrived
        self._buffer = b""
        self._is_single = False  # whether one write is on the line and nothing else, and it fills no chunk

    def write(self, data: bytes, now_us: int) -> bool:
        """Queue all of `data` for transmission; return False if the transmit buffer has no room.

        The bytes of an unconnected port take the same time and are lost.
        """
        size = len(data)
        start, free = now_us * self.baud, self.tx_bytes
        if self._busy_until > start:
            start, free = self._busy_until, self.tx_free(now_us)
        if size > free:
            self.refused += 1
            return False
        if size:
            self._busy_until = end = start + size * _BYTE_UNITS
            if self._peer is not None:
                self._peer._carry(start, end, data)
        return True

    def tx_free(self, now_us: int) -> int:
        """Return the free space of the transmit buffer at `now_us`, in bytes."""
        backlog = self._busy_until - now_us * self.baud
        return self.tx_bytes if backlog <= 0 else self.tx_bytes + (-backlog // _BYTE_UNITS)

    def read(self, now_us: int) -> bytes:
        """Empty the receive buffer and return the bytes that arrived up to `now_us`, oldest first."""
        if self._is_single and now_us >= self.due_us:
            data = self._incoming.popleft()[2]
            self._is_single = False
            self.due_us = NEVER_US
            return data
        self._is_single = False
        self._arrive(now_us)
        data, self._buffer = self._buffer, b""
        if self._incoming:
            self._plan_due()
        else:
            self.due_us = NEVER_US
        return data

    def _carry(self, start: int, end: int, data: bytes) -> None:
        incoming = self._incoming
        self._is_single = not incoming and not self._buffer and len(data) < self._chunk
        incoming.append((start, end, data))
        if self._is_single:
            self.due_us = -(-end // self._peer_baud) + self._idle_us
            return
        if len(incoming) > _SEGMENTS_MAX:
            self._arrive(start // self._peer_baud)  # no reader: move arrived bytes to the buffer
        self._plan_due()

    def _arrive(self, now_us: int) -> None:
        incoming, now = self._incoming, now_us * self._peer_baud
        while incoming and incoming[0][0] < now:
            start, end, data = incoming[0]
            if end <= now:
                incoming.popleft()
                fresh, self._taken = data[self._taken :], 0
            else:
                arrived = (now - start) // _BYTE_UNITS
                fresh, self._taken = data[self._taken : arrived], arrived
            room = self.rx_bytes - len(self._buffer)
            if len(fresh) > room:
                self.overruns += len(fresh) - room
                fresh = fresh[:room]
            self._buffer += fresh
            if end > now:
                return

    def _plan_due(self) -> None:
        """Set `due_us` to the time at which the line becomes idle after this burst, or a chunk is full."""
        if self._buffer or not self._incoming:
            self.due_us = 0 if self._buffer else NEVER_US
            return
        chunk, idle = self._chunk, self._idle_us * self._peer_baud
        count = -self._taken
        due = 0
        for start, end, data in self._incoming:
            if count > 0 and start > due:
                break  # the line was idle in between
            size = len(data)
            if count + size >= chunk:
                due = start + (chunk - count) * _BYTE_UNITS
                break
            count += size
            due = end + idle
        self.due_us = -(-due // self._peer_baud)


def connect(a: UartPort, b: UartPort) -> None:
    """Connect two ports in both directions.

    Raises ValueError if either port is already connected.
    """
    if a is b or a._peer is not None or b._peer is not None:
        raise ValueError("both ends must be two different ports that are not connected yet")
    a._peer, a._peer_baud = b, b.baud
    b._peer, b._peer_baud = a, a.baud
