"""Pack MAVLink 2 messages into radio frames of 116 B.

Several complete messages share a frame. A message longer than a frame is split into pieces, one for each
frame; the other radio reassembles them (`uwb_pieces`). Payloads are not decoded: id, length and checksum are
sufficient.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import IntEnum

from trimtab.protocol.generated.frames import MESSAGES
from trimtab.protocol.uwb_pieces import FRAME_BYTES, FRAME_BYTES_MIN, split_message


class Priority(IntEnum):
    """Priority classes of messages, the most urgent first."""

    URGENT = 0
    FAST_TELEMETRY = 1
    STATUS = 2
    UPLOAD = 3


_URGENT = (
    *("ATT_POS_MOCAP", "TIMESYNC", "COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK"),
    # A client streams setpoints before it commands OFFBOARD: the command must not overtake them.
    *("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET"),
)
_FAST_TELEMETRY = ("FC_CONTROL", "FC_ESTIMATE", "FC_OBSERVER", "FC_ROTORS")
_BULK = ("UPLOAD_", "FILE_TRANSFER_PROTOCOL")


def _priority(name: str) -> Priority:
    if name in _URGENT:
        return Priority.URGENT
    if name in _FAST_TELEMETRY:
        return Priority.FAST_TELEMETRY
    return Priority.UPLOAD if name.startswith(_BULK) else Priority.STATUS


PRIORITIES: dict[int, Priority] = {number: _priority(name) for number, (name, _, _) in MESSAGES.items()}
"""Priority of each message by id."""
_PRIORITIES_IN_ORDER = {
    number: priority if priority is Priority.FAST_TELEMETRY else Priority.STATUS
    for number, priority in PRIORITIES.items()
}
_UNKNOWN = Priority.STATUS

CAPACITY_BYTES: Mapping[Priority, int] = {
    Priority.URGENT: 1024,
    Priority.FAST_TELEMETRY: 512,
    Priority.STATUS: 4096,
    Priority.UPLOAD: 4096,
}
"""Capacity of each queue."""

POSE_SENDERS_MAX = 4
"""Number of senders whose poses may wait at the same time."""

_POSE = next(number for number, (name, _, _) in MESSAGES.items() if name == "ATT_POS_MOCAP")


class FramePacker:
    """Packs complete messages into radio frames by priority, in order of arrival within each class.

    Poses have precedence over all other messages. At most `poses` of each sender wait: a newer pose replaces
    its sender's oldest. If a queue is full, the queue FAST_TELEMETRY drops its oldest message; every other
    class refuses the new one. A message longer than a frame is sent in pieces, one for each frame, when no
    more urgent message waits. More urgent messages may go out between the pieces.

    Parameters
    ----------
    poses
        Greatest number of waiting poses of a sender. With 1, a frame holds its newest pose; with 2, two.
    capacity
        Capacity of each queue in bytes.
    frame_bytes
        Payload of a frame, at least FRAME_BYTES_MIN.
    in_order
        Whether all messages except FAST_TELEMETRY share the class STATUS, so that none overtakes another.

    Attributes
    ----------
    poses
        Poses that wait, oldest first.
    waiting
        Number of waiting messages, including poses.
    refused
        Number of messages dropped because a queue was full, including FAST_TELEMETRY.
    replaced
        Number of poses that a newer pose replaced.
    packed
        Number of messages packed into frames.
    """

    def __init__(
        self,
        *,
        poses: int = 1,
        capacity: Mapping[Priority, int] = CAPACITY_BYTES,
        frame_bytes: int = FRAME_BYTES,
        in_order: bool = False,
    ) -> None:
        if poses < 1:
            raise ValueError(f"poses must be at least 1, not {poses}")
        if frame_bytes < FRAME_BYTES_MIN:
            raise ValueError(f"frame_bytes must be at least {FRAME_BYTES_MIN}, not {frame_bytes}")
        self.refused = 0
        self.replaced = 0
        self.packed = 0
        self._poses_max = poses
        self._priorities = _PRIORITIES_IN_ORDER if in_order else PRIORITIES
        self._capacity = [capacity[priority] for priority in Priority]
        self._frame_bytes = frame_bytes
        self.waiting = 0
        self.poses: deque[bytes] = deque()
        self._queues: list[deque[bytes]] = [deque() for _ in Priority]
        self._bytes = [0 for _ in Priority]
        self._pieces: list[deque[bytes]] = [deque() for _ in Priority]  # of the first message of each queue
        self._split_count = 0

    def offer(self, message: bytes) -> bool:
        """Queue the message; return False if it was dropped and counted."""
        size = len(message)
        number = message[7] | message[8] << 8 | message[9] << 16
        if number == _POSE and size <= self._frame_bytes:
            self._offer_pose(message)
            return True
        priority = self._priorities.get(number, _UNKNOWN)
        queue = self._queues[priority]
        used = self._bytes[priority] + size
        room = self._capacity[priority]
        while used > room:
            self.refused += 1
            if priority is not Priority.FAST_TELEMETRY or not queue:
                return False
            used -= len(queue.popleft())
            self._pieces[priority].clear()
            self.waiting -= 1
        queue.append(message)
        self._bytes[priority] = used
        self.waiting += 1
        return True

    def _offer_pose(self, message: bytes) -> None:
        """Queue a pose; drop the oldest of its sender, or of all senders, if too many wait."""
        poses = self.poses
        poses.append(message)
        self.waiting += 1
        if len(poses) == 1:
            return
        sender = message[5:7]
        own = [pose for pose in poses if pose[5:7] == sender]
        if len(own) > self._poses_max:
            poses.remove(own[0])
        elif len(poses) > POSE_SENDERS_MAX * self._poses_max:
            poses.popleft()
        else:
            return
        self.waiting -= 1
        self.replaced += 1

    def take(self) -> bytes | None:
        """Return the next frame, or None if no message is waiting."""
        if not self.waiting:
            return None
        parts: list[bytes] = []
        room = self._frame_bytes
        poses = self.poses
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
        """Return the next piece of the first message in a queue."""
        queue, pieces = self._queues[priority], self._pieces[priority]
        if not pieces:
            pieces.extend(split_message(queue[0], self._split_count, self._frame_bytes))
            self._split_count += 1
        piece = pieces.popleft()
        if not pieces:
            self._bytes[priority] -= len(queue.popleft())
            self.waiting -= 1
            self.packed += 1
        return piece
