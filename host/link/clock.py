"""How far another clock is from the host's, from messages that take an unknown time."""

from __future__ import annotations

import math
from collections import deque

from trimtab.protocol.telemetry import TICK_US

BUCKET_US = 1_000_000
BUCKETS = 30
"""The least delay is looked for in the last so many seconds: drift stays below a microsecond a bucket."""
STEP_US = 5_000
"""A delay so much below the least one seen is none: the other clock was set or stood still."""
CAMERA_AHEAD_US = 50_000
"""No pose arrives so much sooner than the soonest did: its stamp is wrong, or the cameras' clock was set."""
CAMERA_AGREE_US = 1_000_000
CAMERA_AGREEING = 5
"""So many poses in a row whose stamps are wrong alike are a clock that was set."""
_STAMP_MAX_US = 1 << 62
_SETTLED = 20
_BEST = 8


class LeastDelay:
    """The smallest of the values seen in the last `BUCKETS` seconds.

    One message in hundreds that is a tick quicker than any other says more of chance than of the way.
    """

    def __init__(self) -> None:
        self._buckets: deque[tuple[int, float]] = deque(maxlen=BUCKETS)
        self.value: float = math.inf
        self.samples = 0

    def add(self, value: float, now_us: int) -> bool:
        """Whether the value was below the least one by a step; everything before it is then forgotten."""
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
            self.value = min(least for _, least in buckets)
        self.value = min(self.value, value)
        return stepped

    @property
    def usual(self) -> float:
        """The mean of every second's least value, of those within a tick of the least of all; infinite before
        the first one.
        """
        near = [least for _, least in self._buckets if least <= self.value + TICK_US]
        return sum(near) / len(near) if near else self.value

    def clear(self) -> None:
        """Forgets everything."""
        self._buckets.clear()
        self.value = math.inf
        self.samples = 0


class ClockSync:
    """Offset of a vehicle's clock against the host's, from TIMESYNC exchanges.

    Each way's least delay is looked for on its own, so that a quick way up and a quick way down need not fall
    into one exchange. What remains is half the difference of the two least delays, each as it usually comes
    (a stamp says which tick, not when in it): a link of equal slots both ways has next to none.

    Attributes
    ----------
    offset_us
        vehicle clock minus host clock; 0 before the first exchange.
    exchanges
        answers taken. rtt_us: round trip, smoothed. rtts_us: the last 10,000 round trips.
    steps
        how often the other clock jumped and the comparison began anew.
    """

    def __init__(self) -> None:
        self.offset_us = 0.0
        self.exchanges = 0
        self.steps = 0
        self.rtt_us = 0.0
        self.rtts_us: deque[int] = deque(maxlen=10_000)
        self._up = LeastDelay()
        self._down = LeastDelay()
        self._recent: deque[tuple[int, int]] = deque(maxlen=100)

    @property
    def settled(self) -> bool:
        """Whether ten exchanges have been seen since the start or the last step."""
        return self._up.samples >= 10

    @property
    def sd_us(self) -> float:
        """Standard deviation of the offset, from how closely the best exchanges of each way agree."""
        if len(self._recent) < 2:
            return 0.5 * self.rtt_us
        spread = 0.0
        for way in range(2):
            best = sorted([pair[way] for pair in self._recent])[:_BEST]
            mean = sum(best) / len(best)
            spread += sum((value - mean) ** 2 for value in best) / (len(best) - 1)
        return 0.5 * math.sqrt(spread)

    def answer(self, sent_us: int, vehicle_us: int, now_us: int) -> None:
        """Take an answer: when it was asked (host), the vehicle's clock, when it arrived (host)."""
        rtt_us = now_us - sent_us
        if rtt_us < 0 or rtt_us > 5_000_000:
            return
        up, down = vehicle_us - sent_us, now_us - vehicle_us
        self.exchanges += 1
        self.rtts_us.append(rtt_us)
        self.rtt_us += (rtt_us - self.rtt_us) / min(self.exchanges, 16)
        # There and back in less than no time.
        if min(up + self._down.value, down + self._up.value) < -STEP_US:
            self._begin_anew(self._up, self._down)
        if self._up.add(up, now_us):
            self._begin_anew(self._down)
        if self._down.add(down, now_us):
            self._begin_anew(self._up)
            self._up.add(up, now_us)
        self.offset_us = 0.5 * (self._up.usual - self._down.usual)
        self._recent.append((up, down))

    def _begin_anew(self, *ways: LeastDelay) -> None:
        """Forget what these ways were compared by: the other clock jumped."""
        self.steps += 1
        self._recent.clear()
        for way in ways:
            way.clear()


class CameraClock:
    """Offset of the camera system's clock against the host's, from nothing but when its poses arrive.

    Parameters
    ----------
    delay_us
        the least time from exposure to arrival, as the maker states it; None: one clock, offset 0.
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
        """Whether the stamp of a pose that has just arrived is believed: newer than the last and possible.

        Where a delay was stated, CAMERA_AGREEING poses in a row whose stamps are wrong alike say that the
        cameras' clock was set: the comparison begins anew with the last of them.
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
        """Whether this wrong stamp is one too many for a mistake; a pose that came twice or late is none."""
        if self._delay_us is None or stamp_us > _STAMP_MAX_US or abs(late_us - least_us) <= CAMERA_AHEAD_US:
            return False
        last_us, last_late_us = self._wrong
        agrees = stamp_us > last_us and abs(late_us - last_late_us) <= CAMERA_AGREE_US
        self._wrong = (stamp_us, late_us)
        self._agreeing = self._agreeing + 1 if agrees else 1
        return self._agreeing >= CAMERA_AGREEING

    def clear(self) -> None:
        """Forgets the comparison: the host's clock against the vehicle's has jumped."""
        self._late.clear()
