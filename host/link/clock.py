"""Offsets of other clocks against the host's, from messages with unknown delays."""

from __future__ import annotations

import math
from collections import deque
from statistics import median

from trimtab.protocol.telemetry import TICK_US

BUCKET_US = 1_000_000
BUCKETS = 30
"""Window of the minimum delay, in buckets of one second. Clock drift stays below 1 us per bucket."""
STEP_US = 5_000
"""A delay that is below the minimum by more than this means that the other clock was set or stood still."""
CAMERA_AHEAD_US = 50_000
"""A pose that arrives earlier than the minimum delay by more than this has a wrong stamp, or the camera
clock was set.
"""
CAMERA_AGREE_US = 1_000_000
CAMERA_AGREEING = 5
"""This many poses in a row with the same stamp error (within CAMERA_AGREE_US) mean that the clock was set."""
_STAMP_MAX_US = 1 << 62
_SETTLED = 20
_BEST = 8


class LeastDelay:
    """Minimum of the values of the last `BUCKETS` seconds.

    A single message in hundreds may be one tick faster than all others by chance. `usual` averages over that.
    """

    def __init__(self) -> None:
        self._buckets: deque[tuple[int, float]] = deque(maxlen=BUCKETS)
        self.value: float = math.inf
        self.samples = 0

    def add(self, value: float, now_us: int) -> bool:
        """Add a value. Return whether it was a step below the minimum, which discards all earlier values."""
        stepped = self.samples >= _SETTLED and value < self.value - STEP_US
        if stepped:
            self.clear()
        self.samples += 1
        number = now_us // BUCKET_US
        buckets = self._buckets
        if buckets and buckets[-1][0] == number:
            if value < buckets[-1][1]:
                buckets[-1] = (number, value)
        else:
            buckets.append((number, value))
            while buckets[0][0] <= number - BUCKETS:
                buckets.popleft()
            self.value = min(smallest for _, smallest in buckets)
        self.value = min(self.value, value)
        return stepped

    @property
    def usual(self) -> float:
        """Mean of the bucket minima within one tick of the minimum; infinite before the first value."""
        near = [smallest for _, smallest in self._buckets if smallest <= self.value + TICK_US]
        return sum(near) / len(near) if near else self.value

    def clear(self) -> None:
        """Discard all values."""
        self._buckets.clear()
        self.value = math.inf
        self.samples = 0


