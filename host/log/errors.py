"""Errors about logs: exit code 5 for unusable files, 2 for too little data."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.base.errors import TrimtabError


class LogError(TrimtabError):
    """A log cannot be read or written. The message names the file, the problem and the remedy."""

    exit_code = 5


NOT_OURS = "is an MCAP file of another program"


class TooLittleData(TrimtabError, ValueError):
    """Data needed to process a flight is missing, or the flights are too few. The message says what."""

    exit_code = 2


def foreign_log(path: Path, what: str) -> LogError:
    """Return the error for a path that holds no log of Trimtab. `what` says why, such as "is a folder"."""
    return LogError(
        f"{path}: {what}; give a flight log written by trimtab fly, or run `trimtab import {path}` to see "
        "what a log of another program holds and to convert it"
    )
