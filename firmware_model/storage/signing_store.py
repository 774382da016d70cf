"""Signing key in non-volatile memory, with the greatest timestamp that may have been used.

The key is in one of two sectors, followed by a log of timestamps. An entry of the log is written before a
message with a later timestamp is sent or obeyed, and it lies STEP ahead, so that the memory is written
rarely. After a restart, everything up to the last entry counts as used: no message is accepted twice, and
none is signed twice with the same timestamp.

A full log moves to the other sector. This also happens at power-up to a log that is half full, so that no
sector is erased in a flight of less than two hours. The former sector is erased at once, so that no old key
remains.
"""

from __future__ import annotations

import struct
import zlib
from typing import NamedTuple

from trimtab.firmware_model.storage.flash import SECTOR_BYTES, Flash
from trimtab.protocol.signing import SigningKey

SIGNING_BYTES = 2 * SECTOR_BYTES
STEP = 6_000_000
"""Distance of a log entry from the timestamp that caused it: 60 s."""
_CRC = struct.Struct("<I")
_HEAD = struct.Struct("<I32sQ")  # sequence, key, first timestamp
_ENTRY = struct.Struct("<QI")
_LOG_AT = 64
_ENTRIES = (SECTOR_BYTES - _LOG_AT) // _ENTRY.size


class _Stored(NamedTuple):
    sequence: int
    sector: int
    key: SigningKey
    used: int


class SigningStore:
    """Signing key and used timestamps, stored from address `start` on.

    Every method that writes raises PowerCut if power fails.

    Attributes
    ----------
    damaged
        Whether the memory was written but holds no valid key.
    """

    def __init__(self, flash: Flash, start: int) -> None:
        self._flash = flash
        self._start = start
        valid = [stored for sector in (0, 1) if (stored := self._read(sector)) is not None]
        self._stored = max(valid, key=lambda stored: stored.sequence, default=None)
        self.damaged = not valid and not flash.blank_at(start, SIGNING_BYTES)
        if self._stored is None:
            return
        if 2 * self._entries(self._stored.sector) > _ENTRIES:
            self.keep(self._stored.key, self._stored.used)
        self._erase_former(self._stored.sector)

    @property
    def key(self) -> SigningKey | None:
        """The key, or None."""
        return None if self._stored is None else self._stored.key

    @property
    def used(self) -> int:
        """Greatest timestamp that may have been used with the key; 0 without a key."""
        return 0 if self._stored is None else self._stored.used

    def keep(self, key: SigningKey, used: int) -> None:
        """Store a key and the greatest timestamp that may have been used with it. Erase the former key."""
        sequence, sector = 1, 0
        if self._stored is not None:
            sequence, sector = self._stored.sequence + 1, 1 - self._stored.sector
        body = _HEAD.pack(sequence, key.secret, used)
        start = self._start + sector * SECTOR_BYTES
        self._flash.erase(start, SECTOR_BYTES)
        self._flash.program(start, body + _CRC.pack(zlib.crc32(body)))
        self._erase_former(sector)
        self._stored = _Stored(sequence, sector, key, used)
        self.damaged = False

    def reserve(self, timestamp: int) -> None:
        """Make sure that `timestamp` counts as used after a restart. Without a key nothing is stored."""
        stored = self._stored
        if stored is None or timestamp <= stored.used:
            return
        used, count = timestamp + STEP, self._entries(stored.sector)
        if count == _ENTRIES:
            self.keep(stored.key, used)
            return
        entry = used.to_bytes(8, "little")
        self._flash.program(self._entry_at(stored.sector, count), entry + _CRC.pack(zlib.crc32(entry)))
        self._stored = stored._replace(used=used)

    def forget(self) -> None:
        """Erase the key."""
        active = 0 if self._stored is None else self._stored.sector
        for sector in (1 - active, active):  # the active one last: a former key never becomes valid again
            self._flash.erase(self._start + sector * SECTOR_BYTES, SECTOR_BYTES)
        self._stored = None
        self.damaged = False

    def _erase_former(self, sector: int) -> None:
        """Erase the sector beside the active one unless it is blank."""
        former = self._start + (1 - sector) * SECTOR_BYTES
        if not self._flash.blank_at(former, SECTOR_BYTES):
            self._flash.erase(former, SECTOR_BYTES)

    def _entry_at(self, sector: int, index: int) -> int:
        return self._start + sector * SECTOR_BYTES + _LOG_AT + index * _ENTRY.size

    def _entries(self, sector: int) -> int:
        """Return the number of entries in a sector's log, including damaged ones."""
        for index in range(_ENTRIES):
            if self._flash.blank_at(self._entry_at(sector, index), _ENTRY.size):
                return index
        return _ENTRIES

    def _read(self, sector: int) -> _Stored | None:
        raw = self._flash.read(self._start + sector * SECTOR_BYTES, SECTOR_BYTES)
        body = raw[: _HEAD.size]
        if _CRC.pack(zlib.crc32(body)) != raw[_HEAD.size : _HEAD.size + _CRC.size]:
            return None
        sequence, secret, used = _HEAD.unpack(body)
        log = raw[_LOG_AT : _LOG_AT + self._entries(sector) * _ENTRY.size]
        valid = [
            value for value, crc in _ENTRY.iter_unpack(log) if zlib.crc32(value.to_bytes(8, "little")) == crc
        ]
        return _Stored(sequence, sector, SigningKey(secret), max((used, *valid)))
