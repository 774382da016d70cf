"""Reader of the records of Crazyflie uSD binary logs.

Layout: byte 0xBC; u16 version; u16 number of event types; per type u16 id, name, u16 number of variables,
each "name(format)" with a letter of Python's struct; then records of u16 id, time (u32 ms in version 1, u64
us in version 2) and the packed variables; the last four bytes are the CRC-32 of all before them. Strings end
with NUL, numbers are little-endian.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.base.bounds import USD_RECORDS
from trimtab.host.imports.recording import ImportFormatError

MARK = 0xBC
FORMATS = frozenset("bBhHiIqQefd")
_SHORTEST = 9


@dataclass(frozen=True, kw_only=True, eq=False)
class Event:
    """Records of one event type: times in units of `unit_us`, and variables by name."""

    name: str
    times: Annotated[np.ndarray, "records"]
    unit_us: float
    columns: Mapping[str, Annotated[np.ndarray, "records"]]


def decode(data: bytes, name: str) -> tuple[Event, ...]:
    """Return the records of a uSD log by event type, one or more.

    Raises ImportFormatError if the data is not a complete log: wrong mark, truncated, wrong checksum.
    """
    if data[:1] != bytes([MARK]):
        raise ImportFormatError(f"{name}: does not begin with 0xBC; not a Crazyflie uSD log")
    if len(data) < _SHORTEST or zlib.crc32(data[:-4]) != struct.unpack("<I", data[-4:])[0]:
        raise ImportFormatError(
            f"{name}: the checksum is wrong, the file is truncated or damaged; copy it from the card again"
        )
    try:
        return _decode(data[:-4], name)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise ImportFormatError(
            f"{name}: header or records do not fit ({error}); not a log of this format"
        ) from None


def _decode(data: bytes, name: str) -> tuple[Event, ...]:
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in (1, 2):
        raise ImportFormatError(f"{name}: format version {version} is not supported, only versions 1 and 2")
    stamp, unit_us = ("I", 1000.0) if version == 1 else ("Q", 1.0)
    offset = 5
    types: dict[int, tuple[str, list[str], struct.Struct]] = {}
    for _ in range(count):
        (kind,) = struct.unpack_from("<H", data, offset)
        title, offset = _string(data, offset + 2)
        (variables,) = struct.unpack_from("<H", data, offset)
        offset += 2
        names, layout = [], f"<{stamp}"
        for _ in range(variables):
            text, offset = _string(data, offset)
            variable, letter = text[:-3], text[-2:-1]
            if text[-3:] != f"({letter})" or letter not in FORMATS:
                raise ImportFormatError(
                    f"{name}: variable {text!r} has no format letter of {' '.join(sorted(FORMATS))}; "
                    "not a log of this format"
                )
            names.append(variable)
            layout += letter
        if kind in types:
            raise ImportFormatError(f"{name}: event type {kind} is declared twice; not a log of this format")
        types[kind] = (title, names, struct.Struct(layout))
    if not types:
        raise ImportFormatError(f"{name}: no event type; nothing was logged")
    rows: dict[int, list[tuple]] = {kind: [] for kind in types}
    records, limit = 0, USD_RECORDS.limit_of(len(data))
    while offset < len(data):
        (kind,) = struct.unpack_from("<H", data, offset)
        if kind not in types:
            raise ImportFormatError(
                f"{name}: record of unknown type {kind} at byte {offset}; not a log of this format"
            )
        records += 1
        if records > limit:
            raise ImportFormatError(f"{name}: {USD_RECORDS.problem(limit=limit)}")
        packer = types[kind][2]
        rows[kind].append(packer.unpack_from(data, offset + 2))
        offset += 2 + packer.size
    return tuple(
        Event(
            name=title,
            times=np.array([row[0] for row in rows[kind]], dtype=float),
            unit_us=unit_us,
            columns={
                column: np.array([row[1 + i] for row in rows[kind]], dtype=float)
                for i, column in enumerate(names)
            },
        )
        for kind, (title, names, _) in types.items()
    )


def _string(data: bytes, offset: int) -> tuple[str, int]:
    """Return the NUL-terminated text at `offset` and the offset after it."""
    end = data.find(b"\0", offset)
    if end < 0:
        raise IndexError("a text without an end")
    return data[offset:end].decode("ascii"), end + 1
