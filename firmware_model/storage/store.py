"""Non-volatile store of the flight MCU: blobs, an upload in progress, changed parameters, and signing key.

There are two banks for each kind of blob, and one of them is live. A blob is received, checked and staged in
the other bank. A single record then makes it live, and this write is atomic. Data with a wrong checksum is
invalid: the live blob is the newest committed one; if it is damaged, the one before. All state is in
the flash, so a new store on the same flash continues where the previous one ended.
"""

from __future__ import annotations

import hashlib

from trimtab.firmware_model.storage.bank import Bank, Record, Step
from trimtab.firmware_model.storage.flash import SECTOR_BYTES, Flash
from trimtab.firmware_model.storage.settings import SETTINGS_BYTES, Settings
from trimtab.firmware_model.storage.signing_store import SIGNING_BYTES, SigningStore
from trimtab.protocol.blobs import BLOB_BYTES_MAX, Kind
from trimtab.protocol.upload import CHUNK_BYTES, Incoming

MAGIC = b"trimtab memory 2"
"""First bytes of a memory; the number identifies its layout."""
_SIGNING_AT = SECTOR_BYTES + SETTINGS_BYTES
_BANKS_AT = _SIGNING_AT + SIGNING_BYTES
_SLOTS_SPARE = 2  # log records still needed: STAGED and LIVE


def memory_bytes(blob_bytes_max: int = BLOB_BYTES_MAX) -> int:
    """Return the size of the flash for a store of blobs up to this length."""
    return _BANKS_AT + 2 * len(Kind) * Bank.bytes_of(blob_bytes_max)


