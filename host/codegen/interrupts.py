"""Ctrl-C deferred where a KeyboardInterrupt would be lost or do harm.

CasADi queries the Python objects that it is given, and treats an exception in such a query as a negative
answer. A KeyboardInterrupt at that moment would be lost. Code that traces expressions therefore defers
Ctrl-C.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def held_interrupts() -> Iterator[Callable[[], bool]]:
    """Defer Ctrl-C to the end of the block; yield a function that returns whether there was one.

    At the end, each Ctrl-C goes to the previous handler, by default as KeyboardInterrupt. Nothing is deferred
    outside the main thread, which Ctrl-C does not reach, nor where the signal is ignored.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield lambda: False
        return
    held: list[FrameType | None] = []
    signal.signal(signal.SIGINT, lambda number, frame: held.append(frame))
    try:
        yield lambda: bool(held)
    finally:
        signal.signal(signal.SIGINT, before)
        for frame in held:
            before(signal.SIGINT, frame)
