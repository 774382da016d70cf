"""What a verb says on stdout: lines for people, and with --json one object as the last line."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_emitted = False
_NARROWEST = 20
"""Columns; in fewer the help cannot be set at all."""


def prepare() -> None:
    """Make the standard streams safe to write to, whatever the shell has made of them.

    One that is closed goes nowhere; letters that stdout's encoding lacks are written as their numbers; a
    terminal that calls itself too narrow for any text is taken for one of 20 columns. No JSON has been said.
    """
    global _emitted
    _emitted = False
    while (unused := os.open(os.devnull, os.O_RDWR)) <= 2:  # the lowest number that is free
        pass
    os.close(unused)
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit() and int(columns) < _NARROWEST:
        os.environ["COLUMNS"] = str(_NARROWEST)


def json_text(result: Mapping[str, Any]) -> str:
    """Return `result` as one line of JSON. Numpy scalars and arrays become numbers and lists, paths texts.

    Absent is None: raises ValueError on NaN or infinity.
    """
    return json.dumps(result, allow_nan=False, default=_plain)


def emit(result: Mapping[str, Any], as_json: bool) -> None:
    """Print `result` as one line of JSON where `as_json`, else nothing. Call it last, once."""
    global _emitted
    if as_json:
        text = json_text(result)
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
        _emitted = True


def say(*lines: str) -> None:
    """Print lines for people to stdout."""
    for line in lines:
        sys.stdout.write(line + "\n")
    sys.stdout.flush()


def warn(line: str) -> None:
    """Print one line to stderr, where anybody takes it."""
    try:
        sys.stderr.write(f"trimtab: {line}\n")
        sys.stderr.flush()
    except OSError:  # the terminal has gone; what is still held would trouble the interpreter's end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def emitted() -> bool:
    """Whether this run has printed its JSON object."""
    return _emitted


def _plain(value: Any) -> Any:
    """Return a value that json does not know as one it knows."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"no JSON form for {type(value).__name__}")
