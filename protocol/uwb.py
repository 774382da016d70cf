"""Between byte streams and radio frames: MAVLink 2 messages found in bytes and packed into frames of 116 B.

Whole messages share a frame. A message longer than a frame is cut over several, in pieces, each alone in its
frame, and put together again by the other radio. Nothing here decodes payloads; an id, a length and a
checksum are all it takes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import IntEnum

from fastcrc.crc16 import mcrf4xx

from trimtab.protocol.generated.frames import MESSAGES

FRAME_BYTES = 116
"""Payload of a radio frame: 127 B less 11 of its own header and checksum."""

MAGIC = 0xFD
HEADER_BYTES = 10
OVERHEAD_BYTES = HEADER_BYTES + 2
SIGNATURE_BYTES = 13
LONGEST_BYTES = OVERHEAD_BYTES + 255 + SIGNATURE_BYTES
"""No message is longer, so no splitter keeps more than one byte less between two calls."""

PIECE = 0x02
"""First byte of a frame with a piece: MAGIC with every bit turned over, so that a damaged frame of messages
is not taken for one.
"""
PIECE_HEADER_BYTES = 3
"""PIECE, number of the message modulo 256, index of the piece (high half byte), count of all (low half)."""
FRAME_LEAST = 64
"""Fewest bytes a frame may have: a signed pose fits, and a message is cut into no more pieces than count."""
PIECES_WAIT_US = 1_000_000
"""How long the pieces of a message wait for the others, and how long a finished message's number is known."""
PIECED_MOST = 16
"""Messages of which something is kept; beyond that the oldest goes."""

_SIGNED = 0x01
_PRIVATE = 52100
_MAGIC = bytes([MAGIC])
# id: (checksum seed, longest payload). Standard messages may have grown extensions that we do not know.
_KNOWN: dict[int, tuple[bytes, int]] = {
    number: (bytes([seed]), longest if number >= _PRIVATE else 255)
    for number, (_, seed, longest) in MESSAGES.items()
}


def message_id(message: bytes) -> int:
    """Id of a whole message."""
    return message[7] | message[8] << 8 | message[9] << 16


class StreamSplitter:
    """Finds whole messages of the dialect in a stream that may lose, repeat or garble bytes.

    A message counts when its id is known, its length possible and its checksum right; otherwise the search
    goes on one byte further, so that a damaged message costs none of its neighbours.

    Attributes, all counts since construction:
        messages: whole messages found.
        bad_bytes: bytes that belonged to none.
        bad_checksums: plausible headers whose checksum was wrong.
    """

    def __init__(self) -> None:
        self.messages = 0
        self.bad_bytes = 0
        self.bad_checksums = 0
        self._pending = b""

    @property
    def pending_bytes(self) -> int:
        """Bytes kept for the next call: the beginning of what may become a message."""
        return len(self._pending)

    def feed(self, data: bytes, *, last: bool = False) -> list[bytes]:
        """Return the messages that `data` completes, oldest first, each exactly as it was in the stream.

        After the `last` bytes nothing is waited for: what has begun and not ended is no message, and may
        have one inside.
        """
        data = self._pending + data if self._pending else bytes(data)
        found: list[bytes] = []
        at, end = 0, len(data)
        while at < end:
            if data[at] != MAGIC:
                skipped = data.find(_MAGIC, at)
                skipped = end if skipped < 0 else skipped
                self.bad_bytes += skipped - at
                at = skipped
                continue
            if end - at < OVERHEAD_BYTES:
                break
            length, flags = data[at + 1], data[at + 2]
            known = _KNOWN.get(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)
            if known is None or length > known[1] or flags > _SIGNED:
                self.bad_bytes += 1
                at += 1
                continue
            stop = at + HEADER_BYTES + length
            after = stop + 2 + SIGNATURE_BYTES if flags else stop + 2
            if after > end:
                if not last:
                    break
                self.bad_bytes += 1
                at += 1
                continue
            if mcrf4xx(data[at + 1 : stop] + known[0]) != data[stop] | data[stop + 1] << 8:
                self.bad_checksums += 1
                self.bad_bytes += 1
                at += 1
                continue
            found.append(data[at:after])
            at = after
        if last:
            self.bad_bytes += end - at
            at = end
        self._pending = data[at:]
        self.messages += len(found)
        return found


