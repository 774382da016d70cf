"""Steps of a demo: each is timed and reports one figure."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from trimtab.host.base.progress import Progress

OnMessage = Callable[[str], None]


class Steps:
    """Steps of a demo with a line of output after each. `times` holds (title, seconds) of each step."""

    def __init__(self, on_message: OnMessage) -> None:
        self._on_message = on_message
        self.times: list[tuple[str, float]] = []

    @contextmanager
    def step(self, title: str, total: float | None = None) -> Iterator[tuple[Progress, OnMessage]]:
        """Yield a progress bar and a function that takes the step's figure; call that function once."""
        figures: list[str] = []
        begin_s = time.perf_counter()
        with Progress(title, total) as bar:
            yield bar, figures.append
        seconds = time.perf_counter() - begin_s
        self.times.append((title, seconds))
        self._on_message(f"{len(self.times)}. {title} ({seconds:.1f} s): {figures[0]}")
