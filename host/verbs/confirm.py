"""Ask a person at the terminal while a session goes on."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable

from trimtab.host.base.text import escaped

YES = "yes"


def ask_at_terminal(lines: tuple[str, ...]) -> Callable[[], bool | None]:
    """Show lines and a question on stderr. Return a function that returns the answer.

    The answer is None before there is one. A thread waits for the line, so that poses keep flowing. Any other
    line than `yes`, and the end of stdin, are a no.
    """
    answers: list[bool] = []
    with contextlib.suppress(ImportError, OSError, ValueError):  # a line typed earlier is no answer
        import termios

        termios.tcflush(sys.stdin, termios.TCIFLUSH)

    def wait() -> None:
        answers.append(sys.stdin.readline().strip().lower() == YES)

    for line in lines:
        print(escaped(line), file=sys.stderr)
    print(f"Type {YES} and Enter to arm: ", end="", file=sys.stderr, flush=True)
    threading.Thread(target=wait, daemon=True).start()
    return lambda: answers[0] if answers else None
