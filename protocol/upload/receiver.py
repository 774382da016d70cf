"""The vehicle's end of an upload: gathers chunks apart from what is live, checks them, commits.

What is gathered lies in the store alone, and each chunk is there before it is reported: begun anew on the
same store, after a power cut, the receiver goes on where it was.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import NamedTuple, Protocol

from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import Message, UploadResult, UploadState
from trimtab.protocol.upload.receiver_reports import Reports
from trimtab.protocol.upload.receiver_table import TABLE, Action, Event, Refusal
from trimtab.protocol.upload.transfer import (
    CHUNK_BYTES,
    SIZE_MAX,
    Agreement,
    Incoming,
    ReceiverEvent,
    UploadEvent,
    Verdict,
    chunk_count,
    tag_of,
)

UNDER_WAY_US = 200_000
"""Time without a message about it after which an upload no longer counts as under way."""
_STAGED = (UploadState.STAGED, UploadState.SCHEDULED)


class BlobStore(Protocol):
    """Where blobs are kept: one live of each kind, and one that is gathered and then staged."""

    def live(self, kind: int) -> bytes | None: ...
    def incoming(self) -> Incoming | None: ...
    def begin(self, kind: int, size: int, digest: bytes) -> None: ...
    def put(self, kind: int, index: int, chunk: bytes) -> None: ...
    def gathered(self, kind: int) -> bytes: ...
    def stage(self, kind: int, blob: bytes) -> object: ...
    def commit(self, kind: int) -> object: ...
    def discard(self, kind: int) -> None: ...


class _Blob(NamedTuple):
    """The blob in hand, or one that a message is about."""

    digest: bytes = b""
    kind: int = 0
    size: int = 0

    @property
    def id(self) -> str:
        return self.digest[:6].hex()


_NONE = _Blob()


def _no_agreement(kind: int, blob: bytes, at_tick: int, now_us: int) -> Agreement:
    return Agreement(result=UploadResult.BUSY)


class UploadReceiver:
    """Receives one blob at a time. Nothing live changes before a commit.

    Parameters
    ----------
    store
        where a blob is gathered, staged and committed; an upload that it still holds goes on, after
        another check where it is complete.
    check
        says whether a blob of this kind may be used; it sees only bytes whose digest is right.
    may_commit
        whether a blob of this kind may become live now.
    agree
        whether this blob (kind, bytes) takes over at a tick in flight, asked at a time in us; where
        it does, the owner calls `due` when that tick has come, or `call_off`.
    capacity
        bytes of the largest blob that is taken.
    silence_us
        after this time without a message about it, the blob in hand is no longer reported.

    Attributes
    ----------
    state
        what is held of the blob in hand.
    chunks, held
        of the blob in hand.
    repeated
        chunks that came again, since construction.
    verdict
        what the check said of the blob in hand, None before.
    """

    def __init__(
        self,
        store: BlobStore,
        *,
        check: Callable[[int, bytes], Verdict],
        may_commit: Callable[[int], bool],
        agree: Callable[[int, bytes, int, int], Agreement] = _no_agreement,
        capacity: int,
        silence_us: int = 30_000_000,
    ) -> None:
        if not 0 < capacity <= SIZE_MAX:
            raise ValueError(f"capacity must be 1..{SIZE_MAX} bytes, not {capacity}")
        self.state = UploadState.IDLE
        self.chunks = 0
        self.held = 0
        self.repeated = 0
        self.verdict: Verdict | None = None
        self._store = store
        self._check = check
        self._may_commit = may_commit
        self._agree = agree
        self._agreed_tick = m.NO_TICK
        self._agreement = Agreement()
        self._capacity = capacity
        self._live: dict[int, bytes] = {}
        for kind in Kind:
            self._note_live(kind)
        self._blob = _NONE
        self._map = bytearray()
        self._reports = Reports(silence_us)
        self._events: list[ReceiverEvent] = []
        self._actions: dict[Action, Callable[[_Blob, int], None]] = {
            Action.BEGIN: self._begin,
            Action.KEEP: self._report_soon,
            Action.REPORT: self._report,
            Action.REPORT_SOON: self._report_soon,
            Action.ASK_FOR_BEGIN: self._report_soon,
            Action.STAGE: self._stage,
            Action.REFUSE: self._refuse,
            Action.DROP: self._drop,
            Action.COMMIT: self._commit,
            Action.REFUSE_COMMIT: self._refuse_commit,
            Action.SAY_BUSY: self._say_busy,
            Action.SAY_LIVE: self._say_live,
            Action.DISCARD: self._discard,
            Action.CHECK_AGAIN: self._check_again,
        }
        self._resume(store.incoming())

    def staged(self) -> tuple[int, bytes]:
        """Kind and first 6 bytes of the digest of what is staged; 0 and zeros for nothing."""
        if self.state not in _STAGED:
            return 0, bytes(6)
        return self._blob.kind, self._blob.digest[:6]

    @property
    def at_tick(self) -> int | None:
        """The tick at which the staged blob takes over, None where none is agreed."""
        return self._agreed_tick if self.state is UploadState.SCHEDULED else None

    def live_id(self, kind: int) -> bytes:
        """First 6 bytes of the digest of what is live of this kind, zeros for nothing."""
        return self._live.get(kind, bytes(6))[:6]

    def receive(self, message: Message, now_us: int) -> list[ReceiverEvent]:
        """Return what the message brought about; a message that is not about uploads brings about nothing."""
        if isinstance(message, m.UploadChunk):
            self._on_chunk(message, now_us)
        elif isinstance(message, m.UploadBegin):
            self._reports.query = message.query
            blob = _Blob(bytes(message.digest), message.kind, message.size)
            self._do(self._begin_event(blob, message.chunk), blob, now_us)
        elif isinstance(message, m.UploadCommit):
            self._on_commit(bytes(message.digest), message.at_tick, now_us)
        elif isinstance(message, m.UploadAbort):
            digest = bytes(message.digest)
            event = Event.ABORT_SAME if self._in_hand(digest) else Event.ABORT_OTHER
            self._do(event, _Blob(digest), now_us)
        return self._take_events()

    def commit(self, id_bytes: bytes, now_us: int) -> tuple[UploadResult, list[ReceiverEvent]]:
        """Return result and events of a commit asked for in another way, of the blob whose id has these 6
        bytes.

        OK also where that blob is live already; UNKNOWN where it is not staged; BUSY where it is not the
        time.
        """
        if any(digest[:6] == id_bytes for digest in self._live.values()):
            return UploadResult.OK, []
        if self.state not in _STAGED or self._blob.digest[:6] != id_bytes:
            return UploadResult.UNKNOWN, []
        self._on_commit(self._blob.digest, m.NO_TICK, now_us)
        done = any(digest[:6] == id_bytes for digest in self._live.values())
        return (UploadResult.OK if done else UploadResult.BUSY), self._take_events()

    def due(self, now_us: int) -> list[ReceiverEvent]:
        """Return the events of the takeover at the agreed tick, which has come; the owner has taken over."""
        self._do(Event.DUE, self._blob, now_us)
        return self._take_events()

    def call_off(self, now_us: int) -> None:
        """Call off an agreed swap; the reference stays staged."""
        self._do(Event.CALLED_OFF, self._blob, now_us)

    def limits_changed(self, now_us: int) -> list[ReceiverEvent]:
        """Return what it brought about that the check goes by other limits now: what is staged may be
        refused.
        """
        if self.state is UploadState.STAGED:
            verdict = self._check(self._blob.kind, self._store.gathered(self._blob.kind))
            if not verdict.ok:
                self.verdict = verdict
                self._do(Event.CHECK_REFUSED, self._blob, now_us)
        return self._take_events()

    def put(
        self, kind: int, data: bytes, now_us: int
    ) -> tuple[UploadResult, Verdict | None, list[ReceiverEvent]]:
        """Return result, what the check said if it was asked, and events of a whole blob that came in
        another way.

        OK: it is staged, and stays so until it is committed or another upload begins, or it is live already.
        BUSY: another upload is under way or agreed to take over. Any other result leaves nothing of it.
        """
        if self.state is UploadState.RECEIVING and self._reports.reminding(now_us):
            return UploadResult.BUSY, None, []
        blob = _Blob(hashlib.sha256(data).digest(), kind, len(data))
        event = self._begin_event(blob, CHUNK_BYTES)
        if event is Event.BEGIN_LIVE:
            return UploadResult.OK, None, []
        if self.state is UploadState.SCHEDULED:
            return UploadResult.OK if event is Event.BEGIN_SAME else UploadResult.BUSY, None, []
        entry = TABLE(self.state, event)
        if isinstance(entry, Refusal):
            return entry.result or UploadResult.BUSY, None, []
        self._do(event, blob, now_us)
        if self.state is UploadState.RECEIVING:
            for index in range(self.chunks):
                self._store.put(kind, index, data[index * CHUNK_BYTES : (index + 1) * CHUNK_BYTES])
            self._map[:] = bytes([1]) * self.chunks
            self.held = self.chunks
            self._on_complete(now_us)
        verdict = self.verdict
        if self.state is UploadState.STAGED:
            self._reports.fall_silent(now_us)
            return UploadResult.OK, verdict, self._take_events()
        self._do(Event.ABORT_SAME, blob, now_us)
        return UploadResult.REFUSED, verdict, self._take_events()

    def remove(self, kind: int, now_us: int) -> tuple[UploadResult, list[ReceiverEvent]]:
        """Return result and events of forgetting what is staged of this kind; UNKNOWN where nothing is."""
        if self.state not in _STAGED or self._blob.kind != kind:
            return UploadResult.UNKNOWN, []
        self._do(Event.ABORT_SAME, self._blob, now_us)
        return UploadResult.OK, self._take_events()

    def advance(self, now_us: int) -> list[ReceiverEvent]:
        """Return what the passing of time brought about."""
        return self._take_events()

    def send(self, now_us: int) -> list[Message]:
        """Return the messages that are due."""
        if self._reports.due(now_us, self._blob is not _NONE):
            self._report(self._blob, now_us)
        return self._reports.take()

    def under_way(self, now_us: int) -> bool:
        """Whether chunks are coming in: something about the blob in hand was heard a short while ago."""
        return self.state is UploadState.RECEIVING and now_us - self._reports.heard_us < UNDER_WAY_US

    def next_deadline_us(self) -> int | None:
        """Time by which to call `advance` and `send`; None while nothing is under way."""
        return self._reports.next_us(self._blob is not _NONE)

    # Which event a message is.

    def _begin_event(self, blob: _Blob, chunk_bytes: int) -> Event:
        if blob.kind not in tuple(Kind):
            return Event.BEGIN_BAD_KIND
        if chunk_bytes != CHUNK_BYTES or blob.size == 0:
            return Event.BEGIN_BAD_REQUEST
        if blob.size > self._capacity:
            return Event.BEGIN_TOO_LARGE
        if self._live.get(blob.kind) == blob.digest:
            return Event.BEGIN_LIVE
        return Event.BEGIN_SAME if blob == self._blob else Event.BEGIN_OTHER

    def _on_chunk(self, message: m.UploadChunk, now_us: int) -> None:
        index = message.index
        if self._blob is _NONE or message.tag != tag_of(self._blob.digest) or index >= self.chunks:
            if any(message.tag == tag_of(digest) for digest in self._live.values()):
                return  # a copy that comes late: nobody need begin anew
            self._reports.stray_tag = message.tag
            self._do(Event.CHUNK_FOREIGN, _NONE, now_us)
        elif self._map[index]:
            self.repeated += 1
            self._do(Event.CHUNK_HELD, self._blob, now_us)
        else:
            start = index * CHUNK_BYTES
            stop = min(start + CHUNK_BYTES, self._blob.size)
            self._store.put(self._blob.kind, index, bytes(message.data)[: stop - start])
            self._map[index] = 1
            self.held += 1
            self._do(Event.CHUNK_NEW, self._blob, now_us)
            if self.held == self.chunks:
                self._on_complete(now_us)

    def _on_complete(self, now_us: int) -> None:
        data = self._store.gathered(self._blob.kind)
        if hashlib.sha256(data).digest() != self._blob.digest:
            self._do(Event.CORRUPT, self._blob, now_us)
            return
        self.verdict = self._check(self._blob.kind, data)
        event = Event.CHECK_PASSED if self.verdict.ok else Event.CHECK_REFUSED
        self._do(event, self._blob, now_us)

    def _on_commit(self, digest: bytes, at_tick: int, now_us: int) -> None:
        if digest in self._live.values():
            event = Event.COMMIT_LIVE
        elif not self._in_hand(digest):
            event = Event.COMMIT_OTHER
        elif at_tick != m.NO_TICK:
            event = self._commit_at_event(at_tick, now_us)
        else:
            event = Event.COMMIT_SAME if self._may_commit(self._blob.kind) else Event.COMMIT_BUSY
        self._do(event, _Blob(digest), now_us)

    def _commit_at_event(self, at_tick: int, now_us: int) -> Event:
        if self.state not in _STAGED or self.at_tick == at_tick:
            return Event.COMMIT_AT  # of what is agreed already: only the answer was lost
        self._agreement = self._agree(self._blob.kind, self._store.gathered(self._blob.kind), at_tick, now_us)
        if self._agreement.result is not UploadResult.OK:
            return Event.COMMIT_AT_REFUSED
        self._agreed_tick = at_tick
        return Event.COMMIT_AT

    def _do(self, event: Event, blob: _Blob, now_us: int) -> None:
        entry = TABLE(self.state, event)
        same = self._in_hand(blob.digest)
        if same:
            self._reports.hear(now_us)
        if isinstance(entry, Refusal):
            if entry.result is not None:
                self._answer(blob.digest, self.state if same else UploadState.IDLE, entry.result)
            return
        self.state = entry.state
        self._actions[entry.action](blob, now_us)

    # What is done; the state is the one afterwards.

    def _begin(self, blob: _Blob, now_us: int) -> None:
        if self._blob is not _NONE:
            self._clear(UploadEvent.DISCARDED, "another upload began")
        self._blob = blob
        self.chunks = chunk_count(blob.size)
        self._map = bytearray(self.chunks)
        self._store.begin(blob.kind, blob.size, blob.digest)
        self._reports.hear(now_us)
        self._tell(UploadEvent.BEGAN, f"receiving {blob.size} bytes")
        self._report(blob, now_us)

    def _report(self, blob: _Blob, now_us: int) -> None:
        self._reports.reported()
        if self._blob is _NONE:
            if self._reports.stray_tag is not None:
                self._answer_tag(self._reports.stray_tag, UploadState.IDLE, UploadResult.UNKNOWN)
                self._reports.stray_tag = None
            return
        self._reports.remind(now_us)
        refused = self.state is UploadState.REFUSED
        result = UploadResult.REFUSED if refused else UploadResult.OK
        self._answer(self._blob.digest, self.state, result)
        if self.verdict is not None:
            self._reports.verdict(self._blob.digest, self.verdict)

    def _report_soon(self, blob: _Blob, now_us: int) -> None:
        self._reports.soon(self.chunks - self.held, now_us)

    def _stage(self, blob: _Blob, now_us: int) -> None:
        self._store.stage(self._blob.kind, self._store.gathered(self._blob.kind))
        self._tell(UploadEvent.ACCEPTED, "staged")
        self._report(blob, now_us)

    def _refuse(self, blob: _Blob, now_us: int) -> None:
        self._tell(UploadEvent.REFUSED, self.verdict.message if self.verdict else "")
        self._report(blob, now_us)

    def _drop(self, blob: _Blob, now_us: int) -> None:
        self._answer(self._blob.digest, UploadState.IDLE, UploadResult.CORRUPT)
        self._clear(UploadEvent.CORRUPT, "its bytes do not make its digest")

    def _commit(self, blob: _Blob, now_us: int) -> None:
        kind = self._blob.kind
        try:
            self._store.commit(kind)
        except ValueError:  # memory that fails: what was staged is not there any more
            self._drop(blob, now_us)
            return
        self._note_live(kind)
        self._say_live(self._blob, now_us)
        self._clear(UploadEvent.COMMITTED, "live")

    def _refuse_commit(self, blob: _Blob, now_us: int) -> None:
        self._answer(self._blob.digest, self.state, self._agreement.result)
        if self._agreement.verdict is not None:
            self._reports.verdict(self._blob.digest, self._agreement.verdict)

    def _say_busy(self, blob: _Blob, now_us: int) -> None:
        self._answer(self._blob.digest, self.state, UploadResult.BUSY)

    def _say_live(self, blob: _Blob, now_us: int) -> None:
        self._answer(blob.digest, UploadState.LIVE, UploadResult.OK)

    def _discard(self, blob: _Blob, now_us: int) -> None:
        self._answer(self._blob.digest, UploadState.IDLE, UploadResult.OK)
        self._clear(UploadEvent.DISCARDED, "aborted")

    def _check_again(self, blob: _Blob, now_us: int) -> None:
        self._on_complete(now_us)

    # Helpers.

    def _resume(self, incoming: Incoming | None) -> None:
        """Resume the upload that the store holds, without a report yet."""
        for kind in Kind:
            if incoming is None or kind != incoming.kind:
                self._store.discard(kind)
        if incoming is None:
            return
        self._blob = _Blob(incoming.digest, incoming.kind, incoming.size)
        self.chunks, self._map = len(incoming.held), incoming.held
        self.held = sum(incoming.held)
        self.state = UploadState.RECEIVING
        if self.held == self.chunks:
            self._on_complete(0)
        self._reports.take()  # who asks is answered

    def _clear(self, event: UploadEvent, text: str) -> None:
        self._tell(event, text)
        if event is not UploadEvent.COMMITTED and self._blob.kind:
            self._store.discard(self._blob.kind)
        self._blob = _NONE
        self._map = bytearray()
        self.chunks = self.held = 0
        self.verdict = None
        self._reports.forget()

    def _in_hand(self, digest: bytes) -> bool:
        return self._blob is not _NONE and digest == self._blob.digest

    def _note_live(self, kind: int) -> None:
        live = self._store.live(kind)
        if live is not None:
            self._live[kind] = hashlib.sha256(live).digest()

    def _tell(self, event: UploadEvent, text: str) -> None:
        self._events.append(ReceiverEvent(event=event, kind=self._blob.kind, id=self._blob.id, text=text))

    def _take_events(self) -> list[ReceiverEvent]:
        events, self._events = self._events, []
        return events

    def _answer(self, digest: bytes, state: UploadState, result: UploadResult) -> None:
        self._answer_tag(tag_of(digest), state, result)

    def _answer_tag(self, tag: int, state: UploadState, result: UploadResult) -> None:
        self._reports.answer(tag, state, result, kind=self._blob.kind, held=self.held, have=self._map)
