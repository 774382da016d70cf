"""`trimtab watch`: a flight while it is flown."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.verbs.options import Json

PERIOD_S = 0.2


def command(log: Path, *, port: int | None = None, json: Json = False) -> None:
    """Show a flight while it is flown, from the log that it writes. The log need not exist yet.

    Parameters
    ----------
    log
        Log of the flight, by the name that the finished log will have.
    port
        Port of this machine at which Foxglove can connect; 0 for any free one.
    """
    import time
    from contextlib import ExitStack, closing

    from trimtab.host.base.live import LiveTable
    from trimtab.host.base.output import emit, say
    from trimtab.host.watch.figures import to_rows
    from trimtab.host.watch.server import HOST, ViewerServer
    from trimtab.host.watch.watch import watch

    with ExitStack() as stack:
        server = None
        if port is not None:
            server = stack.enter_context(closing(ViewerServer(port)))
            say(f"ws://{HOST}:{server.port}")
        table = stack.enter_context(LiveTable(str(log)))
        figures = watch(
            log,
            wait=lambda: time.sleep(PERIOD_S),
            on_figures=lambda each, idle: table.show(
                [*to_rows(each), ("log last grew", f"{idle * PERIOD_S:.0f} s ago")]
            ),
            server=server,
        )
    say(*(f"{name}: {value}" for name, value in to_rows(figures)))
    emit({"log": str(log), "port": None if server is None else server.port, **figures}, json)
