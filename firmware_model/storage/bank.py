"""A bank of the non-volatile memory: a log of the blob's progress, its chunks, and a mark for each chunk.

The log is a sector to which records are appended, each with its own checksum. A partly written record is
invalid, and the next record follows it. A mark is the checksum of its chunk and is written after the chunk: a
partly written chunk has no mark, and a partly written mark does not match.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

from trimtab.firmware_model.storage.flash import ERASED, SECTOR_BYTES, Flash
from trimtab.protocol.upload.transfer import CHUNK_SIZES, chunk_count

SLOT_BYTES = 64
SLOTS = SECTOR_BYTES // SLOT_BYTES
_RECORD = struct.Struct("<BBBxII32s")
_CRC = struct.Struct("<I")
_CHUNK_BYTES_MIN = min(CHUNK_SIZES)
_NO_MARK = ERASED * _CRC.size


class Step(IntEnum):
    """Progress of the blob in a bank."""

    BEGUN = 1
    STAGED = 2
    LIVE = 3


class Record(NamedTuple):
    """A record of the log. `sequence` increases over all banks of a memory; the digest is a SHA-256.

    chunk_bytes: size of the chunks in which the blob is received.
    """

    step: Step
    kind: int
    chunk_bytes: int
    sequence: int
    size: int
    digest: bytes


class Bank:
    """A bank for blobs of one kind and up to `blob_bytes`, from address `start` on."""

    def __init__(self, flash: Flash, start: int, kind: int, blob_bytes: int) -> None:
        self.kind = kind
        self._flash = flash
        self._blob_bytes = blob_bytes
        self._log = start
        self._marks = start + SECTOR_BYTES
        self._data = self._marks + _marks_bytes(blob_bytes)

    @staticmethod
    def bytes_of(blob_bytes: int) -> int:
        """Return the size in memory of a bank for blobs of up to `blob_bytes`."""
        return SECTOR_BYTES + _marks_bytes(blob_bytes) + _sectors(blob_bytes)

    # The log.

    def records(self) -> list[Record]:
        """Return the valid records, oldest first."""
        records = []
        for start in self._written_slots():
            raw = self._flash.read(start, _RECORD.size + _CRC.size)
            body = raw[: _RECORD.size]
            if _CRC.pack(zlib.crc32(body)) != raw[_RECORD.size :]:
                continue
            step, kind, chunk_bytes, sequence, size, digest = _RECORD.unpack(body)
            known = step in tuple(Step) and kind == self.kind and chunk_bytes in CHUNK_SIZES
            if known and 0 < size <= self._blob_bytes:
                records.append(Record(Step(step), kind, chunk_bytes, sequence, size, digest))
        return records

    def last(self) -> Record | None:
        """Return the newest valid record, or None."""
        return next(reversed(self.records()), None)

    def unreadable(self) -> bool:
        """Return whether the log was written but has no valid record."""
        return not self.records() and not self._flash.blank_at(self._log, SECTOR_BYTES)

    def slots_free(self) -> int:
        """Return the number of free records in the log."""
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
        """Yield the addresses of the records. The first blank slot ends the log."""
        for start in range(self._log, self._log + SECTOR_BYTES, SLOT_BYTES):
            if self._flash.blank_at(start, SLOT_BYTES):
                return
            yield start

    # The blob.

    def forget(self) -> None:
        """Erase the log and thereby empty the bank."""
        self._flash.erase(self._log, SECTOR_BYTES)

    def erase(self, size: int) -> None:
        """Erase the memory for a blob of `size` bytes, the log first."""
        self.forget()
        self._flash.erase(self._marks, _marks_bytes(size))
        self._flash.erase(self._data, size)

    def put(self, blob: Record, index: int, chunk: bytes) -> None:
        """Store a chunk, then mark it."""
        self._flash.program(self._data + index * blob.chunk_bytes, chunk)
        self._flash.program(self._marks + index * _CRC.size, _mark(blob, chunk))

    def held(self, blob: Record) -> bytearray:
        """Return one byte for each chunk of the blob: 1 if it is stored and matches its mark."""
        held = bytearray(chunk_count(blob.size, blob.chunk_bytes))
        data, step = self.data(blob), blob.chunk_bytes
        for index in range(len(held)):
            mark = self._flash.read(self._marks + index * _CRC.size, _CRC.size)
            chunk = data[index * step : (index + 1) * step]
            held[index] = mark != _NO_MARK and mark == _mark(blob, chunk)
        return held

    def data(self, blob: Record) -> bytes:
        """Return the memory of the blob, complete or not."""
        return self._flash.read(self._data, blob.size)

    def whole(self, blob: Record) -> bytes | None:
        """Return the blob, or None if its bytes do not match its digest."""
        data = self.data(blob)
        return data if hashlib.sha256(data).digest() == blob.digest else None


def _mark(blob: Record, chunk: bytes) -> bytes:
    """Return the checksum of a chunk, which depends on the blob's digest."""
    return _CRC.pack(zlib.crc32(chunk, zlib.crc32(blob.digest)))


def _marks_bytes(size: int) -> int:
    """Return the size of the sectors for the marks of a blob of `size` bytes in chunks of any size."""
    return _sectors(_CRC.size * chunk_count(size, _CHUNK_BYTES_MIN))


def _sectors(size: int) -> int:
    return -(-size // SECTOR_BYTES) * SECTOR_BYTES
