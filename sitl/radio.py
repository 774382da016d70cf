"""The channel between the two radios: half-duplex slots on demand, burst loss, delay, corruption, cuts.

These are design choices, not measurements: no reliable figures for ultra-wideband telemetry on quadrotors
were found. The channel does not look into frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import chain
from typing import Protocol

import numpy as np

from trimtab.firmware_model.clock import NEVER_US
from trimtab.protocol.uwb_pieces import FRAME_BYTES
from trimtab.sitl.air_time import air_us
from trimtab.sitl.world import RadioSettings

_BLOCK = 1024
_FLIPS_MAX = 6


class Radio(Protocol):
    """Interface of a radio to the channel."""

    @property
    def has_frame(self) -> bool: ...
    @property
    def pose_waits(self) -> bool: ...
    def air_send(self, now_us: int) -> bytes | None: ...
    def air_receive(self, frame: bytes, now_us: int) -> None: ...


@dataclass
class DirectionCounts:
    """Counters of the frames of one direction."""

    sent: int = 0
    lost: int = 0
    cut: int = 0
    duplicated: int = 0
    corrupted: int = 0
    delivered: int = 0


class BurstLoss:
    """A Gilbert-Elliott chain with one step per frame: in its bad state, full frames are lost.

    Parameters
    ----------
    loss
        Long-run share of full frames lost.
    burst_frames
        Mean number of frames in a burst (bad state).
    short_risk
        Probability that a very short frame is lost in a burst.
    draw
        Returns the next uniform number in 0..1.
    """

    def __init__(
        self, loss: float, burst_frames: float, short_risk: float, draw: Callable[[], float]
    ) -> None:
        self._short_risk = short_risk
        self._leave = 1.0 / burst_frames
        self._enter = loss / (burst_frames * (1.0 - loss))
        self._draw = draw
        self._bad = draw() < loss

    def lost(self, size: int) -> bool:
        """Advance by one frame of `size` bytes. Return whether it is lost."""
        chance = self._draw()
        self._bad = chance >= self._leave if self._bad else chance < self._enter
        risk = self._short_risk + (1.0 - self._short_risk) * size / FRAME_BYTES
        return self._bad and self._draw() < risk


class _Direction:
    """One direction of the channel: source and target radio, random numbers, loss and counters."""

    def __init__(
        self, source: Radio, target: Radio, settings: RadioSettings, rng: np.random.Generator
    ) -> None:
        self.source = source
        self.target = target
        self.draw = _uniforms(rng).__next__
        self.loss = BurstLoss(settings.loss, settings.burst_frames, settings.short_risk, self.draw)
        self.counts = DirectionCounts()
        self.may_have = True  # whether the source may have a frame; False once it has none, until `wake`


class RadioChannel:
    """The channel between a ground and a vehicle radio.

    `due_us` is the time of the next slot that a radio may want, or of the next delivery. Call `wake` when a
    radio has something new to send. `watch`, if set, is called with time and bytes of every frame sent.

    Parameters
    ----------
    ground, vehicle
        The two radios.
    up_rng, down_rng
        Random numbers of the directions ground to vehicle and back.
    """

    def __init__(
        self,
        *,
        ground: Radio,
        vehicle: Radio,
        settings: RadioSettings,
        up_rng: np.random.Generator,
        down_rng: np.random.Generator,
    ) -> None:
        self._slot_length_us = settings.slot_us
        self._corrupt, self._duplicate = settings.corrupt, settings.duplicate
        self._bit_rate = settings.bit_rate
        self._latency_us, self._jitter_us = settings.latency_us, settings.jitter_us
        self._up = _Direction(ground, vehicle, settings, up_rng)
        self._down = _Direction(vehicle, ground, settings, down_rng)
        self._turn, self._other = self._up, self._down
        self._ahead = False  # whether the last slot was assigned out of turn
        self._slot_us = 0
        self._air: list[tuple[int, int, _Direction, bytes]] = []
        self._serial = 0
        self._cuts_us = [
            (round(start * 1e6), round((start + length) * 1e6)) for start, length in settings.cuts_s
        ]
        self.due_us = 0
        self.watch: Callable[[int, bytes], None] | None = None

    @property
    def up(self) -> DirectionCounts:
        """Counts from ground to vehicle."""
        return self._up.counts

    @property
    def down(self) -> DirectionCounts:
        """Counts from vehicle to ground."""
        return self._down.counts

    def wake(self, now_us: int, *, ground: bool) -> None:
        """Note that a radio may have something to send."""
        (self._up if ground else self._down).may_have = True
        soonest_us = self._slot_us if self._slot_us > now_us else now_us
        if soonest_us < self.due_us:
            self.due_us = soonest_us

    def tick(self, now_us: int) -> None:
        """Deliver the frames that are due, and assign a slot that is due."""
        air = self._air
        while air and air[0][0] <= now_us:
            _, _, direction, frame = heappop(air)
            direction.counts.delivered += 1
            direction.target.air_receive(frame, now_us)
        if now_us >= self._slot_us and (self._turn.may_have or self._other.may_have):
            self._give_slot(now_us)
        due_us = NEVER_US
        if self._turn.may_have or self._other.may_have:
            due_us = self._slot_us if self._slot_us > now_us else now_us + 1
        self.due_us = air[0][0] if air and air[0][0] < due_us else due_us

    def _give_slot(self, now_us: int) -> None:
        """Assign the slot to the radio whose turn it is or, if it has no frame, to the other.

        A waiting pose goes ahead of the other radio's turn, so it waits for one slot at most; the other radio
        keeps its turn. Two consecutive slots are never assigned out of turn, so the other radio gets at least
        every third slot.
        """
        follows = self._ahead and now_us <= self._slot_us
        ahead = not follows and self._other.source.pose_waits
        self._ahead = ahead
        for direction in (self._other, self._turn) if ahead else (self._turn, self._other):
            if not direction.may_have:
                continue
            frame = direction.source.air_send(now_us)
            if frame is None:
                direction.may_have = False
                continue
            self._slot_us = now_us + self._slot_length_us
            if direction is self._turn:
                self._turn, self._other = self._other, direction
            direction.may_have = direction.source.has_frame
            self._transmit(direction, frame, now_us)
            return

    def _transmit(self, direction: _Direction, frame: bytes, now_us: int) -> None:
        counts, draw, size = direction.counts, direction.draw, len(frame)
        counts.sent += 1
        if self.watch is not None:
            self.watch(now_us, frame)
        lost = direction.loss.lost(size)
        if self._cuts_us and any(start <= now_us < end for start, end in self._cuts_us):
            counts.cut += 1
            return
        if lost:
            counts.lost += 1
            return
        if draw() < self._corrupt * size / FRAME_BYTES:
            counts.corrupted += 1
            frame = _flip(frame, draw)
        copies = 1
        if draw() < self._duplicate:
            counts.duplicated += 1
            copies = 2
        rate = self._bit_rate
        duration_us = self._slot_length_us if rate is None else air_us(size, rate)
        arrival_us = now_us + duration_us + self._latency_us
        for _ in range(copies):
            self._serial += 1
            late_us = int(draw() * self._jitter_us)
            heappush(self._air, (arrival_us + late_us, self._serial, direction, frame))


def _flip(frame: bytes, draw: Callable[[], float]) -> bytes:
    """Return the frame with one to `_FLIPS_MAX` bits flipped."""
    damaged = bytearray(frame)
    for _ in range(1 + int(draw() * _FLIPS_MAX)):
        bit = int(draw() * 8 * len(damaged))
        damaged[bit >> 3] ^= 1 << (bit & 7)
    return bytes(damaged)


def _uniforms(rng: np.random.Generator) -> Iterator[float]:
    """Return uniform numbers in 0..1 without end, drawn in blocks."""
    blocks: Iterator[list[float]] = iter(lambda: rng.random(_BLOCK).tolist(), None)
    return chain.from_iterable(blocks)
