"""Fair share of a serial line among several clients: whole messages, one of each client in turn."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator

from trimtab.protocol.stream import MAGIC, OVERHEAD_BYTES, SIGNATURE_BYTES

PIECE_BYTES = 280
"""Greatest length of a piece that is no message."""
READ_BYTES = 4096
"""Greatest number of bytes to read from a client at once."""
QUEUE_BYTES = 2 * READ_BYTES
"""Greatest number of bytes of one client that wait; what does not fit is dropped, as by a full UART."""


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


class FairShare:
    """Queues of several clients, served in turn, one message each.

    A client that floods the line therefore delays the others by one message, and loses only its own data.
    """

    def __init__(self) -> None:
        self._queues: dict[Hashable, deque[bytes]] = {}
        self._bytes: dict[Hashable, int] = {}

    def has_room(self, client: Hashable) -> bool:
        """Return whether READ_BYTES of this client, and a message begun before, can be queued."""
        return self._bytes.get(client, 0) + READ_BYTES + PIECE_BYTES <= QUEUE_BYTES

    def offer(self, client: Hashable, data: bytes) -> None:
        """Queue data of a client, whole messages; drop those that do not fit."""
        for piece in pieces(data):
            size = self._bytes.get(client, 0) + len(piece)
            if size <= QUEUE_BYTES:
                self._queues.setdefault(client, deque()).append(piece)
                self._bytes[client] = size

    def take(self, room: int) -> bytes:
        """Return up to `room` bytes of the waiting messages, one of each client in turn."""
        parts: list[bytes] = []
        while self._queues:
            client = next(iter(self._queues))
            queue = self._queues[client]
            if len(queue[0]) > room:
                break
            piece = queue.popleft()
            room -= len(piece)
            parts.append(piece)
            self._bytes[client] -= len(piece)
            del self._queues[client]
            if queue:
                self._queues[client] = queue  # behind the others
            else:
                del self._bytes[client]
        return b"".join(parts)
