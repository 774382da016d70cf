"""Non-volatile memory of the flight MCU: two banks for each kind of blob, one of them live.

A blob is written into the bank that is not live, so a half-written one never takes the place of what flies; a
commit turns one header over and is therefore whole or not there at all. The store outlives a power cycle:
construct the next FlightMcu with the same one.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from protocol.blobs import BLOB_BYTES_MAX


@dataclass(frozen=True, kw_only=True)
class _Header:
    """What the banks of one kind hold: which is live, and the digest of what is staged in the other."""

    live: int | None = None
    staged: str | None = None


class ReferenceStore:
    """Live and staged blobs, by kind. Kinds are the small integers of the blobs' own headers.

    Args:
        bank_bytes: size of one bank.
    """

    def __init__(self, *, bank_bytes: int = BLOB_BYTES_MAX) -> None:
        if bank_bytes <= 0:
            raise ValueError(f"bank_bytes must be positive, not {bank_bytes}")
        self.bank_bytes = bank_bytes
        self._banks: dict[tuple[int, int], bytes] = {}
        self._headers: dict[int, _Header] = {}

    def live(self, kind: int) -> bytes | None:
        """Bytes of the live blob of this kind, None where there is none."""
        live = self._header(kind).live
        return None if live is None else self._banks[kind, live]

    def staged(self, kind: int) -> bytes | None:
        """Bytes of the staged blob of this kind, None where nothing waits."""
        header = self._header(kind)
        return None if header.staged is None else self._banks[kind, _other(header.live)]

    def stage(self, kind: int, blob: bytes) -> str:
        """SHA-256 (hex) of `blob`, which now lies in the bank that is not live.

        Raises ValueError where the blob is empty or larger than a bank.
        """
        if not 0 < len(blob) <= self.bank_bytes:
            raise ValueError(f"a blob must have 1 to {self.bank_bytes} bytes, not {len(blob)}")
        header = self._header(kind)
        self._headers[kind] = _Header(live=header.live)  # nothing is staged while the bank is being written
        self._banks[kind, _other(header.live)] = bytes(blob)
        digest = hashlib.sha256(blob).hexdigest()
        self._headers[kind] = _Header(live=header.live, staged=digest)
        return digest

    def commit(self, kind: int) -> bytes:
        """The blob that has become live: the staged one, read back and checked against its digest.

        Raises ValueError where nothing is staged or the bank no longer holds what was staged.
        """
        header = self._header(kind)
        bank = _other(header.live)
        blob = self._banks.get((kind, bank), b"")
        if header.staged is None:
            raise ValueError("nothing is staged")
        if hashlib.sha256(blob).hexdigest() != header.staged:
            raise ValueError("the staged bank is damaged")
        self._headers[kind] = _Header(live=bank)
        return blob

    def discard(self, kind: int) -> None:
        """Nothing comes back; what was staged is forgotten, what is live stays."""
        self._headers[kind] = _Header(live=self._header(kind).live)

    def clear(self, kind: int) -> None:
        """Nothing comes back; neither live nor staged blob of this kind is left."""
        self._headers[kind] = _Header()

    def _header(self, kind: int) -> _Header:
        return self._headers.get(kind, _Header())


def _other(live: int | None) -> int:
    return 1 if live == 0 else 0
