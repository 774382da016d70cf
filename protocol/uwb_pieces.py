"""Pieces: messages longer than a radio frame, cut over several frames and put together again."""

from __future__ import annotations

from trimtab.protocol.stream import StreamSplitter

FRAME_BYTES = 116
"""Payload of a radio frame: 127 B less 11 of its own header and checksum."""
PIECE = 0x02
"""First byte of a frame with a piece: MAGIC with every bit inverted, so a damaged frame of messages is never
taken for one."""
PIECE_HEADER_BYTES = 3
"""PIECE, number of the message modulo 256, index of the piece (high half byte), count of all (low half)."""
FRAME_LEAST = 64
"""Least size of a frame: a signed pose fits, and no message needs more than 15 pieces."""
PIECES_WAIT_US = 1_000_000
"""Time for which pieces wait for the others, and for which the number of a finished message is remembered."""
PIECED_MOST = 16
"""Greatest number of messages remembered; then the oldest is forgotten."""


def cut(message: bytes, number: int, frame_bytes: int = FRAME_BYTES) -> list[bytes]:
    """Return the frames of a message longer than one frame, in order. number: identifies the message."""
    step = frame_bytes - PIECE_HEADER_BYTES
    count = -(-len(message) // step)
    return [
        bytes((PIECE, number & 0xFF, index << 4 | count)) + message[index * step : (index + 1) * step]
        for index in range(count)
    ]


class Assembler:
    """Puts pieces together, in any order and with repetitions. A message comes out once or never.

    Attributes
    ----------
    broken
        Number of messages given up: pieces were missing, or the checksum was wrong.
    """

    def __init__(self) -> None:
        self.broken = 0
        # number: (time of the first piece, pieces by index; None once the message was finished).
        self._messages: dict[int, tuple[int, list[bytes] | None]] = {}

    def receive(self, frame: bytes, now_us: int) -> bytes | None:
        """Return the message that a frame with a piece completes; None while pieces are missing."""
        if len(frame) <= PIECE_HEADER_BYTES:
            return None
        number, index, count = frame[1], frame[2] >> 4, frame[2] & 0x0F
        if index >= count:
            return None
        known = self._messages.get(number)
        stale = known is not None and (
            now_us - known[0] >= PIECES_WAIT_US or (known[1] is not None and len(known[1]) != count)
        )
        if known is None or stale:
            self._forget(number)
            if len(self._messages) >= PIECED_MOST:
                self._forget(next(iter(self._messages)))
            known = self._messages[number] = (now_us, [b""] * count)
        begun_us, pieces = known
        if pieces is None:
            return None
        pieces[index] = pieces[index] or frame[PIECE_HEADER_BYTES:]
        if not all(pieces):
            return None
        self._messages[number] = (begun_us, None)
        message = b"".join(pieces)
        if StreamSplitter().feed(message) == [message]:
            return message
        self.broken += 1
        return None

    def expire(self, now_us: int) -> None:
        """Give up messages whose pieces have waited too long."""
        for number in [
            n for n, (begun_us, _) in self._messages.items() if now_us - begun_us >= PIECES_WAIT_US
        ]:
            self._forget(number)

    def _forget(self, number: int) -> None:
        _, pieces = self._messages.pop(number, (0, None))
        self.broken += pieces is not None
