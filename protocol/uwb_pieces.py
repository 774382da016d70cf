"""Split messages longer than a radio frame into pieces and reassemble them."""

from __future__ import annotations

from trimtab.protocol.stream import StreamSplitter

FRAME_BYTES = 116
"""Payload of a radio frame: 127 B minus 11 B for header and checksum."""
PIECE = 0x02
"""First byte of a frame with a piece: MAGIC with every bit inverted, so a damaged frame of messages is never
mistaken for a piece."""
PIECE_HEADER_BYTES = 3
"""Header of a piece: PIECE, message number modulo 256, piece index (high 4 bits) and piece count (low 4)."""
FRAME_BYTES_MIN = 64
"""Smallest frame: a signed pose fits, and no message needs more than 15 pieces."""
PIECE_TIMEOUT_US = 1_000_000
"""Time for which pieces of a message, or the number of a finished message, are remembered."""
PIECED_MESSAGES_MAX = 16
"""Greatest number of messages remembered. Beyond it the oldest is forgotten."""


def split_message(message: bytes, number: int, frame_bytes: int = FRAME_BYTES) -> list[bytes]:
    """Return the frames of a message longer than one frame, in order. number: identifies the message."""
    step = frame_bytes - PIECE_HEADER_BYTES
    count = -(-len(message) // step)
    return [
        bytes((PIECE, number & 0xFF, index << 4 | count)) + message[index * step : (index + 1) * step]
        for index in range(count)
    ]


class Assembler:
    """Reassembles messages from pieces in any order, with repetitions. Returns each message at most once.

    Attributes
    ----------
    broken
        Number of abandoned messages: pieces were missing, or the checksum was wrong.
    """

    def __init__(self) -> None:
        self.broken = 0
        # number: (time of the first piece, pieces by index; None once the message is finished).
        self._messages: dict[int, tuple[int, list[bytes] | None]] = {}

    def receive(self, frame: bytes, now_us: int) -> bytes | None:
        """Return the message that this piece completes, or None while pieces are missing."""
        if len(frame) <= PIECE_HEADER_BYTES:
            return None
        number, index, count = frame[1], frame[2] >> 4, frame[2] & 0x0F
        if index >= count:
            return None
        entry = self._messages.get(number)
        stale = entry is not None and (
            now_us - entry[0] >= PIECE_TIMEOUT_US or (entry[1] is not None and len(entry[1]) != count)
        )
        if entry is None or stale:
            self._forget(number)
            if len(self._messages) >= PIECED_MESSAGES_MAX:
                self._forget(next(iter(self._messages)))
            entry = self._messages[number] = (now_us, [b""] * count)
        first_us, pieces = entry
        if pieces is None:
            return None
        pieces[index] = pieces[index] or frame[PIECE_HEADER_BYTES:]
        if not all(pieces):
            return None
        self._messages[number] = (first_us, None)
        message = b"".join(pieces)
        if StreamSplitter().feed(message) == [message]:
            return message
        self.broken += 1
        return None

    def expire(self, now_us: int) -> None:
        """Abandon messages whose first piece is older than PIECE_TIMEOUT_US."""
        for number in [
            n for n, (first_us, _) in self._messages.items() if now_us - first_us >= PIECE_TIMEOUT_US
        ]:
            self._forget(number)

    def _forget(self, number: int) -> None:
        _, pieces = self._messages.pop(number, (0, None))
        self.broken += pieces is not None
