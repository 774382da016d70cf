"""Tables for a terminal, and Markdown of generated pages."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

_WIDTH = 120
"""Columns of a page."""


def text(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Return a table as lines of text."""
    titled = [{key: key for key in rows[0]}, *rows]
    widths = {key: max(len(str(row[key])) for row in titled) for key in rows[0]}
    return ["  ".join(str(row[key]).ljust(width) for key, width in widths.items()).rstrip() for row in titled]


def markdown(rows: Sequence[Mapping[str, str]]) -> str:
    """Return a table as Markdown."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def wrapped(prose: str) -> str:
    """Return the prose with its paragraphs in lines that fit a page; indented code stays as it is.

    A paragraph that begins with "- " is a list with an item on each line.
    """
    return "\n\n".join(_wrapped(each) for each in prose.split("\n\n"))


def _wrapped(paragraph: str) -> str:
    if paragraph.startswith("    "):
        return paragraph
    items, indent = [paragraph], ""
    if paragraph.startswith("- "):
        items, indent = paragraph.splitlines(), "  "
    return "\n".join(
        textwrap.fill(item, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
        for item in items
    )
