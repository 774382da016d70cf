"""What goes wrong with logs, for the command line: exit code 5; too little in them: 2."""

from __future__ import annotations

from trimtab.host.base.errors import TrimtabError


class LogError(TrimtabError):
    """A log that cannot be read or written; the message says which file, what is wrong and what to do."""

    exit_code = 5


class TooLittleData(TrimtabError, ValueError):
    """A log lacks what its flight is rebuilt from, or the logs are too little to judge; the message says
    what.
    """

    exit_code = 2
