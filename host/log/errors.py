"""What goes wrong with logs, for the command line: exit code 5."""

from __future__ import annotations


class LogError(Exception):
    """A log that cannot be read or written; the message says which file, what is wrong and what to do."""

    exit_code = 5
