"""Failures that are no bugs: files, too little memory, and computations that the data do not determine."""

from __future__ import annotations

import errno
import sys

from trimtab.host.base.errors import UsageError

ADDRESS_SPACE_MIN_MB = 512
"""Below it, numerical libraries fail while they load, some in an endless loop."""

_SMALLER = {
    "trace": "trace fewer logs at once",
    "learn": "learn from fewer logs or a smaller network",
    "plan": "plan with fewer --nodes",
}
"""How a verb needs less memory."""
_DETERMINED = {
    "trace": "the flights do not determine a fit; leave out one log at a time to find the one at fault",
    "learn": "the flights do not determine a model; leave out one log at a time to find the one at fault",
    "plan": "the route and the model do not determine a plan; plan with --kind min-snap or without --model",
}
"""What a numerical failure of a verb means, and the remedy."""


def check_address_space() -> None:
    """Raise UsageError if this process may use less than ADDRESS_SPACE_MIN_MB of address space."""
    try:
        import resource
    except ImportError:  # a system without such limits
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < ADDRESS_SPACE_MIN_MB * 2**20:
        raise UsageError(
            f"the address space is limited to {limit // 2**20} MB, and trimtab needs "
            f"{ADDRESS_SPACE_MIN_MB} MB; raise it with `ulimit -v {ADDRESS_SPACE_MIN_MB * 1024}` or more"
        )


def failure_message(error: BaseException, verb: str) -> str | None:
    """Return what is wrong and what to do, in one line; None if the error may be a bug.

    error: an exception that `verb` raised.
    """
    linalg = sys.modules.get("numpy.linalg")
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        smaller = f", or {_SMALLER[verb]}" if verb in _SMALLER else ""
        details = f" ({error})" if str(error) else ""
        return f"out of memory{details}; free memory or raise its limit (ulimit -v){smaller}"
    if verb in _DETERMINED and linalg is not None and isinstance(error, linalg.LinAlgError):
        return f"{_DETERMINED[verb]} ({error})"
    return _file_message(error) if isinstance(error, OSError) else None


def _file_message(error: OSError) -> str | None:
    """Return the message for a file that cannot be opened or written; None for another error."""
    from trimtab.host.base.artefacts import NO_ROOM

    if error.filename is not None:
        return f"{error.filename}: {error.strerror}; check the file and its folder"
    if error.errno in NO_ROOM:
        return f"nothing more can be written: {error.strerror}; free disk space"
    return None
