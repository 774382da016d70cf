"""Output of a verb on stdout: lines of text and, with --json, one object as the last line."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trimtab.host.base.text import ESCAPE, escaped, readable

_emitted = False
_DELETE = "\x7f"
_NARROWEST = 20
"""Columns. The help cannot be formatted in fewer."""


def prepare() -> None:
    """Make the standard streams safe to write to, and reset the state of `emitted`.

    A closed stream is replaced by the null device. Characters that a stream cannot encode are written as
    escape sequences, but those of file names as their bytes. A terminal with fewer than 20 columns is treated
    as one of 20.
    """
    global _emitted
    _emitted = False
    while (unused := os.open(os.devnull, os.O_RDWR)) <= 2:  # the lowest free number
        pass
    os.close(unused)
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=ESCAPE)
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit() and int(columns) < _NARROWEST:
        os.environ["COLUMNS"] = str(_NARROWEST)


def json_text(result: Mapping[str, Any]) -> str:
    """Return `result` as one line of JSON. NumPy scalars and arrays become numbers and lists, paths strings.

    Absent values must be None: raises ValueError on NaN or infinity.
    """
    text = json.dumps(result, allow_nan=False, default=_plain, ensure_ascii=False)
    text = text if text.isascii() else json.dumps(json.loads(readable(text, "surrogateescape")))
    return text.replace(_DELETE, "\\u007f")  # the one control character that JSON allows


def emit(result: Mapping[str, Any], as_json: bool) -> None:
    """Print `result` as one line of JSON if `as_json`, else nothing. Call this once, at the end."""
    global _emitted
    if as_json:
        text = json_text(result)
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
        _emitted = True


def say(*lines: str) -> None:
    """Print lines of text to stdout, each in one line whatever is in it."""
    for line in lines:
        sys.stdout.write(escaped(line) + "\n")
    sys.stdout.flush()


def warn(line: str) -> None:
    """Print one line to stderr, whatever is in it. If stderr cannot be written, do nothing."""
    try:
        sys.stderr.write(f"trimtab: {escaped(line)}\n")
        sys.stderr.flush()
    except OSError:  # the terminal has closed; discard the rest, so that the final flush does not fail
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def emitted() -> bool:
    """Return whether this run has printed its JSON object."""
    return _emitted


def _plain(value: Any) -> Any:
    """Return a value of another type as one that the json module can encode."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"no JSON form for {type(value).__name__}")
