"""Which chunk of an upload leaves next, and when: selective repeat at the pace of the channel.

A chunk counts as lost once one that was sent at least `_REORDER` later is held. Only chunks that were sent
once show that: of others it is not known which copy arrived.

Chunks leave at the pace of the channel, not as fast as the line takes them. The radio's queue stays short: a
status soon shows what was lost, and a repeated chunk does not wait behind others. On a link that has lost
something, chunks under way are repeated whenever the sender could only wait: at the end of the blob, and
while no status comes. Otherwise each loss among the last chunks would cost a round trip, and a burst of
losses that spans a number of frames would last as long as the sender waits.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import NamedTuple

from trimtab.protocol.upload.transfer import BITMAP_BYTES

_COPY_INTERVALS = 2
"""Least number of intervals between two repetitions of chunks under way."""
_COPY_US = 20_000
"""Least time after which a chunk under way is repeated."""
_QUIET_US = 60_000
"""Time without a status after which chunks under way are repeated even before the end."""
_REORDER = 3
_RTT_FIRST_US = 100_000
_NEVER_US = 1 << 62


class _Flight(NamedTuple):
    """One chunk under way.

    number: position in the order of sending. sent_us: when it left. again: whether it left before. copy_us:
    when its last copy left.
    """

    number: int
    sent_us: int
    again: bool
    copy_us: int


class ChunkSchedule:
    """Schedules the chunks of one blob.

    chunks: their number. window: greatest number under way. interval_us: least time between two chunks.

    Attributes
    ----------
    held
        For each chunk a 1 if the vehicle is known to hold it.
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
        self._base = 0  # chunks below it are held
        self._next = 0  # chunks from it on were never sent
        self._sent_once = bytearray(chunks)
        self._flight: dict[int, _Flight] = {}
        self._lost: list[int] = []
        self._number = 0

    def restart(self) -> None:
        """Send everything again: the vehicle holds nothing."""
        self.held = bytearray(self.chunks)
        self._flight.clear()
        self._lost.clear()
        self._base = self._next = 0

    def note_question(self) -> None:
        """Leave a gap in the numbers: chunks sent before a question count as overtaken by those after it."""
        self._number += _REORDER

    def note_held(self, base: int, beyond: Iterable[int], now_us: int, *, complete: bool) -> bool:
        """Note which chunks the vehicle holds; return whether one of them is new.

        base: all below it are held. beyond: further indices. complete: no other chunk is held.
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
            if flight is not None and not flight.again:
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
        """Return the chunks to send now; status_us: time of the last status."""
        return self._fresh(now_us) or self._copies(now_us, status_us)

    def next_us(self, status_us: int) -> int:
        """Return when the next chunk is due; far in the future if none is."""
        may_send = not self._exhausted() and len(self._flight) < self._window
        return self._next_us if may_send else self._copy_due_us(status_us)

    def _note_lost(self, newest: int, oldest_us: int) -> None:
        """Take chunks under way as lost if they left before number `newest` or before `oldest_us`."""
        overtaken = [i for i, f in self._flight.items() if f.number <= newest or f.sent_us < oldest_us]
        for index in overtaken:
            del self._flight[index]
            heapq.heappush(self._lost, index)

    def _fresh(self, now_us: int) -> list[int]:
        """Return the chunks to send that are not under way."""
        out: list[int] = []
        while len(self._flight) < self._window and now_us >= self._next_us:
            index = self._pick()
            if index is None:
                break
            self._number += 1
            again = bool(self._sent_once[index])
            self._flight[index] = _Flight(self._number, now_us, again, now_us)
            self.repeated += again
            self._sent_once[index] = 1
            out.append(index)
            self._pace(now_us, 1)
        return out

    def _copies(self, now_us: int, status_us: int) -> list[int]:
        """Return the chunk under way that left longest ago, if it is time to repeat one."""
        if now_us < self._copy_due_us(status_us):
            return []
        index, flight = min(self._flight.items(), key=lambda item: item[1].copy_us)
        self._flight[index] = flight._replace(again=True, copy_us=now_us)
        self.repeated += 1
        self._pace(now_us, _COPY_INTERVALS)
        return [index]

    def _copy_due_us(self, status_us: int) -> int:
        """Return when the next chunk under way is repeated; far in the future if none is."""
        if not self._flight or not self.repeated:
            return _NEVER_US
        quiet_us = 0 if self._exhausted() else status_us + _QUIET_US
        oldest_us = min(flight.copy_us for flight in self._flight.values())
        return max(self._next_us, oldest_us + _COPY_US, quiet_us)

    def _exhausted(self) -> bool:
        """Return whether every chunk is under way or held."""
        return not self._lost and self._next >= self.chunks

    def _pace(self, now_us: int, intervals: int) -> None:
        """Schedule the next chunk `intervals` later; a late chunk does not delay it."""
        started_us = max(self._next_us, now_us - self._interval_us)
        self._next_us = started_us + intervals * self._interval_us

    def _pick(self) -> int | None:
        """Return the next chunk to send: lost ones first, then new ones that a status can still report."""
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