class ReferenceStore:
    """References, feed-forwards, uploads in progress, parameters changed by the user, and signing key.

    Each kind of blob (`blobs.Kind`) may have a live blob and one that is received or staged.

    Every method that writes raises PowerCut if power fails.

    Parameters
    ----------
    flash
        Memory of `memory_bytes(blob_bytes_max)`; blank by default. A memory that does not start with MAGIC is
        erased.
    blob_bytes_max
        Longest blob, in bytes.

    Attributes
    ----------
    faults
        Texts that report damaged data.
    settings
        Parameters changed by the user.
    signing
        Key of message signing.
    """

    def __init__(self, flash: Flash | None = None, *, blob_bytes_max: int = BLOB_BYTES_MAX) -> None:
        if blob_bytes_max <= 0:
            raise ValueError(f"blob_bytes_max must be positive, not {blob_bytes_max}")
        flash = flash or Flash.blank(memory_bytes(blob_bytes_max))
        if len(flash.image) != memory_bytes(blob_bytes_max):
            raise ValueError(f"the memory needs {memory_bytes(blob_bytes_max)} bytes, not {len(flash.image)}")
        self.flash = flash
        self.blob_bytes_max = blob_bytes_max
        self.faults: list[str] = []
        if flash.read(0, len(MAGIC)) != MAGIC:
            self._format()
        self.settings = Settings(flash, SECTOR_BYTES)
        if self.settings.damaged:
            self.faults.append("memory: parameters changed by the user are lost")
        self.signing = SigningStore(flash, _SIGNING_AT)
        if self.signing.damaged:
            self.faults.append("memory: the signing key is lost")
        self._banks: dict[int, tuple[Bank, Bank]] = {}
        start = _BANKS_AT
        for kind in Kind:
            first = Bank(flash, start, kind, blob_bytes_max)
            second = Bank(flash, start + Bank.bytes_of(blob_bytes_max), kind, blob_bytes_max)
            self._banks[kind] = (first, second)
            start += 2 * Bank.bytes_of(blob_bytes_max)
        self._not_live: dict[int, tuple[Bank, Record]] = {}  # received or staged, by kind
        self._sequence = 0
        for kind in Kind:
            self._inspect(kind)

    # Live and staged blobs.

    def live(self, kind: int) -> bytes | None:
        """Return the bytes of the live blob of this kind, or None."""
        live = self._live(kind)
        return None if live is None else live[1]

    def staged(self, kind: int) -> bytes | None:
        """Return the bytes of the staged blob of this kind, or None."""
        if kind not in self._not_live:
            return None
        bank, record = self._not_live[kind]
        return bank.whole(record) if record.step is Step.STAGED else None

    def stage(self, kind: int, blob: bytes) -> str:
        """Stage `blob` in the bank that is not live and return its SHA-256 (hex).

        A blob that was received in full is not written again. Raises ValueError if the blob is empty or
        larger than a bank.
        """
        digest = hashlib.sha256(blob).digest()
        opened = self._not_live.get(kind)
        if opened is None or opened[0].whole(opened[1]) != blob or opened[0].slots_free() < _SLOTS_SPARE:
            self.begin(kind, len(blob), digest)
            for start in range(0, len(blob), CHUNK_BYTES):
                self.put(kind, start // CHUNK_BYTES, blob[start : start + CHUNK_BYTES])
        bank, record = self._not_live[kind]
        if record.step is not Step.STAGED:
            self._not_live[kind] = bank, self._append(bank, record, Step.STAGED)
        return digest.hex()

    def commit(self, kind: int) -> bytes:
        """Make the staged blob live and return it, read back and checked against its digest.

        Raises ValueError if no blob is staged or the bank is damaged.
        """
        bank, record = self._not_live.get(kind, (None, None))
        if bank is None or record is None or record.step is not Step.STAGED:
            raise ValueError("no blob is staged")
        blob = bank.whole(record)
        if blob is None:
            raise ValueError("the staged bank is damaged")
        self._append(bank, record, Step.LIVE)
        del self._not_live[kind]
        return blob

    def discard(self, kind: int) -> None:
        """Discard the received or staged blob of this kind; the live blob stays."""
        if kind in self._not_live:
            self._not_live.pop(kind)[0].forget()

    def clear(self, kind: int) -> None:
        """Remove both the live and the staged blob of this kind."""
        self._not_live.pop(kind, None)
        live = self._live(kind)
        for bank in sorted(self._banks[kind], key=lambda bank: live is not None and bank is live[0]):
            bank.forget()  # the live bank last; otherwise its predecessor would become live again

    # An upload in progress.

    def incoming(self) -> Incoming | None:
        """Return the newest blob that is being received or staged, with its held chunks, or None."""
        if not self._not_live:
            return None
        bank, record = max(self._not_live.values(), key=lambda opened: opened[1].sequence)
        return Incoming(record.kind, record.size, record.digest, record.chunk_bytes, bank.held(record))

    def begin(self, kind: int, size: int, digest: bytes, chunk_bytes: int = CHUNK_BYTES) -> None:
        """Discard the received or staged blob of this kind and prepare for another one.

        Raises ValueError if the blob is empty or larger than a bank.
        """
        if not 0 < size <= self.blob_bytes_max:
            raise ValueError(f"a blob must have 1 to {self.blob_bytes_max} bytes, not {size}")
        self._not_live.pop(kind, None)
        live = self._live(kind)
        bank = next(bank for bank in self._banks[kind] if live is None or bank is not live[0])
        bank.erase(size)
        record = Record(Step.BEGUN, kind, chunk_bytes, 0, size, digest)
        self._not_live[kind] = bank, self._append(bank, record, Step.BEGUN)

    def put(self, kind: int, index: int, chunk: bytes) -> None:
        """Store a chunk of the blob being received, so that it survives a power cut."""
        bank, record = self._not_live[kind]
        bank.put(record, index, chunk)

    def received(self, kind: int) -> bytes:
        """Return the bytes in memory of the blob being received, complete or not."""
        bank, record = self._not_live[kind]
        return bank.data(record)

    # Internals.

    def _live(self, kind: int) -> tuple[Bank, bytes] | None:
        """Return the bank with the newest committed blob that is intact, and that blob."""
        banks = [(bank.last(), bank) for bank in self._banks[kind]]
        committed = [(last, bank) for last, bank in banks if last is not None and last.step is Step.LIVE]
        for record, bank in sorted(committed, key=lambda entry: -entry[0].sequence):
            blob = bank.whole(record)
            if blob is not None:
                return bank, blob
        return None

    def _append(self, bank: Bank, record: Record, step: Step) -> Record:
        self._sequence += 1
        record = record._replace(step=step, sequence=self._sequence)
        bank.append(record)
        return record

    def _inspect(self, kind: int) -> None:
        """Restore the open upload of this kind after power-up and record damaged banks."""
        for bank in self._banks[kind]:
            last = bank.last()
            if last is None:
                if bank.unreadable():
                    self.faults.append(f"memory: a {Kind(kind).name.lower()} bank is unreadable")
                continue
            self._sequence = max(self._sequence, last.sequence)
            if last.step is Step.LIVE:
                if bank.whole(last) is None:
                    self.faults.append(f"memory: a {Kind(kind).name.lower()} is damaged")
            elif kind not in self._not_live or self._not_live[kind][1].sequence < last.sequence:
                self._not_live[kind] = bank, last

    def _format(self) -> None:
        """Erase the memory and write its header last."""
        flash = self.flash
        if not flash.blank_at(0, len(flash.image)):
            self.faults.append("memory damaged and erased: nothing is live")
            flash.erase(0, len(flash.image))
        flash.program(0, MAGIC)