def split(data: bytes) -> list[bytes]:
    """Return the messages in `data` alone, a datagram: what began in it and did not end is none."""
    return StreamSplitter().feed(data, last=True)


def cut(message: bytes, number: int, frame_bytes: int = FRAME_BYTES) -> list[bytes]:
    """Return the frames of a message longer than one, in order; `number` sets it apart from its
    neighbours.
    """
    step = frame_bytes - PIECE_HEADER_BYTES
    count = -(-len(message) // step)
    return [
        bytes((PIECE, number & 0xFF, index << 4 | count)) + message[index * step : (index + 1) * step]
        for index in range(count)
    ]


class Assembler:
    """Puts pieces together, in whatever order and however often they come. A message comes out once or never.

    Attributes
    ----------
    broken
        messages given up, since construction: pieces missing, or a checksum that does not fit.
    """

    def __init__(self) -> None:
        self.broken = 0
        # number: (time of the first piece, pieces by index; None once the message was finished).
        self._kept: dict[int, tuple[int, list[bytes] | None]] = {}

    def receive(self, frame: bytes, now_us: int) -> bytes | None:
        """Return the message that a frame with a piece completes, None while others are missing."""
        if len(frame) <= PIECE_HEADER_BYTES:
            return None
        number, index, count = frame[1], frame[2] >> 4, frame[2] & 0x0F
        if index >= count:
            return None
        known = self._kept.get(number)
        stale = known is not None and (
            now_us - known[0] >= PIECES_WAIT_US or (known[1] is not None and len(known[1]) != count)
        )
        if known is None or stale:
            self._forget(number)
            if len(self._kept) >= PIECED_MOST:
                self._forget(next(iter(self._kept)))
            known = self._kept[number] = (now_us, [b""] * count)
        begun_us, pieces = known
        if pieces is None:
            return None
        pieces[index] = pieces[index] or frame[PIECE_HEADER_BYTES:]
        if not all(pieces):
            return None
        self._kept[number] = (begun_us, None)
        message = b"".join(pieces)
        if StreamSplitter().feed(message) == [message]:
            return message
        self.broken += 1
        return None

    def expire(self, now_us: int) -> None:
        """Give up what has waited too long."""
        for number in [n for n, (begun_us, _) in self._kept.items() if now_us - begun_us >= PIECES_WAIT_US]:
            self._forget(number)

    def _forget(self, number: int) -> None:
        _, pieces = self._kept.pop(number, (0, None))
        self.broken += pieces is not None


class Priority(IntEnum):
    """Classes of messages, the most urgent first."""

    URGENT = 0
    CONTROL = 1
    STATUS = 2
    UPLOAD = 3


_URGENT = (
    *("ATT_POS_MOCAP", "TIMESYNC", "COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK"),
    # A client streams setpoints and then asks for them to be followed: the command must not overtake them.
    *("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET"),
)
_CONTROL = ("FC_CONTROL", "FC_ESTIMATE", "FC_OBSERVER")
_BULK = ("UPLOAD_", "FILE_TRANSFER_PROTOCOL")


def _priority(name: str) -> Priority:
    if name in _URGENT:
        return Priority.URGENT
    if name in _CONTROL:
        return Priority.CONTROL
    return Priority.UPLOAD if name.startswith(_BULK) else Priority.STATUS


PRIORITIES: dict[int, Priority] = {number: _priority(name) for number, (name, _, _) in MESSAGES.items()}
"""Class of each message by id."""
_UNKNOWN = Priority.STATUS

CAPACITY_BYTES: Mapping[Priority, int] = {
    Priority.URGENT: 1024,
    Priority.CONTROL: 512,
    Priority.STATUS: 4096,
    Priority.UPLOAD: 4096,
}
"""Room of each queue."""

_POSE = next(number for number, (name, _, _) in MESSAGES.items() if name == "ATT_POS_MOCAP")


class FramePacker:
    """Packs whole messages into radio frames, the most urgent first, in order within each class.

    Poses come before everything, and at most `poses` of them wait: a newer one replaces the oldest. Where a
    queue has no room, control telemetry drops its oldest message and every other class refuses the new one.
    A message longer than a frame goes out in pieces, a frame each, when nothing more urgent waits; what is
    more urgent goes between them.

    Parameters
    ----------
    poses
        poses that may wait; with 1 a frame holds the newest, with 2 two travel together.
    capacity
        room of each queue in bytes.
    frame_bytes
        what a frame holds, at least FRAME_LEAST.

    `waiting` is how many messages wait. Other attributes, all counts since construction:
        refused: messages dropped for lack of room, control telemetry included.
        replaced: poses dropped for a newer one.
        packed: messages handed out.
    """

    def __init__(
        self,
        *,
        poses: int = 1,
        capacity: Mapping[Priority, int] = CAPACITY_BYTES,
        frame_bytes: int = FRAME_BYTES,
    ) -> None:
        if poses < 1:
            raise ValueError(f"poses must be at least 1, not {poses}")
        if frame_bytes < FRAME_LEAST:
            raise ValueError(f"frame_bytes must be at least {FRAME_LEAST}, not {frame_bytes}")
        self.refused = 0
        self.replaced = 0
        self.packed = 0
        self._most_poses = poses
        self._capacity = [capacity[priority] for priority in Priority]
        self._frame_bytes = frame_bytes
        self.waiting = 0
        self._poses: deque[bytes] = deque()
        self._queues: list[deque[bytes]] = [deque() for _ in Priority]
        self._bytes = [0 for _ in Priority]
        self._pieces: list[deque[bytes]] = [deque() for _ in Priority]  # of the first message of each queue
        self._cut = 0

    @property
    def pose_waits(self) -> bool:
        """Whether a pose waits."""
        return bool(self._poses)

    def offer(self, message: bytes) -> bool:
        """Return true where the whole message was queued, False where it was dropped and counted."""
        size = len(message)
        number = message[7] | message[8] << 8 | message[9] << 16
        if number == _POSE and size <= self._frame_bytes:
            self._poses.append(message)
            self.waiting += 1
            if len(self._poses) > self._most_poses:
                self._poses.popleft()
                self.waiting -= 1
                self.replaced += 1
            return True
        priority = PRIORITIES.get(number, _UNKNOWN)
        queue = self._queues[priority]
        used = self._bytes[priority] + size
        room = self._capacity[priority]
        while used > room:
            self.refused += 1
            if priority is not Priority.CONTROL or not queue:
                return False
            used -= len(queue.popleft())
            self._pieces[priority].clear()
            self.waiting -= 1
        queue.append(message)
        self._bytes[priority] = used
        self.waiting += 1
        return True

    def take(self) -> bytes | None:
        """Return the next frame, None where nothing waits."""
        if not self.waiting:
            return None
        parts: list[bytes] = []
        room = self._frame_bytes
        poses = self._poses
        while poses and len(poses[0]) <= room:
            message = poses.popleft()
            room -= len(message)
            parts.append(message)
        for priority, queue in enumerate(self._queues):
            while queue and len(queue[0]) <= room:
                message = queue.popleft()
                size = len(message)
                self._bytes[priority] -= size
                room -= size
                parts.append(message)
            if queue and not parts:
                return self._take_piece(priority)
        self.waiting -= len(parts)
        self.packed += len(parts)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _take_piece(self, priority: int) -> bytes:
        """Return the next piece of the first message of a queue."""
        queue, pieces = self._queues[priority], self._pieces[priority]
        if not pieces:
            pieces.extend(cut(queue[0], self._cut, self._frame_bytes))
            self._cut += 1
        piece = pieces.popleft()
        if not pieces:
            self._bytes[priority] -= len(queue.popleft())
            self.waiting -= 1
            self.packed += 1
        return piece
