"""Progress bar with an estimate of the remaining time, on stderr and only on a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from trimtab.host.base.text import escaped

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID


class WorkTimes:
    """Elapsed and remaining time of counted work. `clock` gives the time in s.

    Speed is measured from the moment at which `count` is told the total, else from the begin: what was done
    before it, such as preparing the work or in an earlier run, says nothing of it. The remaining work is
    taken to be as fast as all work since. Between two counts, the piece at hand is taken to go on at that
    speed until it should be done: the remaining time neither stands still nor grows while nothing is counted.
    """

    def __init__(self, total: float | None, clock: Callable[[], float] = time.monotonic) -> None:
        self.total = total
        self._clock = clock
        self._begin_s = self._start_s = self._counted_s = clock()
        self.done = self._found = self._piece = 0.0
        self._is_told = False

    def count(self, done: float, total: float | None = None) -> None:
        """Use the work done by now, and the total if it is known only now or was corrected."""
        if total is not None:
            self.total = total
            if not self._is_told:
                self._is_told, self._found, self.done, self._start_s = True, done, done, self._clock()
        if done > self.done:
            self._piece, self.done, self._counted_s = done - self.done, done, self._clock()

    @property
    def elapsed_s(self) -> float:
        """Time since the begin, s."""
        return self._clock() - self._begin_s

    @property
    def remaining_s(self) -> float | None:
        """Expected time to the end, s; None before the first count, or if the total is unknown."""
        counted_s, now_s = self._counted_s - self._start_s, self._clock() - self._start_s
        if self.total is None or self.done <= self._found or counted_s <= 0.0:
            return None
        done, total = self.done - self._found, self.total - self._found
        by_now = min(done * now_s / counted_s, done + self._piece, total)
        return now_s * (total - by_now) / by_now

    def __str__(self) -> str:
        remaining_s = self.remaining_s
        text = f"{_minutes(self.elapsed_s)} elapsed"
        return text if remaining_s is None else f"{text}, {_minutes(remaining_s)} remaining"


def _minutes(time_s: float) -> str:
    """Return a time as 1:05, or as 2:01:05 from an hour on."""
    minutes, seconds = divmod(round(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


class Progress:
    """A progress bar. Without a terminal, every call does nothing. NO_COLOR is honoured.

    With `total` None, the bar only moves. `detail` is a short text beside the bar.
    """

    def __init__(self, title: str, total: float | None = None, *, enabled: bool | None = None) -> None:
        self._title = escaped(title)
        self._times = WorkTimes(total)
        self._enabled = sys.stderr.isatty() if enabled is None else enabled
        self._bar: RichProgress | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        if self._enabled:
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn
            from rich.progress import Progress as RichProgress

            self._bar = RichProgress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TextColumn("{task.fields[times]}", markup=False),  # formatted whenever the bar is drawn
                TextColumn("{task.fields[detail]}", markup=False),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
            self._times = WorkTimes(self._times.total)
            self._task = self._bar.add_task(
                self._title, total=self._times.total, detail="", times=self._times
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        self._bar = self._task = None

    def advance(self, amount: float = 1.0, detail: str | None = None) -> None:
        """Advance the bar by `amount`."""
        if self._bar is not None and self._task is not None:
            self.update(self._times.done + amount, detail=detail)

    def update(
        self, completed: float | None = None, *, total: float | None = None, detail: str | None = None
    ) -> None:
        """Set the bar to `completed` of `total`."""
        if self._bar is not None and self._task is not None:
            fields: dict[str, Any] = {} if detail is None else {"detail": escaped(detail)}
            self._times.count(self._times.done if completed is None else completed, total)
            self._bar.update(self._task, completed=completed, total=total, **fields)

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        if self._bar is not None:
            self._bar.console.print(escaped(line), markup=False, highlight=False)
