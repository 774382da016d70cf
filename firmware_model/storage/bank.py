"""One bank of the non-volatile memory: the log of what became of a blob, its chunks, a mark for each chunk.

The log is a sector of records that are only ever appended, each with a checksum of its own: a torn one does
not count, and the next goes behind it. A mark is the checksum of its chunk, written after it: a torn chunk
has none, and a torn mark matches nothing.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

from trimtab.firmware_model.storage.flash import ERASED, SECTOR_BYTES, Flash
from trimtab.protocol.upload.transfer import CHUNK_BYTES, chunk_count

SLOT_BYTES = 64
SLOTS = SECTOR_BYTES // SLOT_BYTES
_RECORD = struct.Struct("<BB2xII32s")
_CRC = struct.Struct("<I")
_NO_MARK = ERASED * _CRC.size


class Step(IntEnum):
    """What became of the blob in a bank."""

    BEGUN = 1
    STAGED = 2
    LIVE = 3


class Record(NamedTuple):
    """One line of the log. `sequence` grows over all banks of a memory; the digest is of SHA-256."""

    step: Step
    kind: int
    sequence: int
    size: int
    digest: bytes


class Bank:
    """A bank of `blob_bytes` for blobs of one kind, from `start` on."""

    def __init__(self, flash: Flash, start: int, kind: int, blob_bytes: int) -> None:
        self.kind = kind
        self._flash = flash
        self._blob_bytes = blob_bytes
        self._log = start
        self._marks = start + SECTOR_BYTES
        self._data = self._marks + _sectors(_CRC.size * chunk_count(blob_bytes))

    @staticmethod
    def bytes_of(blob_bytes: int) -> int:
        """Bytes of memory that a bank for blobs of this size takes."""
        return SECTOR_BYTES + _sectors(_CRC.size * chunk_count(blob_bytes)) + _sectors(blob_bytes)

    # The log.

    def records(self) -> list[Record]:
        """Return the valid records, oldest first."""
        found = []
        for start in self._written_slots():
            raw = self._flash.read(start, _RECORD.size + _CRC.size)
            body = raw[: _RECORD.size]
            if _CRC.pack(zlib.crc32(body)) != raw[_RECORD.size :]:
                continue
            step, kind, sequence, size, digest = _RECORD.unpack(body)
            if step in tuple(Step) and kind == self.kind and 0 < size <= self._blob_bytes:
                found.append(Record(Step(step), kind, sequence, size, digest))
        return found

    def last(self) -> Record | None:
        """Return the newest valid record."""
        return next(reversed(self.records()), None)

    def unreadable(self) -> bool:
        """Whether the log was written and none of it makes sense."""
        return not self.records() and not self._flash.blank_at(self._log, SECTOR_BYTES)

    def slots_free(self) -> int:
        """Return records that the log still has room for."""
        return SLOTS - len(list(self._written_slots()))

    def append(self, record: Record) -> None:
        """Append the newest record. Raises ValueError if the log is full."""
        free = self.slots_free()
        if not free:
            raise ValueError("the log of the bank is full")
        start = self._log + (SLOTS - free) * SLOT_BYTES
        body = _RECORD.pack(*record)
        self._flash.program(start, body + _CRC.pack(zlib.crc32(body)))

    def _written_slots(self) -> Iterator[int]:
        """Where the records stand; a slot that was never written ends the log."""
        for start in range(self._log, self._log + SECTOR_BYTES, SLOT_BYTES):
            if self._flash.blank_at(start, SLOT_BYTES):
                return
            yield start

    # The blob.

    def forget(self) -> None:
        """Empty the log, and with it the bank."""
        self._flash.erase(self._log, SECTOR_BYTES)

    def erase(self, size: int) -> None:
        """Make room for a blob of `size` bytes. The log is erased first."""
        self.forget()
        self._flash.erase(self._marks, _CRC.size * chunk_count(size))
        self._flash.erase(self._data, size)

    def put(self, blob: Record, index: int, chunk: bytes) -> None:
        """Store the chunk, then mark it."""
        self._flash.program(self._data + index * CHUNK_BYTES, chunk)
        self._flash.program(self._marks + index * _CRC.size, _mark(blob, chunk))

    def held(self, blob: Record) -> bytearray:
        """One byte for each chunk of the blob: 1 where it is here and matches its mark."""
        held = bytearray(chunk_count(blob.size))
        data = self.data(blob)
        for index in range(len(held)):
            mark = self._flash.read(self._marks + index * _CRC.size, _CRC.size)
            chunk = data[index * CHUNK_BYTES : (index + 1) * CHUNK_BYTES]
            held[index] = mark != _NO_MARK and mark == _mark(blob, chunk)
        return held

    def data(self, blob: Record) -> bytes:
        """Return what stands where the blob should, whole or not."""
        return self._flash.read(self._data, blob.size)

    def whole(self, blob: Record) -> bytes | None:
        """Return the blob, None where its bytes do not make its digest."""
        data = self.data(blob)
        return data if hashlib.sha256(data).digest() == blob.digest else None


def _mark(blob: Record, chunk: bytes) -> bytes:
    """Checksum of a chunk of this blob and no other."""
    return _CRC.pack(zlib.crc32(chunk, zlib.crc32(blob.digest)))


def _sectors(size: int) -> int:
    return -(-size // SECTOR_BYTES) * SECTOR_BYTES
