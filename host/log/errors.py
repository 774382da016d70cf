"""Errors about logs: exit code 5 for unusable files, 2 for too little data."""

from __future__ import annotations

from trimtab.host.base.errors import TrimtabError


class LogError(TrimtabError):
    """A log cannot be read or written. The message names the file, the problem and the remedy."""

    exit_code = 5


class TooLittleData(TrimtabError, ValueError):
    """Data needed to process a flight is missing, or the flights are too few. The message says what."""

    exit_code = 2
