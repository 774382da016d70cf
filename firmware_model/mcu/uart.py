"""Byte pipes between processors: baud-limited, with finite buffers, computed from timestamps.

Nothing here runs per byte. A sender notes when the line starts to carry its bytes; a receiver works out, when
it looks, how many have arrived since. Times are kept exactly, as integers in units of 1/baud microseconds.
"""

from __future__ import annotations

from collections import deque

from trimtab.firmware_model.clock import NEVER_US

_BITS_PER_BYTE = 10  # one start bit, eight data bits, one stop bit
_BYTE_UNITS = _BITS_PER_BYTE * 1_000_000
_SEGMENTS_MAX = 256  # writes kept on the line before they are accounted for


class UartPort:
    """One processor's end of a serial line: a transmitter and a receive buffer of stated size.

    A byte that arrives while the receive buffer is full is lost and counted in `overruns`. A write that does
    not fit into the transmit buffer is refused whole and counted in `refused`: no message goes out cut.

    `due_us` is the time at which the receiver would raise its interrupt, as one does whose bytes are moved by
    DMA: the line has gone idle, or a chunk is full. A processor that compares its clock with `due_us` needs
    no other polling.

    Parameters
    ----------
    baud
        bits a second of the transmitter.
    rx_bytes
        size of the receive buffer.
    tx_bytes
        size of the transmit buffer.
    chunk_bytes
        bytes that raise the interrupt; half the receive buffer where not given.
    idle_us
        how long a quiet line takes to count as idle.
    """

    def __init__(
        self, *, baud: int, rx_bytes: int, tx_bytes: int, chunk_bytes: int | None = None, idle_us: int = 0
    ) -> None:
        for name, value in (("baud", baud), ("rx_bytes", rx_bytes), ("tx_bytes", tx_bytes)):
            if value <= 0:
                raise ValueError(f"{name} must be positive, not {value}")
        self.baud = baud
        self.rx_bytes = rx_bytes
        self.tx_bytes = tx_bytes
        self.due_us = NEVER_US
        self.overruns = 0
        self.refused = 0
        self.received = 0
        self.sent = 0
        self._chunk = min(chunk_bytes or max(1, rx_bytes // 2), rx_bytes)
        self._idle_us = idle_us
        self._peer: UartPort | None = None
        self._busy_until = 0  # end of the last byte written, in units of 1/baud us
        self._incoming: deque[tuple[int, bytes]] = deque()  # (start in peer units, bytes)
        self._taken = 0  # bytes of the first incoming segment that have arrived
        self._buffer = b""

    def write(self, data: bytes, now_us: int) -> bool:
        """Return true where all of `data` was queued for the line; False where the transmit buffer had no
        room.

        An unconnected port sends into the air: the bytes take their time and are gone.
        """
        size = len(data)
        now = now_us * self.baud
        start = self._busy_until
        if start <= now:
            free, start = self.tx_bytes, now
        else:
            free = self.tx_free(now_us)
        if size > free:
            self.refused += 1
            return False
        if size:
            self._busy_until = start + size * _BYTE_UNITS
            self.sent += size
            if self._peer is not None:
                self._peer._carry(start, bytes(data))
        return True

    def tx_free(self, now_us: int) -> int:
        """Bytes that a write at `now_us` may have without being refused."""
        backlog = self._busy_until - now_us * self.baud
        return self.tx_bytes if backlog <= 0 else self.tx_bytes + (-backlog // _BYTE_UNITS)

    def read(self, now_us: int) -> bytes:
        """All bytes that arrived up to `now_us` and found room, oldest first; empties the receive buffer."""
        self._arrive(now_us)
        data, self._buffer = self._buffer, b""
        if self._incoming:
            self._plan_due()
        else:
            self.due_us = NEVER_US
        return data

    def _carry(self, start: int, data: bytes) -> None:
        self._incoming.append((start, data))
        if len(self._incoming) > _SEGMENTS_MAX and self._peer is not None:
            self._arrive(start // self._peer.baud)  # nobody reads: what has arrived settles in the buffer
        self._plan_due()

    def _arrive(self, now_us: int) -> None:
        peer, incoming = self._peer, self._incoming
        if peer is None or not incoming:
            return
        now = now_us * peer.baud
        while incoming:
            start, data = incoming[0]
            arrived = (now - start) // _BYTE_UNITS
            if arrived <= self._taken:
                return
            fresh = data[self._taken : arrived]
            count, room = len(fresh), self.rx_bytes - len(self._buffer)
            self.received += count
            if count > room:
                self.overruns += count - room
                fresh = fresh[:room]
            self._buffer += fresh
            if arrived < len(data):
                self._taken = arrived
                return
            incoming.popleft()
            self._taken = 0

    def _plan_due(self) -> None:
        """Set `due_us` to when the burst now on the line has ended and it is idle, or a chunk has come."""
        peer = self._peer
        if self._buffer or peer is None or not self._incoming:
            self.due_us = 0 if self._buffer else NEVER_US
            return
        chunk, idle = self._chunk, self._idle_us * peer.baud
        count = -self._taken
        end = 0
        for start, data in self._incoming:
            if count > 0 and start > end:
                break  # the line was idle in between
            size = len(data)
            if count + size >= chunk:
                end = start + (chunk - count) * _BYTE_UNITS
                break
            count += size
            end = start + size * _BYTE_UNITS + idle
        self.due_us = -(-end // peer.baud)


def connect(a: UartPort, b: UartPort) -> None:
    """Join two ports by a line each way.

    Raises ValueError where either port is already connected.
    """
    if a is b or a._peer is not None or b._peer is not None:
        raise ValueError("both ends must be two different ports that are not connected yet")
    a._peer = b
    b._peer = a
