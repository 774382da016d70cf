"""Lateness of what must keep pace with the wall clock, and the lines that tell of it while it lasts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

LATE_US = 5_000
"""Lateness that counts: half the time between two poses at 100 Hz."""
_LONG_US = 50_000
"""Lateness that is told of even if it is the only one: five poses."""
_OFTEN = 5
"""Delays within _WINDOW_US from which on time runs late. A computer that is idle has one now and then."""
_WINDOW_US = 2_000_000
"""Also the time without a delay after which it is over."""
_REPEAT_US = 5_000_000
"""Time between two lines while it lasts."""


class Lateness:
    """Tells when time begins to run late, every few seconds while it does, and once when it is over.

    Parameters
    ----------
    subject
        Subject and verb of the lines, such as "poses arrive".
    remedy
        Cause, and what to do.
    on_message
        Called with each line; None to measure only. If it raises, it is not called again.

    Attributes
    ----------
    worst_us
        Greatest lateness so far.
    """

    def __init__(self, subject: str, remedy: str, on_message: Callable[[str], None] | None = None) -> None:
        self.worst_us = 0.0
        self._subject = subject
        self._remedy = remedy
        self._on_message = on_message
        self._delays: deque[tuple[int, float]] = deque()  # begin and lateness of each delay in the window
        self._is_late = False
        self._since_us: int | None = None
        self._last_us = self._told_us = 0
        self._greatest_us = 0.0

    @property
    def running(self) -> bool:
        """Whether time runs late now."""
        return self._since_us is not None

    def add(self, late_us: float, now_us: int) -> None:
        """Use a measurement, also one that is not late. Measurements that are late in a row are one delay."""
        if late_us > LATE_US:
            self._delay(late_us, now_us)
        elif self._since_us is not None and now_us - self._last_us >= _WINDOW_US:
            lasted_s = 1e-6 * (self._last_us - self._since_us)
            self._since_us = None
            self._tell(f"in time again, after {lasted_s:.1f} s of up to {_ms(self._greatest_us)} late")
        self._is_late = late_us > LATE_US

    def _delay(self, late_us: float, now_us: int) -> None:
        delays = self._delays
        begin_us = now_us
        if self._is_late:
            begin_us, before_us = delays.pop()
            late_us = max(late_us, before_us)
        while delays and delays[0][0] < now_us - _WINDOW_US:
            delays.popleft()
        delays.append((begin_us, late_us))
        self.worst_us = max(self.worst_us, late_us)
        self._last_us = now_us
        if self._since_us is not None:
            self._greatest_us = max(self._greatest_us, late_us)
            if now_us - self._told_us >= _REPEAT_US:
                self._told_us = now_us
                lasts_s = 1e-6 * (now_us - self._since_us)
                self._tell(f"up to {_ms(self._greatest_us)} late, for {lasts_s:.0f} s now")
        elif len(delays) >= _OFTEN or late_us > _LONG_US:
            self._since_us, self._told_us = delays[0][0], now_us
            self._greatest_us = max(late for _, late in delays)
            self._tell(f"up to {_ms(self._greatest_us)} late: {self._remedy}")

    def _tell(self, words: str) -> None:
        if self._on_message is not None:
            try:
                self._on_message(f"{self._subject} {words}")
            except Exception:
                self._on_message = None


def _ms(time_us: float) -> str:
    return f"{1e-3 * time_us:.0f} ms"
