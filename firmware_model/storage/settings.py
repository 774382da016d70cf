"""Parameters in non-volatile memory: whose they are and what was set, as a whole in one of two sectors.

A change is written to the sector that is not in force, with a checksum and a sequence number; a torn write
leaves the other one in force.
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


class _Kept(NamedTuple):
    sequence: int
    sector: int
    vehicle_id: bytes
    values: dict[str, float]


class Settings:
    """What is kept from `start` on.

    Attributes
    ----------
    damaged
        whether something was written there that makes no sense.
    """

    def __init__(self, flash: Flash, start: int) -> None:
        self._flash = flash
        self._start = start
        found = [kept for sector in (0, 1) if (kept := self._read(sector)) is not None]
        self._kept = max(found, default=None)
        self.damaged = not found and not flash.blank_at(start, SETTINGS_BYTES)

    @property
    def vehicle_id(self) -> bytes | None:
        """Id of the vehicle file (6 B) that the values belong to, None where nothing was ever kept."""
        return None if self._kept is None else self._kept.vehicle_id

    @property
    def values(self) -> dict[str, float]:
        """What was set, by name."""
        return {} if self._kept is None else dict(self._kept.values)

    def keep(self, vehicle_id: bytes, values: Mapping[str, float]) -> None:
        """Put these values in force; after a power failure the values before may be.

        Raises ValueError for more values than there is room for.
        """
        if len(values) > ROWS_MAX:
            raise ValueError(f"there is room for {ROWS_MAX} parameters, not {len(values)}")
        sequence, sector = (1, 0) if self._kept is None else (self._kept.sequence + 1, 1 - self._kept.sector)
        body = _HEAD.pack(sequence, len(values), vehicle_id)
        body += b"".join(_ROW.pack(name.encode(), value) for name, value in values.items())
        start = self._start + sector * SECTOR_BYTES
        self._flash.erase(start, SECTOR_BYTES)
        self._flash.program(start, _CRC.pack(zlib.crc32(body)) + body)
        self._kept = _Kept(sequence, sector, vehicle_id, dict(values))

    def change(self, name: str, value: float) -> None:
        """Change one value and keep the others. Raises as `keep` does."""
        if self._kept is not None and self._kept.values.get(name) != value:
            self.keep(self._kept.vehicle_id, {**self._kept.values, name: value})

    def _read(self, sector: int) -> _Kept | None:
        raw = self._flash.read(self._start + sector * SECTOR_BYTES, SECTOR_BYTES)
        sequence, count, vehicle_id = _HEAD.unpack_from(raw, _CRC.size)
        body = raw[_CRC.size : _CRC.size + _HEAD.size + min(count, ROWS_MAX) * _ROW.size]
        if _CRC.pack(zlib.crc32(body)) != raw[: _CRC.size]:
            return None
        values = {}
        for name, value in _ROW.iter_unpack(body[_HEAD.size :]):
            values[name.rstrip(b"\0").decode("ascii", "replace")] = value
        return _Kept(sequence, sector, vehicle_id, values)
