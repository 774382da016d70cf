"""Ctrl-C held back where a KeyboardInterrupt would be lost or do harm.

CasADi asks Python about what it is given, and takes an exception in an answer for a no: a KeyboardInterrupt
that comes just then is never seen again. So what traces expressions holds Ctrl-C back.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def held_interrupts() -> Iterator[Callable[[], bool]]:
    """Says whether there was a Ctrl-C inside. At the end each is handed to whoever handled it before.

    That is KeyboardInterrupt where nobody asked for anything else. Nothing is held outside the main thread,
    which no Ctrl-C reaches, nor where the signal is ignored.
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