class ClockSync:
    """Offset of a vehicle's clock against the host's, from TIMESYNC exchanges.

    The minimum delay is tracked for each direction separately, so the fastest uplink and the fastest downlink
    message need not belong to the same exchange. The remaining error is half the difference of the two
    minimum delays. Each is averaged over buckets, because a stamp has the resolution of a tick. The error is
    close to zero on a link with equal slots in both directions.

    Attributes
    ----------
    offset_us
        Vehicle clock minus host clock; 0 before the first exchange.
    exchanges
        Number of answers used.
    rtt_us
        Smoothed round-trip time.
    rtts_us
        The last 10,000 round-trip times.
    steps
        How often the vehicle's clock jumped and the comparison was restarted.
    """

    def __init__(self) -> None:
        self.offset_us = 0.0
        self.exchanges = 0
        self.steps = 0
        self.rtt_us = 0.0
        self.rtts_us: deque[int] = deque(maxlen=10_000)
        self._up = LeastDelay()
        self._down = LeastDelay()
        self._recent: tuple[deque[int], deque[int]] = (deque(maxlen=100), deque(maxlen=100))  # up, down

    @property
    def settled(self) -> bool:
        """Whether ten exchanges were used since the start or the last step."""
        return self._up.samples >= 10

    @property
    def sd_us(self) -> float:
        """Standard deviation of the offset, from the spread of the fastest messages in each direction."""
        if len(self._recent[0]) < 2:
            return 0.5 * self.rtt_us
        spread = 0.0
        for way in self._recent:
            best = sorted(way)[:_BEST]
            mean = sum(best) / len(best)
            spread += sum((value - mean) ** 2 for value in best) / (len(best) - 1)
        return 0.5 * math.sqrt(spread)

    @property
    def uplink_us(self) -> float:
        """Median time from the host's port to the vehicle over the last exchanges; 0 before the first."""
        up, _ = self._recent
        return max(0.0, median(up) - self.offset_us) if up else 0.0

    def answer(self, sent_us: int, vehicle_us: int, now_us: int) -> None:
        """Use an answer: time of request (host), of answer (vehicle clock) and of arrival (host)."""
        rtt_us = now_us - sent_us
        if rtt_us < 0 or rtt_us > 5_000_000:
            return
        up, down = vehicle_us - sent_us, now_us - vehicle_us
        self.exchanges += 1
        self.rtts_us.append(rtt_us)
        self.rtt_us += (rtt_us - self.rtt_us) / min(self.exchanges, 16)
        # A negative round trip: one of the clocks jumped.
        if min(up + self._down.value, down + self._up.value) < -STEP_US:
            self._begin_anew(self._up, self._down)
        if self._up.add(up, now_us):
            self._begin_anew(self._down)
        if self._down.add(down, now_us):
            self._begin_anew(self._up)
            self._up.add(up, now_us)
        self.offset_us = 0.5 * (self._up.usual - self._down.usual)
        self._recent[0].append(up)
        self._recent[1].append(down)

    def _begin_anew(self, *ways: LeastDelay) -> None:
        """Restart the comparison of these directions after the other clock jumped."""
        self.steps += 1
        for recent in self._recent:
            recent.clear()
        for way in ways:
            way.clear()


class CameraClock:
    """Offset of the camera system's clock against the host's, from the arrival times of poses alone.

    Parameters
    ----------
    delay_us
        Minimum time from exposure to arrival, as the manufacturer states it. None: host and cameras share a
        clock, and the offset is 0.
    """

    def __init__(self, delay_us: int | None) -> None:
        self._delay_us = delay_us
        self._late = LeastDelay()
        self._newest_us = -1
        self._wrong = (0, 0)
        self._agreeing = 0

    @property
    def offset_us(self) -> float:
        """Camera clock minus host clock."""
        if self._delay_us is None or not self._late.samples:
            return 0.0
        return self._delay_us - self._late.value

    def pose(self, stamp_us: int, now_us: int) -> bool:
        """Return whether the stamp of a new pose is valid: newer than the last one and not impossibly early.

        If a delay was given, CAMERA_AGREEING consecutive poses with the same stamp error mean that the camera
        clock was set. The comparison then restarts with the last of them.
        """
        late_us, newer = now_us - stamp_us, stamp_us > self._newest_us
        least_us = 0 if self._delay_us is None else self._late.value if self._late.samples else -math.inf
        if not newer or late_us < least_us - CAMERA_AHEAD_US or stamp_us > _STAMP_MAX_US:
            if not self._was_set(stamp_us, late_us, least_us):
                return False
            self._late.clear()
        self._newest_us = stamp_us
        self._agreeing = 0
        if self._delay_us is not None:
            self._late.add(late_us, now_us)
        return True

    def _was_set(self, stamp_us: int, late_us: int, least_us: float) -> bool:
        """Return whether the camera clock was set, given one more invalid stamp.

        A repeated or late pose does not count.
        """
        if self._delay_us is None or stamp_us > _STAMP_MAX_US or abs(late_us - least_us) <= CAMERA_AHEAD_US:
            return False
        last_us, last_late_us = self._wrong
        agrees = stamp_us > last_us and abs(late_us - last_late_us) <= CAMERA_AGREE_US
        self._wrong = (stamp_us, late_us)
        self._agreeing = self._agreeing + 1 if agrees else 1
        return self._agreeing >= CAMERA_AGREEING

    def clear(self) -> None:
        """Discard the comparison, because the offset between host and vehicle clock has jumped."""
        self._late.clear()
