"""Tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def text(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Return a table as lines of text."""
    titled = [{key: key for key in rows[0]}, *rows]
    widths = {key: max(len(str(row[key])) for row in titled) for key in rows[0]}
    return ["  ".join(str(row[key]).ljust(width) for key, width in widths.items()).rstrip() for row in titled]
