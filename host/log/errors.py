"""Errors about logs: exit code 5 for unusable files, 2 for missing files and too little data."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.base.errors import TrimtabError
from trimtab.host.base.parts import owner_of


class LogError(TrimtabError):
    """A log cannot be read or written. The message names the file, the problem and the remedy."""

    exit_code = 5


class MissingLog(LogError):
    """A log does not exist."""

    exit_code = 2


NOT_OURS = "is an MCAP file of another program"


class TooLittleData(TrimtabError, ValueError):
    """Data needed to process a flight is missing, or the flights are too few. The message says what."""

    exit_code = 2


def unreadable(path: Path, error: OSError) -> LogError:
    """Return the error for a file that the system does not let read. It names an owner who is another."""
    if isinstance(error, PermissionError) and (owner := owner_of(path)) is not None:
        return LogError(f"{path}: belongs to another user ({owner}); ask for the right to read it")
    kind = MissingLog if isinstance(error, FileNotFoundError | NotADirectoryError) else LogError
    return kind(f"{path}: cannot be read ({error.strerror or error}); check the path")


def foreign_log(path: Path, what: str) -> LogError:
    """Return the error for a path that holds no log of Trimtab. `what` says why, such as "is a folder"."""
    return LogError(
        f"{path}: {what}; give a flight log written by trimtab fly, or run `trimtab import {path}` to see "
        "what a log of another program holds and to convert it"
    )
