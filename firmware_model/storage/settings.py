"""Parameters in non-volatile memory: vehicle id and set values, stored together in one of two sectors.

A change is written to the inactive sector with a checksum and a sequence number. After an interrupted write
the other sector stays active.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import NamedTuple

from trimtab.firmware_model.storage.flash import SECTOR_BYTES, Flash

SETTINGS_BYTES = 2 * SECTOR_BYTES
_CRC = struct.Struct("<I")
_HEAD = struct.Struct("<IH6s")
_ROW = struct.Struct("<16sf")
ROWS_MAX = (SECTOR_BYTES - _CRC.size - _HEAD.size) // _ROW.size


class _Stored(NamedTuple):
    sequence: int
    sector: int
    vehicle_id: bytes
    values: dict[str, float]


class Settings:
    """Parameters stored from address `start` on.

    Attributes
    ----------
    damaged
        Whether the memory was written but neither sector is valid.
    """

    def __init__(self, flash: Flash, start: int) -> None:
        self._flash = flash
        self._start = start
        valid = [stored for sector in (0, 1) if (stored := self._read(sector)) is not None]
        self._stored = max(valid, default=None)
        self.damaged = not valid and not flash.blank_at(start, SETTINGS_BYTES)

    @property
    def vehicle_id(self) -> bytes | None:
        """Id (6 B) of the vehicle file that the values belong to; None before the first `keep`."""
        return None if self._stored is None else self._stored.vehicle_id

    @property
    def values(self) -> dict[str, float]:
        """Values that were set, by name."""
        return {} if self._stored is None else dict(self._stored.values)

    def keep(self, vehicle_id: bytes, values: Mapping[str, float]) -> None:
        """Store these values. After a power cut during the write, the previous values may be active.

        Raises ValueError for more than ROWS_MAX values.
        """
        if len(values) > ROWS_MAX:
            raise ValueError(f"at most {ROWS_MAX} parameters fit, not {len(values)}")
        sequence, sector = 1, 0
        if self._stored is not None:
            sequence, sector = self._stored.sequence + 1, 1 - self._stored.sector
        body = _HEAD.pack(sequence, len(values), vehicle_id)
        body += b"".join(_ROW.pack(name.encode(), value) for name, value in values.items())
        start = self._start + sector * SECTOR_BYTES
        self._flash.erase(start, SECTOR_BYTES)
        self._flash.program(start, _CRC.pack(zlib.crc32(body)) + body)
        self._stored = _Stored(sequence, sector, vehicle_id, dict(values))

    def change(self, name: str, value: float) -> None:
        """Store one changed value together with the others. Raises ValueError like `keep`."""
        if self._stored is not None and self._stored.values.get(name) != value:
            self.keep(self._stored.vehicle_id, {**self._stored.values, name: value})

    def _read(self, sector: int) -> _Stored | None:
        raw = self._flash.read(self._start + sector * SECTOR_BYTES, SECTOR_BYTES)
        sequence, count, vehicle_id = _HEAD.unpack_from(raw, _CRC.size)
        body = raw[_CRC.size : _CRC.size + _HEAD.size + min(count, ROWS_MAX) * _ROW.size]
        if _CRC.pack(zlib.crc32(body)) != raw[: _CRC.size]:
            return None
        values = {}
        for name, value in _ROW.iter_unpack(body[_HEAD.size :]):
            values[name.rstrip(b"\0").decode("ascii", "replace")] = value
        return _Stored(sequence, sector, vehicle_id, values)
