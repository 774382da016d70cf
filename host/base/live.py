"""A table on stderr that is rewritten in place, only on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

from trimtab.host.base.text import escaped

if TYPE_CHECKING:
    from rich.live import Live


class LiveTable:
    """Table of names and values. Without a terminal, every call does nothing. NO_COLOR is honoured."""

    def __init__(self, title: str, *, enabled: bool | None = None) -> None:
        self._title = escaped(title)
        self._enabled = sys.stderr.isatty() if enabled is None else enabled
        self._live: Live | None = None

    def __enter__(self) -> Self:
        if self._enabled:
            from rich.console import Console
            from rich.live import Live

            self._live = Live(console=Console(stderr=True), transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
        self._live = None

    def show(self, rows: Sequence[tuple[str, str]]) -> None:
        """Show these rows instead of the last ones."""
        if self._live is not None:
            from rich.table import Table
            from rich.text import Text

            table = Table(title=Text(self._title), show_header=False)
            for row in rows:
                table.add_row(*(Text(escaped(cell)) for cell in row))
            self._live.update(table, refresh=True)
