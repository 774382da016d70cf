"""Tables of a study as lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence


def lines(tables: Mapping[str, Sequence[Mapping[str, str]]]) -> Iterator[str]:
    """Yield title and rows of each table, in columns."""
    for title, rows in tables.items():
        yield title
        columns = {key: [key, *(row[key] for row in rows)] for key in rows[0]}
        padded = [[cell.ljust(max(map(len, cells))) for cell in cells] for cells in columns.values()]
        yield from ("  " + "  ".join(row).rstrip() for row in zip(*padded, strict=True))
