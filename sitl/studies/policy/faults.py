"""Faults of the link and of the cameras in a sequence."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from random import Random
from typing import NamedTuple

from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import CAMERAS, AttPosMocap, Message, Station
from trimtab.protocol.telemetry import TICK_US

OUTLIER_M = 8.0
"""Distance of an outlier; a pose is refused from EST_JUMP_M and the speed EST_JUMP_SPEED on."""
REPEATED_M = 0.25
"""Height below which a repetition of the last pose is plausible: the vehicle may stand still."""


MISPLACED_M = 0.05
"""Distance from the true position beyond which a repeated pose is wrong, if the vehicle uses it."""


class Delivery(NamedTuple):
    """A message that reaches the vehicle: the station that sent it, the message, and its bytes."""

    station: Station
    message: Message
    data: bytes


class Link:
    """The way of the stations' messages to the vehicle.

    Attributes
    ----------
    silent, loss, twice, delay_us
        Whether nothing arrives, the share of messages that is lost and that arrives twice, and the delay.
    """

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._codecs: dict[Station, Codec] = {}
        self._waiting: list[tuple[int, int, Delivery]] = []
        self._count = 0
        self.repair()

    def repair(self) -> None:
        """End all faults."""
        self.silent, self.loss, self.twice, self.delay_us = False, 0.0, 0.0, 0

    def send(self, station: Station, message: Message, now_us: int) -> None:
        """Send a message of a station."""
        codec = self._codecs.get(station)
        if codec is None:
            codec = self._codecs[station] = Codec(*station)
        if self.silent or self._rng.random() < self.loss:
            return
        delivery = Delivery(station, message, codec.encode(message))
        for _ in range(1 + (self._rng.random() < self.twice)):
            self._count += 1
            heapq.heappush(self._waiting, (now_us + self.delay_us, self._count, delivery))

    def due(self, now_us: int) -> Iterator[Delivery]:
        """Yield the messages that arrive by now."""
        while self._waiting and self._waiting[0][0] <= now_us:
            yield heapq.heappop(self._waiting)[2]


@dataclass(kw_only=True)
class Cameras:
    """The way of the poses to the vehicle.

    Attributes
    ----------
    lost, loss, delay_us
        Whether no pose arrives, the share that is lost, and the delay.
    frozen
        Whether the last pose is repeated.
    outliers
        Share of poses that are far away.
    offset
        Displacement of every pose, as of another rigid body; None for true poses.
    pose_us
        Time of the last pose that the vehicle may use.
    wrong_us, misplaced_us
        Time of the last displaced pose, and of the last repeated one after the vehicle has moved.
    """

    rng: Random
    lost: bool = False
    loss: float = 0.0
    delay_us: int = 0
    frozen: bool = False
    outliers: float = 0.0
    offset: tuple[float, float, float] | None = None
    pose_us: int = 0
    wrong_us: int = -(10**9)
    misplaced_us: int = -(10**9)
    _codec: Codec = field(default_factory=lambda: Codec(*CAMERAS))
    _waiting: list[tuple[int, bytes, bool]] = field(default_factory=list)
    _last: AttPosMocap | None = None

    def repair(self) -> None:
        """End all faults."""
        self.lost, self.loss, self.delay_us, self.frozen, self.outliers = False, 0.0, 0, False, 0.0
        self.offset = None

    def take(self, datagram: bytes, now_us: int, height_m: float) -> None:
        """Take a pose of the camera system."""
        usable = True
        if self.lost or self.rng.random() < self.loss:
            return
        if self.frozen or self.outliers or self.offset is not None:
            (pose,) = self._codec.decode(datagram)
            assert isinstance(pose, AttPosMocap)
            place = (pose.x, pose.y, pose.z)
            q = list(pose.q)
            if self.frozen:
                usable = self._last is None or height_m < REPEATED_M  # the first is still a true one
                self._last = self._last or pose
                place, q = (self._last.x, self._last.y, self._last.z), list(self._last.q)
                if math.dist(place, (pose.x, pose.y, pose.z)) > MISPLACED_M:
                    self.misplaced_us = now_us
            elif self.offset is not None:
                dx, dy, dz = self.offset
                place = (place[0] + dx, place[1] + dy, place[2] + dz)
                self.wrong_us = now_us
            elif self.rng.random() < self.outliers:
                place, usable = (place[0] + OUTLIER_M, place[1], place[2]), False
            datagram = self._codec.encode(m.AttPosMocap(pose.time_usec, q, place[0], place[1], place[2]))
        if not self.frozen:
            self._last = None
        self._waiting.append((now_us + self.delay_us, datagram, usable))

    def due(self, now_us: int) -> Iterator[bytes]:
        """Yield the poses that arrive by now."""
        waiting = self._waiting
        while waiting and waiting[0][0] <= now_us:
            at_us, datagram, usable = waiting.pop(0)
            if usable:
                self.pose_us = max(self.pose_us, at_us + TICK_US)
            yield datagram
