"""What a Betaflight blackbox log holds: its header names the fields and their rate.

No blackbox log holds positions, so none can be imported alone.
"""

from __future__ import annotations

import re
from pathlib import Path

from trimtab.host.base.text import escaped
from trimtab.host.imports.contents import Contents, Topic
from trimtab.host.imports.recording import ImportFormatError, Recording, check_readable

MARK = b"H Product:Blackbox flight data recorder"
HEADER_BYTES = 1 << 16


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the file begins with a blackbox header."""
    return head.startswith(MARK)


def contents(path: Path) -> Contents:
    """Return the fields of the first log in the file, with the rate of its main frames.

    Their number and the duration are not in the header. Raises ImportFormatError.
    """
    check_readable(path)
    with path.open("rb") as stream:
        lines = [line.decode("latin-1") for line in stream.read(HEADER_BYTES).split(b"\n")]
    header = dict(line[2:].split(":", 1) for line in lines if line.startswith("H ") and ":" in line)
    names = [name.strip() for name in header.get("Field I name", "").split(",") if name.strip()]
    if not names:
        raise ImportFormatError(f"{path.name}: the header names no fields; download it from the board again")
    loop_us = _number(header.get("looptime", ""))
    share = _number(header.get("P interval", "1").rpartition("/")[2]) or 1.0
    rate_hz = 1e6 / (loop_us * share) if loop_us else 0.0
    return Contents(
        topics=tuple(Topic(name=escaped(name), count=0, rate_hz=rate_hz) for name in names), duration_s=0.0
    )


def read(path: Path | str) -> Recording:
    """Raise ImportFormatError, since a blackbox log holds no positions."""
    raise ImportFormatError(
        f"{Path(path).name}: a Betaflight log holds no positions; record poses beside it and give both as CSV"
    )


def _number(text: str) -> float:
    """Return a positive number; 0 for another text."""
    return float(text) if re.fullmatch(r"\d+(\.\d+)?", text.strip()) else 0.0
