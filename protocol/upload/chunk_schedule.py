"""Schedule of the chunks of an upload: selective repeat at the pace of the channel.

A chunk counts as lost once the vehicle holds a chunk that was sent at least `_REORDER` chunks later. Only
chunks that were sent once are evidence: for others it is unknown which copy arrived.

Chunks are sent at the pace of the channel, not as fast as the serial line accepts them. This keeps the
radio's queue short: a status soon reveals losses, and a repeated chunk does not wait behind others. On a link
that has lost a chunk, chunks in flight are repeated whenever the sender would otherwise wait: at the end of
the blob, and while no status arrives. Without these copies each loss among the last chunks would cost a round
trip, and after a burst of losses the sender would idle until its timeout.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import NamedTuple

from trimtab.protocol.upload.transfer import BITMAP_BYTES

_COPY_INTERVALS = 2
"""Least number of intervals between two copies of chunks in flight."""
_COPY_US = 20_000
"""Least time after which a chunk in flight is repeated."""
_QUIET_US = 60_000
"""Time without a status after which chunks in flight are repeated even before the end."""
_REORDER = 3
_RTT_FIRST_US = 100_000
_NEVER_US = 1 << 62


class _Flight(NamedTuple):
    """One chunk in flight.

    number: position in the order of sending. sent_us: time of the first copy. repeated: whether it was sent
    before. copy_us: time of the last copy.
    """

    number: int
    sent_us: int
    repeated: bool
    copy_us: int


class ChunkSchedule:
    """Schedules the chunks of one blob.

    chunks: number of chunks. window: greatest number in flight. interval_us: least time between two chunks.

    Attributes
    ----------
    held
        One byte for each chunk: 1 if the vehicle is known to hold it.
    repeated
        Number of chunks sent more than once.
    rtt_us
        Estimated round-trip time.
    """

    def __init__(self, chunks: int, *, window: int, interval_us: int) -> None:
        self.chunks = chunks
        self.held = bytearray(chunks)
        self.repeated = 0
        self.rtt_us = _RTT_FIRST_US
        self._window = window
        self._interval_us = interval_us
        self._next_us = 0
        self._base = 0  # all chunks below this index are held
        self._next = 0  # all chunks from this index on are unsent
        self._sent_once = bytearray(chunks)
        self._flight: dict[int, _Flight] = {}
        self._lost: list[int] = []
        self._number = 0

    def restart(self) -> None:
        """Schedule all chunks again: the vehicle holds none."""
        self.held = bytearray(self.chunks)
        self._flight.clear()
        self._lost.clear()
        self._base = self._next = 0

    def note_announcement(self) -> None:
        """Skip sequence numbers, so chunks sent before an announcement count as overtaken by later ones."""
        self._number += _REORDER

    def note_held(self, base: int, beyond: Iterable[int], now_us: int, *, complete: bool) -> bool:
        """Record which chunks the vehicle holds; return whether any of them is new.

        base: all chunks below it are held. beyond: further held indices. complete: no other chunk is held.
        """
        before, newest, progress = self.held, 0, False
        if complete:
            self.held, self._base = bytearray(self.chunks), 0
        for index in (*range(self._base, base), *beyond):
            if index >= self.chunks or self.held[index]:
                continue
            progress = progress or not before[index]
            self.held[index] = 1
            flight = self._flight.pop(index, None)
            if flight is not None and not flight.repeated:
                newest = max(newest, flight.number)
                self.rtt_us += (now_us - flight.sent_us - self.rtt_us) // 8
        self._base = max(self._base, base)
        if complete:
            for index in range(self._base, self._next):
                if before[index] and not self.held[index]:
                    heapq.heappush(self._lost, index)
        self._note_lost(newest - _REORDER, now_us - self.rtt_us - self.rtt_us // 2)
        return progress

    def due(self, now_us: int, status_us: int) -> list[int]:
        """Return the chunks to send now. status_us: time of the last status."""
        return self._next_chunks(now_us) or self._copies(now_us, status_us)

    def next_us(self, status_us: int) -> int:
        """Return the time at which the next chunk is due, or _NEVER_US."""
        may_send = not self._exhausted() and len(self._flight) < self._window
        return self._next_us if may_send else self._copy_due_us(status_us)

    def _note_lost(self, newest: int, oldest_us: int) -> None:
        """Mark chunks in flight as lost if they were sent up to number `newest` or before `oldest_us`."""
        overtaken = [i for i, f in self._flight.items() if f.number <= newest or f.sent_us < oldest_us]
        for index in overtaken:
            del self._flight[index]
            heapq.heappush(self._lost, index)

    def _next_chunks(self, now_us: int) -> list[int]:
        """Return the chunks to send now that are not in flight."""
        out: list[int] = []
        while len(self._flight) < self._window and now_us >= self._next_us:
            index = self._pick()
            if index is None:
                break
            self._number += 1
            repeated = bool(self._sent_once[index])
            self._flight[index] = _Flight(self._number, now_us, repeated, now_us)
            self.repeated += repeated
            self._sent_once[index] = 1
            out.append(index)
            self._pace(now_us, 1)
        return out

    def _copies(self, now_us: int, status_us: int) -> list[int]:
        """Return the chunk in flight with the oldest copy, if a copy is due."""
        if now_us < self._copy_due_us(status_us):
            return []
        index, flight = min(self._flight.items(), key=lambda item: item[1].copy_us)
        self._flight[index] = flight._replace(repeated=True, copy_us=now_us)
        self.repeated += 1
        self._pace(now_us, _COPY_INTERVALS)
        return [index]

    def _copy_due_us(self, status_us: int) -> int:
        """Return the time at which the next copy of a chunk in flight is due, or _NEVER_US."""
        if not self._flight or not self.repeated:
            return _NEVER_US
        quiet_us = 0 if self._exhausted() else status_us + _QUIET_US
        oldest_us = min(flight.copy_us for flight in self._flight.values())
        return max(self._next_us, oldest_us + _COPY_US, quiet_us)

    def _exhausted(self) -> bool:
        """Return whether every chunk is in flight or held."""
        return not self._lost and self._next >= self.chunks

    def _pace(self, now_us: int, intervals: int) -> None:
        """Schedule the next chunk `intervals` later; a late chunk does not delay it."""
        started_us = max(self._next_us, now_us - self._interval_us)
        self._next_us = started_us + intervals * self._interval_us

    def _pick(self) -> int | None:
        """Return the next chunk to send: lost chunks first, then new ones that a status can report."""
        while self._lost:
            index = heapq.heappop(self._lost)
            if not self.held[index] and index not in self._flight:
                return index
        while self._next < min(self.chunks, self._base + 8 * BITMAP_BYTES):
            index = self._next
            self._next += 1
            if not self.held[index] and index not in self._flight:
                return index
        return None
