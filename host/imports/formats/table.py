"""Reader of named numeric columns of a CSV file."""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TextIO

import numpy as np

from trimtab.host.base.bounds import CSV_COLUMNS, CSV_LINE
from trimtab.host.base.text import escaped
from trimtab.host.imports.contents import Contents, topic
from trimtab.host.imports.recording import READABLE, ImportFormatError, reading

SKIPPED_MAX = 0.05
"""Greatest share of rows without finite numbers; with more, a column is wrong or has another rate."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns by name, of the rows in which all are finite, and the number of other rows."""

    columns: Mapping[str, Annotated[np.ndarray, "rows"]]
    skipped: int


def table(path: Path, needed: Sequence[str]) -> Table:
    """Return the needed columns of a CSV file.

    Empty lines, spaces around names and a byte order mark are ignored. Rows without a finite number below
    1e30 in every needed column are skipped. Raises ImportFormatError with the file and every missing column,
    or with the first such line and column if there are more than SKIPPED_MAX of them.
    """
    with _opened(path) as reader:
        return _table(reader, path.name, tuple(dict.fromkeys(needed)))


@contextmanager
def _opened(path: Path) -> Iterator[_Rows]:
    """Open a CSV file. Raises ImportFormatError for a file that cannot be read or is not CSV."""
    try:
        with reading(path), path.open(newline="", encoding="utf-8-sig") as stream:
            yield _Rows(stream, path.name)
    except UnicodeDecodeError as error:
        raise ImportFormatError(
            f"{path.name}: not UTF-8 text at byte {error.start}; give a CSV file"
        ) from None
    except csv.Error as error:
        raise ImportFormatError(f"{path.name}: not a CSV file ({error}); give one") from None


class _Rows:
    """The rows of a CSV file, of bounded length, and the number of the line read last.

    A quoted cell may go over several lines, so that a row has no end although its lines have.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self._stream, self._name, self._length = stream, name, 0
        self._reader = csv.reader(self._lines())

    @property
    def line_num(self) -> int:
        """Number of the line read last."""
        return self._reader.line_num

    def __iter__(self) -> Iterator[list[str]]:
        for cells in self._reader:
            self._length = 0
            yield cells

    def _lines(self) -> Iterator[str]:
        while line := self._stream.readline(CSV_LINE.limit + 1):
            self._length += len(line)
            if self._length > CSV_LINE.limit:
                raise ImportFormatError(f"{self._name}: line {self.line_num + 1}: {CSV_LINE.problem()}")
            yield line


def header(head: bytes) -> tuple[str, ...]:
    """Return the column names in the first line, given a file's first bytes; empty if it is not CSV."""
    line, end, _ = head.partition(b"\n")
    try:
        names = next(csv.reader([line.decode("utf-8-sig").strip("\r")]), []) if end else []
    except (UnicodeDecodeError, csv.Error):
        return ()
    return tuple(name.strip() for name in names) if len(names) > 1 else ()


def table_contents(path: Path, time: str | None = None) -> Contents:
    """Return each column as a topic. Rates are known if a column of times, in seconds, is named.

    Raises ImportFormatError as `table` does.
    """
    with _opened(path) as reader:
        names = _names(reader, path.name)
        count = sum(map(bool, reader)) if time is None else 0
    duration_s = 0.0
    if time is not None:
        times = table(path, [time]).columns[time]
        count, duration_s = len(times), float(np.ptp(times))
    return Contents(topics=tuple(topic(name, count, duration_s) for name in names), duration_s=duration_s)


def _names(reader: _Rows, name: str) -> list[str]:
    """Return the names in the first line. Raises ImportFormatError for too many."""
    names = [cell.strip() for cell in next(iter(reader), [])]
    if len(names) > CSV_COLUMNS.limit:
        raise ImportFormatError(f"{name}: line 1: {CSV_COLUMNS.problem(len(names))}")
    return names


def _table(reader: _Rows, name: str, needed: tuple[str, ...]) -> Table:
    header = _names(reader, name)
    missing = [column for column in needed if column not in header]
    if missing:
        raise ImportFormatError(f"{name}: no column {escaped(', '.join(missing))}; is it another format?")
    twice = [column for column in needed if header.count(column) > 1]
    if twice:
        raise ImportFormatError(f"{name}: two columns are named {escaped(', '.join(twice))}; rename one")
    at = [header.index(column) for column in needed]
    numbers = array("d")
    first, skipped = "", 0
    for cells in reader:
        if not cells:
            continue
        row = [_number(cells, i) for i in at]
        wrong = [column for column, value in zip(needed, row, strict=True) if not abs(value) < READABLE]
        if wrong:
            skipped += 1
            first = first or f"line {reader.line_num}: {escaped(wrong[0])} is not a finite number"
        else:
            numbers.extend(row)
    rows = np.frombuffer(numbers).reshape(-1, len(needed))
    if skipped > SKIPPED_MAX * (skipped + len(rows)):
        raise ImportFormatError(f"{name}: {first}, and {skipped - 1} more rows; remove or correct them")
    if len(rows) < 2:
        raise ImportFormatError(f"{name}: fewer than two rows of numbers; nothing to import")
    return Table(columns=dict(zip(needed, rows.T, strict=True)), skipped=skipped)


def _number(cells: list[str], index: int) -> float:
    """Return a cell's number; NaN if it holds none."""
    try:
        return float(cells[index])
    except (ValueError, IndexError):
        return math.nan
