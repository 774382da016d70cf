"""Fair share of a serial line among several clients: whole messages, one of each client in turn."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field

from trimtab.protocol.stream import MAGIC, OVERHEAD_BYTES, SIGNATURE_BYTES

PIECE_BYTES = 280
"""Greatest length of a piece that is no message."""
READ_BYTES = 4096
"""Greatest number of bytes to read from a client at once."""
QUEUE_BYTES = 2 * READ_BYTES
"""Greatest number of bytes of one client that wait; what does not fit is dropped, as by a full UART."""
BULK_BYTES = 2048
"""Waiting bytes of a client above which it is served at BULK_RATE while others send too."""
BULK_RATE = 2000
"""Bytes per second for all such clients together: about fifty frames of the radio, of 500."""
ACTIVE_US = 1_000_000
"""Time after its last data for which a client counts as sending."""


def message_bytes(data: bytes, at: int) -> int:
    """Return the length of the MAVLink 2 message that begins at `at`, as far as its header is there."""
    if len(data) <= at + 2:
        return OVERHEAD_BYTES
    return OVERHEAD_BYTES + data[at + 1] + (SIGNATURE_BYTES if data[at + 2] & 1 else 0)


def pieces(data: bytes) -> Iterator[bytes]:
    """Yield the messages in `data`, and what lies between them in pieces of at most PIECE_BYTES."""
    at = 0
    while at < len(data):
        if data[at] == MAGIC:
            end = at + message_bytes(data, at)
        else:
            magic = data.find(MAGIC, at)
            end = min(at + PIECE_BYTES, len(data) if magic < 0 else magic)
        yield data[at:end]
        at = end


@dataclass
class _Queue:
    """Waiting messages of a client, their bytes, and the time of its last data."""

    pieces: deque[bytes] = field(default_factory=deque)
    size: int = 0
    heard_us: int = 0


class FairShare:
    """Queues of several clients, served in turn, one message each.

    While several clients send, those with much data waiting share BULK_RATE: a client that floods the line
    hardly delays the others, and loses only its own data.
    """

    def __init__(self) -> None:
        self._queues: dict[Hashable, _Queue] = {}
        self._bulk = 0.0  # bytes that bulk clients may still send
        self._taken_us = 0

    def has_room(self, client: Hashable) -> bool:
        """Return whether READ_BYTES of this client, and a message begun before, can be queued."""
        queue = self._queues.get(client)
        return queue is None or queue.size + READ_BYTES + PIECE_BYTES <= QUEUE_BYTES

    def offer(self, client: Hashable, data: bytes, now_us: int) -> None:
        """Queue data of a client, whole messages; drop those that do not fit."""
        queue = self._queues.setdefault(client, _Queue())
        queue.heard_us = now_us
        for piece in pieces(data):
            if queue.size + len(piece) <= QUEUE_BYTES:
                queue.pieces.append(piece)
                queue.size += len(piece)

    def take(self, room: int, now_us: int) -> bytes:
        """Return waiting messages, about `room` bytes: the last one may exceed it."""
        for client in [c for c, q in self._queues.items() if not q.size and now_us - q.heard_us > ACTIVE_US]:
            del self._queues[client]
        if len(self._queues) < 2:
            return self._serve(room, bulk=None)
        self._bulk = min(PIECE_BYTES, self._bulk + 1e-6 * BULK_RATE * (now_us - self._taken_us))
        self._taken_us = now_us
        data = self._serve(room, bulk=False)
        bulk = self._serve(min(room - len(data), round(self._bulk)), bulk=True)
        self._bulk -= len(bulk)
        return data + bulk

    def _serve(self, room: int, *, bulk: bool | None) -> bytes:
        """Return up to `room` bytes of clients with much data, or with little, or of all (None)."""
        parts: list[bytes] = []
        while room > 0:
            waiting = (client for client, queue in self._queues.items() if queue.size)
            client = next(
                (c for c in waiting if bulk is None or (self._queues[c].size > BULK_BYTES) is bulk), None
            )
            if client is None:
                break
            queue = self._queues.pop(client)
            piece = queue.pieces.popleft()
            queue.size -= len(piece)
            room -= len(piece)
            parts.append(piece)
            self._queues[client] = queue  # behind the others
        return b"".join(parts)
