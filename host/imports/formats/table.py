"""Reader of named numeric columns of a CSV file."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from trimtab.host.imports.contents import Contents, topic
from trimtab.host.imports.recording import READABLE, ImportFormatError


def table(path: Path, needed: Sequence[str]) -> dict[str, Annotated[np.ndarray, "rows"]]:
    """Return the needed columns of a CSV file by name. All values are finite.

    Empty lines, spaces around names and a byte order mark are ignored. Raises ImportFormatError with the file
    and every missing column, or with the first line and column that has no number below 1e30.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            return _table(stream, path.name, tuple(dict.fromkeys(needed)))
    except UnicodeDecodeError as error:
        raise ImportFormatError(
            f"{path.name}: not UTF-8 text at byte {error.start}; give a CSV file"
        ) from None
    except csv.Error as error:
        raise ImportFormatError(f"{path.name}: not a CSV file ({error}); give one") from None
    except OSError as error:
        raise ImportFormatError(
            f"{path}: cannot be read ({error.strerror or error}); check the path"
        ) from None


def header(head: bytes) -> tuple[str, ...]:
    """Return the column names in the first line, given a file's first bytes; empty if it is not CSV."""
    line, end, _ = head.partition(b"\n")
    try:
        names = next(csv.reader([line.decode("utf-8-sig").strip("\r")]), []) if end else []
    except (UnicodeDecodeError, csv.Error):
        return ()
    return tuple(name.strip() for name in names) if len(names) > 1 else ()


def table_contents(path: Path, time: str | None = None, unit_s: float = 1.0) -> Contents:
    """Return each column as a topic. Rates are known if a column of times is named, with its unit in seconds.

    Raises ImportFormatError as `table` does.
    """
    names = header(path.read_bytes())
    rows = table(path, [time] if time is not None else names[:1])
    times = next(iter(rows.values()))
    duration_s = float(times[-1] - times[0]) * unit_s if time is not None else 0.0
    return Contents(
        topics=tuple(topic(name, len(times), duration_s) for name in names), duration_s=duration_s
    )


def _table(stream: object, name: str, needed: tuple[str, ...]) -> dict[str, np.ndarray]:
    reader = csv.reader(stream)  # type: ignore[arg-type]
    header = [cell.strip() for cell in next(reader, [])]
    missing = [column for column in needed if column not in header]
    if missing:
        raise ImportFormatError(f"{name}: no column {', '.join(missing)}; is it another format?")
    twice = [column for column in needed if header.count(column) > 1]
    if twice:
        raise ImportFormatError(f"{name}: two columns are named {', '.join(twice)}; rename one")
    at = [header.index(column) for column in needed]
    rows = []
    for cells in reader:
        if not cells:
            continue
        try:
            row = [float(cells[i]) for i in at]
        except (ValueError, IndexError):
            row = [math.nan]
        if not all(abs(value) < READABLE for value in row):
            column = next(c for c, i in zip(needed, at, strict=True) if not _is_number(cells, i))
            raise ImportFormatError(
                f"{name}: line {reader.line_num}: {column} is not a finite number; remove or correct it"
            )
        rows.append(row)
    if len(rows) < 2:
        raise ImportFormatError(f"{name}: fewer than two rows of numbers; nothing to import")
    return dict(zip(needed, np.array(rows).T, strict=True))


def _is_number(cells: list[str], index: int) -> bool:
    try:
        return abs(float(cells[index])) < READABLE
    except (ValueError, IndexError):
        return False
