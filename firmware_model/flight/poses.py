"""Queue of poses for the estimator: plausibility checks, one pose per tick, oldest first."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence

AGE_MAX_US = 150_000
"""Greatest age of a pose. With older ones the estimate of a vehicle in motion swings and does not settle: it
is extrapolated back to the time of the pose with constant acceleration.
"""
AHEAD_US = 5_000
"""Greatest time by which a stamp may lie in the future: clocks are compared over a radio."""
DISTANCE_MAX = 1e4
"""Greatest distance from the origin, m."""
QUEUE_SIZE = 4
CLASH_US = 250_000
"""Time within which EST_CLASH poses that contradict accepted ones show two sources of poses."""

Pose = tuple[int, Sequence[float], Sequence[float]]
"""Time of measurement on the vehicle's clock (us), p (NED), q_ned_frd (w first, unit length)."""


class PoseInput:
    """Queues poses and writes the engine's mocap blocks.

    Attributes
    ----------
    measured_us
        Time of measurement of the newest pose passed to the estimator; None before the first.
    used
        Number of poses passed to the estimator.
    newest_us
        Time of measurement of the newest accepted pose, used or waiting.
    """

    def __init__(self, inputs: Mapping[str, memoryview[float]]) -> None:
        self.waiting: deque[Pose] = deque(maxlen=QUEUE_SIZE)
        self.measured_us: int | None = None
        self.used = 0
        self.newest_us = -1
        self._last: tuple[float, ...] = ()  # last pose offered
        self._oldest_us = 0
        self._new, self._p, self._q = inputs["mocap_new"], inputs["mocap_p"], inputs["mocap_q"]
        self._age, self._interval = inputs["mocap_age_s"], inputs["mocap_interval_s"]

    def restart(self) -> None:
        """Forget all poses, those that wait too."""
        self.waiting.clear()
        self.measured_us, self.newest_us = None, -1

    def repeats(self, p: Sequence[float], q: Sequence[float]) -> bool:
        """Return whether an offered pose is identical to the previous one."""
        last, self._last = self._last, (*p, *q)
        return self._last == last

    def offer(self, time_us: int, p: Sequence[float], q: Sequence[float], now_us: int) -> bool:
        """Queue a pose; return False unless it is newer than the last one, recent and plausible."""
        length = math.hypot(*q)
        if (
            time_us <= self.newest_us
            or not -AHEAD_US <= now_us - time_us <= AGE_MAX_US
            or not 0.9 < length < 1.1
            or not math.hypot(*p) < DISTANCE_MAX
        ):
            return False
        self.newest_us = time_us
        w, x, y, z = q
        self.waiting.append((time_us, tuple(p), (w / length, x / length, y / length, z / length)))
        return True

    def take(self) -> tuple[Pose, int | None]:
        """Return the oldest waiting pose, and the time of measurement of the pose before it."""
        pose = self.waiting.popleft()
        previous_us, self.measured_us = self.measured_us, pose[0]
        self.used += 1
        return pose, previous_us

    def oldest_us(self, now_us: int) -> int | None:
        """Return the greatest age of the newest pose used since the last call; None before the first pose."""
        if self.measured_us is None:
            return None
        oldest_us, self._oldest_us = max(self._oldest_us, now_us - self.measured_us), 0
        return oldest_us

    def show(self, pose: Pose, before_us: int, now_us: int) -> None:
        """Write this pose to the engine's inputs, where it corrects the estimate until `hide`."""
        time_us, p, q = pose
        if now_us - before_us > self._oldest_us:
            self._oldest_us = now_us - before_us
        self._p[0], self._p[1], self._p[2] = p
        self._q[0], self._q[1], self._q[2], self._q[3] = q
        self._age[0] = max(0, now_us - time_us) * 1e-6
        self._interval[0] = (time_us - before_us) * 1e-6
        self._new[0] = 1.0

    def hide(self) -> None:
        """Remove the pose from the engine's inputs: the estimator only predicts."""
        self._new[0] = 0.0


class ClashDetector:
    """Detects that poses come from two sources: rejected ones keep alternating with accepted ones.

    A camera system that loses the vehicle sends wrong poses one after the other; two sources alternate.

    Attributes
    ----------
    found
        Whether two sources were detected, until `reset`.
    """

    def __init__(self) -> None:
        self.found = False
        self._clashes_us: deque[int] = deque()
        self._accepted = False

    def reset(self) -> None:
        """Forget what was detected."""
        self.found = False
        self._clashes_us.clear()

    def update(self, accepted: bool, now_us: int, count: int) -> None:
        """Take the verdict on a pose.

        count: number of rejected poses after accepted ones, within CLASH_US, that shows them; 0 for never.
        """
        clash, self._accepted = self._accepted and not accepted, accepted
        if not clash or not count or self.found:
            return
        clashes = self._clashes_us
        clashes.append(now_us)
        while now_us - clashes[0] > CLASH_US:
            clashes.popleft()
        self.found = len(clashes) >= count
