"""Timing of the flight processor's ticks: duration of the work, jitter, and missed ticks.

They are drawn in blocks, so that most ticks only compare a time. Statistics are computed when they are read.
"""

from __future__ import annotations

import math

import numpy as np

from trimtab.firmware_model.services.telemetry import LoopTimes
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.world import TimingSettings

_BLOCK = 1024
_BLOCK_US = _BLOCK * TICK_US


class TickTimes:
    """Work and jitter of the ticks of one flight, the first at time 0.

    If the work takes longer than a tick, the processor misses the ticks during it. `due_us` is the next time
    at which `missed` may return True; it need not be called before.
    """

    def __init__(self, settings: TimingSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._busy_until_us = 0
        self._missed: list[int] = []  # of this block, the latest first
        self._read_us = 0
        self._longest_us = self._sum_us = self._furthest_us = 0.0
        self._count = 0
        self._begin(0)

    def missed(self, now_us: int) -> bool:
        """Return whether the processor is still busy with an earlier tick at `now_us`, the time of a tick."""
        if now_us >= self._start_us + _BLOCK_US:
            self._fold(self._start_us + _BLOCK_US)
            self._begin(now_us)
        missed = self._missed
        result = missed[-1:] == [now_us]
        if result:
            missed.pop()
        self.due_us = missed[-1] if missed else self._start_us + _BLOCK_US
        return result

    def read(self, now_us: int) -> LoopTimes:
        """Return the loop times of the ticks since the last call and before `now_us`."""
        if now_us >= self.due_us:
            self.missed(now_us)
        self._fold(now_us)
        mean_us = self._sum_us / self._count if self._count else 0.0
        times = LoopTimes(math.ceil(self._longest_us), round(mean_us), math.ceil(self._furthest_us))
        self._longest_us = self._sum_us = self._furthest_us = 0.0
        self._count = 0
        return times

    def _begin(self, start_us: int) -> None:
        """Draw the block of ticks that starts at `start_us`."""
        s, rng = self._settings, self._rng
        self._start_us = start_us
        work = np.maximum(s.work_us + s.work_spread_us * rng.standard_normal(_BLOCK), 1.0)
        over = rng.random(_BLOCK) < s.overrun
        long = TICK_US + (s.overrun_us - TICK_US) * (1.0 - rng.random(_BLOCK))
        work[over] = long[over]
        late = s.jitter_us * rng.random(_BLOCK)
        self._work, self._late = work, late
        self._missed = []
        self._miss(start_us)
        for k in np.flatnonzero(work > TICK_US).tolist():
            t_us = start_us + k * TICK_US
            if t_us >= self._busy_until_us:
                self._busy_until_us = t_us + math.ceil(work[k])
                self._miss(t_us + TICK_US)
        self._missed.reverse()
        self.due_us = self._missed[-1] if self._missed else start_us + _BLOCK_US

    def _miss(self, from_us: int) -> None:
        """Mark the ticks of this block from `from_us` that fall into running work; they run after it."""
        end_us = -(-self._busy_until_us // TICK_US) * TICK_US
        for t_us in range(from_us, min(end_us, self._start_us + _BLOCK_US), TICK_US):
            k = (t_us - self._start_us) // TICK_US
            self._missed.append(t_us)
            self._work[k], self._late[k] = 0.0, end_us - t_us

    def _fold(self, until_us: int) -> None:
        """Add the unread ticks of this block before `until_us` to the statistics."""
        first = (max(self._read_us, self._start_us) - self._start_us) // TICK_US
        last = (until_us - self._start_us) // TICK_US
        if last <= first:
            return
        work = self._work[first:last]
        self._longest_us = max(self._longest_us, float(np.maximum.reduce(work)))
        self._sum_us += float(np.add.reduce(work))
        self._count += int(np.count_nonzero(work))
        self._furthest_us = max(self._furthest_us, float(np.maximum.reduce(self._late[first:last])))
        self._read_us = until_us
