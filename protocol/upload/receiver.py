"""The vehicle's end of an upload: receives a blob beside the live one, checks it and commits it.

The received bytes are in the store only. Each chunk is stored before it is reported. A receiver that starts
on the same store after a power cut therefore resumes the upload.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable

from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import Message, UploadResult, UploadState
from trimtab.protocol.upload.current_blob import NO_BLOB, BlobIdentity, BlobStore
from trimtab.protocol.upload.receiver_machine import ReceiverMachine
from trimtab.protocol.upload.receiver_reports import Reports
from trimtab.protocol.upload.receiver_table import TABLE, Event, Refusal
from trimtab.protocol.upload.transfer import (
    CHUNK_BYTES,
    CHUNK_SIZES,
    SIZE_MAX,
    ReceiverEvent,
    SwapAnswer,
    Verdict,
    tag_of,
)

IN_PROGRESS_US = 200_000
"""Time without a message about an upload after which it no longer counts as in progress."""
_STAGED = (UploadState.STAGED, UploadState.SCHEDULED)


def _no_swap(kind: int, blob: bytes, at_tick: int, now_us: int) -> SwapAnswer:
    return SwapAnswer(result=UploadResult.BUSY)


class UploadReceiver:
    """Receives one blob at a time. Nothing live changes before a commit.

    Parameters
    ----------
    store
        Store in which blobs are received, staged and committed. An upload that it still holds is resumed; a
        complete one is checked again.
    check
        Returns the verdict on a blob (kind, bytes). It is called only with bytes that match the digest.
    may_commit
        Returns whether a blob of this kind may become live now.
    agree
        Returns whether a blob takes over in flight, given kind, bytes, tick of the swap and present time in
        us. If it does, the owner later calls either `swap_done` at that tick or `call_off`.
    capacity
        Greatest size of a blob in bytes.
    silence_us
        Time without a message about the current blob after which it is no longer reported.

    Attributes
    ----------
    repeated
        Number of chunks received more than once, since construction.
    """

    def __init__(
        self,
        store: BlobStore,
        *,
        check: Callable[[int, bytes], Verdict],
        may_commit: Callable[[int], bool],
        agree: Callable[[int, bytes, int, int], SwapAnswer] = _no_swap,
        capacity: int,
        silence_us: int = 30_000_000,
    ) -> None:
        if not 0 < capacity <= SIZE_MAX:
            raise ValueError(f"capacity must be 1..{SIZE_MAX} bytes, not {capacity}")
        self.repeated = 0
        self._check = check
        self._may_commit = may_commit
        self._agree = agree
        self._agreed_tick = m.NO_TICK
        self._capacity = capacity
        self._reports = Reports(silence_us)
        self._machine = ReceiverMachine(store, check, self._reports)
        self._current = self._machine.current

    @property
    def state(self) -> UploadState:
        """State of the current blob."""
        return self._machine.state

    @property
    def verdict(self) -> Verdict | None:
        """Verdict of the check on the current blob; None before the check."""
        return self._machine.verdict

    @property
    def chunks(self) -> int:
        """Number of chunks of the current blob."""
        return self._current.chunks

    @property
    def held(self) -> int:
        """Number of chunks of the current blob that are held."""
        return self._current.held

    def staged(self) -> tuple[int, bytes]:
        """Return kind and id (6 bytes) of the staged blob, or 0 and zeros if no blob is staged."""
        if self.state not in _STAGED:
            return 0, bytes(6)
        return self._current.blob.kind, self._current.blob.digest[:6]

    @property
    def at_tick(self) -> int | None:
        """Agreed tick at which the staged blob takes over, or None."""
        return self._agreed_tick if self.state is UploadState.SCHEDULED else None

    def live_id(self, kind: int) -> bytes:
        """Return the id (6 bytes) of the live blob of this kind, or zeros if no blob is live."""
        return self._machine.live.get(kind, bytes(6))[:6]

    def receive(self, message: Message, now_us: int) -> list[ReceiverEvent]:
        """Handle a message and return its events. Messages that do not concern uploads are ignored."""
        if isinstance(message, m.UploadChunk):
            self._on_chunk(message, now_us)
        elif isinstance(message, m.UploadBegin):
            self._reports.query = message.query
            blob = BlobIdentity(bytes(message.digest), message.kind, message.size, message.chunk)
            self._machine.run(self._begin_event(blob), blob, now_us)
        elif isinstance(message, m.UploadCommit):
            self._on_commit(bytes(message.digest), message.at_tick, now_us)
        elif isinstance(message, m.UploadAbort):
            digest = bytes(message.digest)
            event = Event.ABORT_SAME if self._current.has_digest(digest) else Event.ABORT_OTHER
            self._machine.run(event, BlobIdentity(digest), now_us)
        return self._machine.take_events()

    def commit(self, id_bytes: bytes, now_us: int) -> tuple[UploadResult, list[ReceiverEvent]]:
        """Commit the staged blob with this id (6 bytes); return the result and the events.

        The result is OK also if the blob is already live, UNKNOWN if it is not staged, and BUSY if it may not
        become live now.
        """
        if any(digest[:6] == id_bytes for digest in self._machine.live.values()):
            return UploadResult.OK, []
        if self.state not in _STAGED or self._current.blob.digest[:6] != id_bytes:
            return UploadResult.UNKNOWN, []
        self._on_commit(self._current.blob.digest, m.NO_TICK, now_us)
        live = any(digest[:6] == id_bytes for digest in self._machine.live.values())
        return (UploadResult.OK if live else UploadResult.BUSY), self._machine.take_events()

    def swap_done(self, now_us: int) -> list[ReceiverEvent]:
        """Commit the blob that has taken over at the agreed tick; return the events."""
        self._machine.run(Event.DUE, self._current.blob, now_us)
        return self._machine.take_events()

    def call_off(self, now_us: int) -> None:
        """Call off an agreed swap; the reference stays staged."""
        self._machine.run(Event.CALLED_OFF, self._current.blob, now_us)

    def limits_changed(self, now_us: int) -> list[ReceiverEvent]:
        """Check the staged blob again with the new limits; return the events."""
        if self.state is UploadState.STAGED:
            verdict = self._check(self._current.blob.kind, self._current.data())
            if not verdict.ok:
                self._machine.verdict = verdict
                self._machine.run(Event.CHECK_REFUSED, self._current.blob, now_us)
        return self._machine.take_events()

    def put(
        self, kind: int, data: bytes, now_us: int
    ) -> tuple[UploadResult, Verdict | None, list[ReceiverEvent]]:
        """Receive a complete blob; return the result, the verdict if it was checked, and the events.

        OK: the blob is already live, or it is staged until it is committed or another upload begins. BUSY:
        another upload is in progress, or another swap is agreed. After any other result the blob is
        discarded.
        """
        if self.state is UploadState.RECEIVING and self._reports.awaited(now_us):
            return UploadResult.BUSY, None, []
        blob = BlobIdentity(hashlib.sha256(data).digest(), kind, len(data))
        event = self._begin_event(blob)
        if event is Event.BEGIN_LIVE:
            return UploadResult.OK, None, []
        if self.state is UploadState.SCHEDULED:
            return UploadResult.OK if event is Event.BEGIN_SAME else UploadResult.BUSY, None, []
        entry = TABLE(self.state, event)
        if isinstance(entry, Refusal):
            return entry.result or UploadResult.BUSY, None, []
        self._machine.run(event, blob, now_us)
        if self.state is UploadState.RECEIVING:
            for index in range(self.chunks):
                self._current.put(index, data[index * CHUNK_BYTES : (index + 1) * CHUNK_BYTES])
            self._machine.complete(now_us)
        verdict = self.verdict
        if self.state is UploadState.STAGED:
            self._reports.fall_silent(now_us)
            return UploadResult.OK, verdict, self._machine.take_events()
        self._machine.run(Event.ABORT_SAME, blob, now_us)
        return UploadResult.REFUSED, verdict, self._machine.take_events()

    def remove(self, kind: int, now_us: int) -> tuple[UploadResult, list[ReceiverEvent]]:
        """Discard the staged blob of this kind; return the result (UNKNOWN without one) and the events."""
        if self.state not in _STAGED or self._current.blob.kind != kind:
            return UploadResult.UNKNOWN, []
        self._machine.run(Event.ABORT_SAME, self._current.blob, now_us)
        return UploadResult.OK, self._machine.take_events()

    def advance(self, now_us: int) -> list[ReceiverEvent]:
        """Return the events not yet returned; none depends on the time."""
        return self._machine.take_events()

    def send(self, now_us: int) -> list[Message]:
        """Return the messages that are due."""
        if self._reports.due(now_us, bool(self._current)):
            self._machine.report(self._current.blob, now_us)
        return self._reports.take()

    def in_progress(self, now_us: int) -> bool:
        """Return whether an upload is in progress, with a message within the last IN_PROGRESS_US."""
        return self.state is UploadState.RECEIVING and now_us - self._reports.arrival_us < IN_PROGRESS_US

    def next_deadline_us(self) -> int | None:
        """Return the time by which to call `advance` and `send`; None if nothing is due."""
        return self._reports.next_us(bool(self._current))

    # Classify messages as events.

    def _begin_event(self, blob: BlobIdentity) -> Event:
        if blob.kind not in tuple(Kind):
            return Event.BEGIN_BAD_KIND
        if blob.chunk_bytes not in CHUNK_SIZES or blob.size == 0:
            return Event.BEGIN_BAD_REQUEST
        if blob.size > self._capacity:
            return Event.BEGIN_TOO_LARGE
        if self._machine.live.get(blob.kind) == blob.digest:
            return Event.BEGIN_LIVE
        current = self._current.blob
        same = blob[:3] == current[:3]
        if self.state is UploadState.RECEIVING and blob.chunk_bytes != current.chunk_bytes:
            same = False  # the chunks held do not match; once all are held, their size no longer matters
        return Event.BEGIN_SAME if same else Event.BEGIN_OTHER

    def _on_chunk(self, message: m.UploadChunk, now_us: int) -> None:
        index = message.index
        if not self._current or message.tag != tag_of(self._current.blob.digest) or index >= self.chunks:
            if any(message.tag == tag_of(digest) for digest in self._machine.live.values()):
                return  # a late copy of a chunk of a live blob
            self._reports.stray_tag = message.tag
            self._machine.run(Event.CHUNK_FOREIGN, NO_BLOB, now_us)
        elif self._current.held_chunks[index]:
            self.repeated += 1
            self._machine.run(Event.CHUNK_HELD, self._current.blob, now_us)
        else:
            self._current.put(index, bytes(message.data))
            self._machine.run(Event.CHUNK_NEW, self._current.blob, now_us)
            if self.held == self.chunks:
                self._machine.complete(now_us)

    def _on_commit(self, digest: bytes, at_tick: int, now_us: int) -> None:
        if digest in self._machine.live.values():
            event = Event.COMMIT_LIVE
        elif not self._current.has_digest(digest):
            event = Event.COMMIT_OTHER
        elif at_tick != m.NO_TICK:
            event = self._commit_at_event(at_tick, now_us)
        else:
            event = Event.COMMIT_SAME if self._may_commit(self._current.blob.kind) else Event.COMMIT_BUSY
        self._machine.run(event, BlobIdentity(digest), now_us)

    def _commit_at_event(self, at_tick: int, now_us: int) -> Event:
        if self.state not in _STAGED or self.at_tick == at_tick:
            return (
                Event.COMMIT_AT
            )  # not asked: without a staged blob the table answers; a repeated request is agreed already
        blob = self._current.blob
        self._machine.swap_answer = self._agree(blob.kind, self._current.data(), at_tick, now_us)
        if self._machine.swap_answer.result is not UploadResult.OK:
            return Event.COMMIT_AT_REFUSED
        self._agreed_tick = at_tick
        return Event.COMMIT_AT
