"""Logs that are not closed: those that are being written, and those whose writer was interrupted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import LOG_SUFFIX
from trimtab.host.base.parts import PartState, Unfinished, look, unfinished, unfinished_in
from trimtab.host.log.errors import LogError
from trimtab.host.log.scan import holds_chunk


def unfinished_logs(path: Path) -> list[Unfinished]:
    """Return the unfinished logs in a folder, or those of the log `path`, by name.

    Parts that hold nothing yet, or never will, are left out.
    """
    parts = unfinished_in(path) if path.is_dir() else unfinished(path)
    return [part for part in parts if part.size and part.target.suffix == LOG_SUFFIX]


def find_damaged(path: Path) -> Path:
    """Return `path`, or the unfinished log beside it if only that exists because the writer was interrupted.

    Raises LogError if there are several.
    """
    if path.exists():
        return path
    parts = unfinished_logs(path)
    if len(parts) > 1:
        raise LogError(f"{path}: has {len(parts)} unfinished logs; give one of {_names(parts)}")
    return parts[0].path if parts else path


def check_not_written(path: Path) -> None:
    """Raise LogError if another process is writing the log in this file."""
    part = look(path)
    if part is not None and part.state is PartState.WRITING:
        raise LogError(
            f"{path}: is being written; wait until its flight has ended, or run `trimtab watch {part.target}`"
        )


def unfinished_lines(parts: Sequence[Unfinished]) -> list[str]:
    """Return a line of text for each unfinished log."""
    lines = []
    for part in parts:
        owner = "" if part.owner is None else f", of another user ({part.owner})"
        lines.append(f"{part.path}  {part.size / 1024:.0f} KiB{owner}  {_what_to_do(part)}")
    return lines


def _what_to_do(part: Unfinished) -> str:
    """Return the state of an unfinished log and the remedy, in words."""
    if part.state is PartState.WRITING:
        return "is being written"
    if part.state is PartState.UNKNOWN:
        return f"is not closed; run `trimtab log recover {part.path}` if nothing writes it"
    if _recoverable(part) is False:
        return "was interrupted before its first chunk; nothing can be recovered, remove it"
    return f"was interrupted; run `trimtab log recover {part.path}`"


def _recoverable(part: Unfinished) -> bool | None:
    """Return whether an unfinished log holds anything that can be recovered; None if it cannot be read."""
    try:
        return holds_chunk(part.path)
    except OSError:
        return None


def to_json(part: Unfinished) -> dict[str, Any]:
    """Return an unfinished log as plain data."""
    return {
        "part": str(part.path),
        "log": str(part.target),
        "bytes": part.size,
        "state": part.state.name.lower(),
        "owner": part.owner,
        "recoverable": _recoverable(part),
    }


def _names(parts: Sequence[Unfinished]) -> str:
    return ", ".join(str(part.path) for part in parts)
