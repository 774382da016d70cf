"""Progress bar with an estimate of the remaining time, on stderr and only on a terminal."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from trimtab.host.base.text import escaped

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID


class Progress:
    """A progress bar. Without a terminal, every call does nothing. NO_COLOR is honoured.

    With `total` None, the bar only moves. `detail` is a short text beside the bar.
    """

    def __init__(self, title: str, total: float | None = None, *, enabled: bool | None = None) -> None:
        self._title = escaped(title)
        self._total = total
        self._enabled = sys.stderr.isatty() if enabled is None else enabled
        self._bar: RichProgress | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        if self._enabled:
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
            from rich.progress import Progress as RichProgress

            self._bar = RichProgress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[detail]}", markup=False),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=self._total, detail="")
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
            fields: dict[str, Any] = {} if detail is None else {"detail": escaped(detail)}
            self._bar.update(self._task, advance=amount, **fields)

    def update(
        self, completed: float | None = None, *, total: float | None = None, detail: str | None = None
    ) -> None:
        """Set the bar to `completed` of `total`."""
        if self._bar is not None and self._task is not None:
            fields: dict[str, Any] = {} if detail is None else {"detail": escaped(detail)}
            self._bar.update(self._task, completed=completed, total=total, **fields)

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        if self._bar is not None:
            self._bar.console.print(escaped(line), markup=False, highlight=False)
