"""Poses on their way into the law: what is believed, one a tick, oldest first."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence

AGE_MAX_US = 200_000
AHEAD_US = 5_000
"""How far in the future a stamp may lie: clocks are compared over a radio."""
FARTHEST = 1e4
"""m from the origin."""
WAITING = 4

Pose = tuple[int, Sequence[float], Sequence[float]]
"""Time of measurement on the vehicle's clock (us), p (NED), q_ned_frd (w first, of length 1)."""


class PoseInput:
    """Keeps the engine's mocap blocks.

    `measured_us` is when the newest pose handed on was measured, None before the first; `used` counts them.
    `newest_us` is when the newest one believed was measured, handed on or waiting.
    """

    def __init__(self, inputs: Mapping[str, memoryview[float]]) -> None:
        self.waiting: deque[Pose] = deque(maxlen=WAITING)
        self.measured_us: int | None = None
        self.used = 0
        self.newest_us = -1
        self._last: tuple[float, ...] = ()  # numbers of the pose offered last
        self._oldest_us = 0
        self._new, self._p, self._q = inputs["mocap_new"], inputs["mocap_p"], inputs["mocap_q"]
        self._age, self._interval = inputs["mocap_age_s"], inputs["mocap_interval_s"]

    def repeats(self, p: Sequence[float], q: Sequence[float]) -> bool:
        """Whether the pose that is being offered has the numbers of the one before it, to the bit."""
        last, self._last = self._last, (*p, *q)
        return self._last == last

    def offer(self, time_us: int, p: Sequence[float], q: Sequence[float], now_us: int) -> bool:
        """Whether the pose waits for a tick now: newer than the last one, recent, of sane numbers."""
        length = math.hypot(*q)
        if (
            time_us <= self.newest_us
            or not -AHEAD_US <= now_us - time_us <= AGE_MAX_US
            or not 0.9 < length < 1.1
            or not math.hypot(*p) < FARTHEST
        ):
            return False
        self.newest_us = time_us
        self.waiting.append((time_us, tuple(p), tuple(x / length for x in q)))
        return True

    def take(self) -> tuple[Pose, int | None]:
        """Return the oldest that waits, and the time of measurement of the one before it."""
        pose = self.waiting.popleft()
        before, self.measured_us = self.measured_us, pose[0]
        self.used += 1
        return pose, before

    def oldest_us(self, now_us: int) -> int | None:
        """Greatest age of the newest pose used since the last call; None before the first pose."""
        if self.measured_us is None:
            return None
        oldest_us, self._oldest_us = max(self._oldest_us, now_us - self.measured_us), 0
        return oldest_us

    def show(self, pose: Pose, before_us: int, now_us: int) -> None:
        """Let the law correct its estimate by this pose, until `hide`."""
        time_us, p, q = pose
        if now_us - before_us > self._oldest_us:
            self._oldest_us = now_us - before_us
        self._p[0], self._p[1], self._p[2] = p
        self._q[0], self._q[1], self._q[2], self._q[3] = q
        self._age[0] = max(0, now_us - time_us) * 1e-6
        self._interval[0] = (time_us - before_us) * 1e-6
        self._new[0] = 1.0

    def hide(self) -> None:
        """Let the law predict only."""
        self._new[0] = 0.0
