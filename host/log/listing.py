"""The logs of a folder, closed and unfinished, as lines of text and as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import LOG_SUFFIX
from trimtab.host.log.errors import LogError, foreign_log
from trimtab.host.log.heading import read_heading
from trimtab.host.log.provenance import PROVENANCE
from trimtab.host.log.unfinished import to_json, unfinished_lines, unfinished_logs


def list_logs(folder: Path) -> dict[str, Any]:
    """Return what the logs of a folder are, as plain data. One that cannot be read has a problem.

    Raises LogError for a folder without any that can be read or recovered.
    """
    logs = [_entry(path) for path in sorted(folder.glob(f"*{LOG_SUFFIX}"))]
    unfinished = [to_json(part) for part in unfinished_logs(folder)]
    if not unfinished and all(log["problem"] for log in logs):
        raise foreign_log(folder, "is a folder without a flight log")
    return {"folder": str(folder), "logs": logs, "unfinished": unfinished}


def listing_lines(listing: dict[str, Any]) -> list[str]:
    """Return the lines of text for the terminal, from `list_logs`."""
    lines = [
        log["problem"]
        or f"{log['log']}  id {log['id']}  {log['bytes'] / 1024:.0f} KiB  {log['kind']}  {log['vehicle']}"
        for log in listing["logs"]
    ]
    return lines + unfinished_lines(unfinished_logs(Path(listing["folder"])))


def _entry(path: Path) -> dict[str, Any]:
    known: dict[str, Any] = {"id": None, "bytes": None, "kind": None, "vehicle": None, "problem": None}
    try:
        heading, size = read_heading(path), path.stat().st_size
    except (LogError, OSError) as error:
        return {"log": str(path), **known, "problem": str(error)}
    entries = heading.metadata[PROVENANCE]
    known |= {
        "id": heading.id,
        "bytes": size,
        "kind": entries.get("kind"),
        "vehicle": entries.get("vehicle_name"),
    }
    return {"log": str(path), **known}
