"""What the flight MCU keeps over a power cut: blobs, an upload in progress, parameters that were set.

There are two banks for each kind of blob, one of them live. A blob is gathered, checked and staged in the
bank that is not live; one record then makes it live and is whole or not there at all. Nothing is believed
that does not make its checksum: what is live is the newest blob that was committed and is whole, else the one
before it. The store holds no truth of its own; construct the next one on the same flash.
"""

from __future__ import annotations

import hashlib

from trimtab.firmware_model.storage.bank import Bank, Record, Step
from trimtab.firmware_model.storage.flash import SECTOR_BYTES, Flash
from trimtab.firmware_model.storage.settings import SETTINGS_BYTES, Settings
from trimtab.protocol.blobs import BLOB_BYTES_MAX, Kind
from trimtab.protocol.upload import CHUNK_BYTES, Incoming

MAGIC = b"trimtab memory 1"
"""What a memory begins with; the number is that of its layout."""
_SLOTS_SPARE = 2


def memory_bytes(bank_bytes: int = BLOB_BYTES_MAX) -> int:
    """Bytes of flash that a store with banks of this size takes."""
    return SECTOR_BYTES + SETTINGS_BYTES + 2 * len(Kind) * Bank.bytes_of(bank_bytes)


class ReferenceStore:
    """Live and staged blobs and uploads in progress, by kind (`blobs.Kind`), and parameters that were set.

    Parameters
    ----------
    flash
        the memory, of `memory_bytes(bank_bytes)`; a blank one where not given. One that does not
        begin with MAGIC is made blank.
    bank_bytes
        size of one bank.

    Every method that writes raises PowerCut where power fails.

    Attributes
    ----------
    faults
        what was found damaged, a line for people each.
    settings
        parameters that were set.
    """

    def __init__(self, flash: Flash | None = None, *, bank_bytes: int = BLOB_BYTES_MAX) -> None:
        if bank_bytes <= 0:
            raise ValueError(f"bank_bytes must be positive, not {bank_bytes}")
        flash = flash or Flash.blank(memory_bytes(bank_bytes))
        if len(flash.image) != memory_bytes(bank_bytes):
            raise ValueError(f"the memory needs {memory_bytes(bank_bytes)} bytes, not {len(flash.image)}")
        self.flash = flash
        self.bank_bytes = bank_bytes
        self.faults: list[str] = []
        if flash.read(0, len(MAGIC)) != MAGIC:
            self._format()
        self.settings = Settings(flash, SECTOR_BYTES)
        if self.settings.damaged:
            self.faults.append("memory: parameters that were set are lost")
        self._banks: dict[int, tuple[Bank, Bank]] = {}
        start = SECTOR_BYTES + SETTINGS_BYTES
        for kind in Kind:
            first = Bank(flash, start, kind, bank_bytes)
            second = Bank(flash, start + Bank.bytes_of(bank_bytes), kind, bank_bytes)
            self._banks[kind] = (first, second)
            start += 2 * Bank.bytes_of(bank_bytes)
        self._open: dict[int, tuple[Bank, Record]] = {}
        self._sequence = 0
        for kind in Kind:
            self._look_at(kind)

    # What is live, and what is staged.

    def live(self, kind: int) -> bytes | None:
        """Bytes of the live blob of this kind, None where there is none."""
        found = self._live(kind)
        return None if found is None else found[1]

    def staged(self, kind: int) -> bytes | None:
        """Bytes of the staged blob of this kind, None where nothing waits."""
        if kind not in self._open:
            return None
        bank, record = self._open[kind]
        return bank.whole(record) if record.step is Step.STAGED else None

    def stage(self, kind: int, blob: bytes) -> str:
        """SHA-256 (hex) of `blob`, which now lies staged in the bank that is not live.

        What is gathered of it already is not written again.
        Raises ValueError where the blob is empty or larger than a bank.
        """
        digest = hashlib.sha256(blob).digest()
        opened = self._open.get(kind)
        if opened is None or opened[0].whole(opened[1]) != blob or opened[0].slots_free() < _SLOTS_SPARE:
            self.begin(kind, len(blob), digest)
            for start in range(0, len(blob), CHUNK_BYTES):
                self.put(kind, start // CHUNK_BYTES, blob[start : start + CHUNK_BYTES])
        bank, record = self._open[kind]
        if record.step is not Step.STAGED:
            self._open[kind] = bank, self._append(bank, record, Step.STAGED)
        return digest.hex()

    def commit(self, kind: int) -> bytes:
        """Return the blob that has become live: the staged one, read back and checked against its digest.

        Raises ValueError where nothing is staged or the bank no longer holds what was staged.
        """
        bank, record = self._open.get(kind, (None, None))
        if bank is None or record is None or record.step is not Step.STAGED:
            raise ValueError("nothing is staged")
        blob = bank.whole(record)
        if blob is None:
            raise ValueError("the staged bank is damaged")
        self._append(bank, record, Step.LIVE)
        del self._open[kind]
        return blob

    def discard(self, kind: int) -> None:
        """Forget what was gathered or staged; keep what is live."""
        if kind in self._open:
            self._open.pop(kind)[0].forget()

    def clear(self, kind: int) -> None:
        """Remove both the live and the staged blob of this kind."""
        self._open.pop(kind, None)
        live = self._live(kind)
        for bank in sorted(self._banks[kind], key=lambda bank: live is not None and bank is live[0]):
            bank.forget()  # the live one last, or the one before it would be live again

    # An upload in progress.

    def incoming(self) -> Incoming | None:
        """Return the newest blob that is gathered or staged, with the chunks that are here; None for none."""
        if not self._open:
            return None
        bank, record = max(self._open.values(), key=lambda opened: opened[1].sequence)
        return Incoming(record.kind, record.size, record.digest, bank.held(record))

    def begin(self, kind: int, size: int, digest: bytes) -> None:
        """Drop what was gathered of this kind and make room for another blob.

        Raises ValueError where the blob is empty or larger than a bank.
        """
        if not 0 < size <= self.bank_bytes:
            raise ValueError(f"a blob must have 1 to {self.bank_bytes} bytes, not {size}")
        self._open.pop(kind, None)
        live = self._live(kind)
        bank = next(bank for bank in self._banks[kind] if live is None or bank is not live[0])
        bank.erase(size)
        record = Record(Step.BEGUN, kind, 0, size, digest)
        self._open[kind] = bank, self._append(bank, record, Step.BEGUN)

    def put(self, kind: int, index: int, chunk: bytes) -> None:
        """Store this chunk of the blob that was begun, so that it survives a power cut."""
        bank, record = self._open[kind]
        bank.put(record, index, chunk)

    def received(self, kind: int) -> bytes:
        """Return the bytes of the blob that was begun, as they stand in memory, whole or not."""
        bank, record = self._open[kind]
        return bank.data(record)

    # Inside.

    def _live(self, kind: int) -> tuple[Bank, bytes] | None:
        """Return the bank with the newest committed blob that is whole, and that blob."""
        lives = [(bank.last(), bank) for bank in self._banks[kind]]
        committed = [(last, bank) for last, bank in lives if last is not None and last.step is Step.LIVE]
        for record, bank in sorted(committed, key=lambda live: -live[0].sequence):
            blob = bank.whole(record)
            if blob is not None:
                return bank, blob
        return None

    def _append(self, bank: Bank, record: Record, step: Step) -> Record:
        self._sequence += 1
        record = record._replace(step=step, sequence=self._sequence)
        bank.append(record)
        return record

    def _look_at(self, kind: int) -> None:
        """After power-up: what was open, and what is not as it should be."""
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
            elif kind not in self._open or self._open[kind][1].sequence < last.sequence:
                self._open[kind] = bank, last

    def _format(self) -> None:
        """Blank the memory except for its header, which is written last."""
        flash = self.flash
        if not flash.blank_at(0, len(flash.image)):
            self.faults.append("memory damaged and erased: nothing is live")
            flash.erase(0, len(flash.image))
        flash.program(0, MAGIC)
