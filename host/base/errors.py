"""Errors that a user can resolve, each with an exit code.

The message says in one line what is wrong and what to do. Every such error of the host and the simulator
derives from `TrimtabError`. Packages define further ones beside the code that raises them.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

EXIT_CODES = {
    0: "done; `undecided`, `nothing-missing` and `outside-library` are answers",
    1: "a gate missed, a plan infeasible, a reference refused on board, or a flight that ended in failsafe",
    2: "usage, configuration, wrong vehicle, too little data, or a route that contradicts itself",
    3: "link: no vehicle at the port, or one that speaks another dialect",
    4: "a solver gave up",
    5: "an unreadable log",
    70: "a bug of ours; the line names the file with its traceback",
    130: "interrupted",
}
"""What each exit code of `trimtab` means."""

BUG = 70
INTERRUPTED = 130


class TrimtabError(Exception):
    """An error with an exit code. Its text is shown in one line; with `--json`, `details` join the object."""

    exit_code: int = 1
    details: Mapping[str, Any] = MappingProxyType({})

    @property
    def lines(self) -> tuple[str, ...]:
        """The text in lines. A line feed in a name that the text holds begins no line."""
        return (str(self),)


class GateMissed(TrimtabError):
    """The work was done, but its result misses the required quality."""


class Refused(TrimtabError):
    """A plan is infeasible or the vehicle refused it. The text gives node and reason."""


class FlightFailed(TrimtabError):
    """A flight ended in failsafe."""


class UsageError(TrimtabError):
    """Arguments, files or data cannot be used."""

    exit_code = 2


class LinkError(TrimtabError):
    """There is no vehicle at the port, or one that speaks another dialect."""

    exit_code = 3


class SolverError(TrimtabError):
    """A solver gave up. The text gives its state."""

    exit_code = 4


SESSION_ERRORS = (FlightFailed, LinkError, Refused, UsageError)
"""Errors that end a session immediately. After any other error in flight, the vehicle lands first."""
