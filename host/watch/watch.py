"""Following a flight through its log, until the log is closed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from trimtab.host.log.follow import LogFollower
from trimtab.host.watch.figures import Figures
from trimtab.host.watch.server import ViewerServer


def watch(
    path: Path,
    *,
    wait: Callable[[], None],
    on_figures: Callable[[dict[str, Any], int], None],
    server: ViewerServer | None = None,
) -> dict[str, Any]:
    """Follow the log at `path` until its writer closes it. Return the last figures.

    wait: called before each further look at the file. on_figures: called after each look with the figures and
    the number of looks since the log last grew. server: gets every message. Raises LogError if the file is no
    log or cannot be read.
    """
    figures, idle = Figures(), 0
    with closing(LogFollower(path)) as log:
        while True:
            messages = log.poll()
            channels = log.content.channels
            figures.add(messages, {number: channel.topic for number, channel in channels.items()})
            if server is not None and messages:
                server.send(log.content, messages)
            idle = 0 if messages else idle + 1
            on_figures(figures.to_json(), idle)
            if log.ended:
                return figures.to_json()
            wait()
