"""Run the transitions of an upload: the state, the blob in hand, and the action of each transition."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import UploadResult, UploadState
from trimtab.protocol.upload.blob_in_hand import Blob, BlobInHand, BlobStore
from trimtab.protocol.upload.receiver_reports import Reports
from trimtab.protocol.upload.receiver_table import TABLE, Action, Event, Refusal
from trimtab.protocol.upload.transfer import (
    Agreement,
    Incoming,
    ReceiverEvent,
    UploadEvent,
    Verdict,
    tag_of,
)


class ReceiverMachine:
    """The state of an upload, and what each event does to it.

    Parameters
    ----------
    store
        Store in which blobs are gathered, staged and committed. An upload that it still holds continues; a
        complete one is checked again.
    check
        Returns whether a blob (kind, bytes) may be used. It gets only bytes whose digest is right.
    reports
        Schedule of the reports to the host.

    Attributes
    ----------
    state
        State of the blob in hand.
    verdict
        Verdict of the check on the blob in hand; None before the check.
    live
        SHA-256 digest of the live blob of each kind.
    agreement
        Last answer to a request for a takeover in flight.
    """

    def __init__(self, store: BlobStore, check: Callable[[int, bytes], Verdict], reports: Reports) -> None:
        self.state = UploadState.IDLE
        self.verdict: Verdict | None = None
        self.live: dict[int, bytes] = {}
        self.agreement = Agreement()
        self.hand = BlobInHand(store)
        self._store = store
        self._check = check
        self._reports = reports
        self._events: list[ReceiverEvent] = []
        self._actions: dict[Action, Callable[[Blob, int], None]] = {
            Action.BEGIN: self._begin,
            Action.KEEP: self._report_soon,
            Action.REPORT: self.report,
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
        for kind in Kind:
            self._note_live(kind)
        self._resume(store.incoming())

    def run(self, event: Event, blob: Blob, now_us: int) -> None:
        """Take the transition of `event`, which is about `blob`: change the state, then act."""
        entry = TABLE(self.state, event)
        same = self.hand.has_digest(blob.digest)
        if same:
            self._reports.hear(now_us)
        if isinstance(entry, Refusal):
            if entry.result is not None:
                self._answer(blob.digest, self.state if same else UploadState.IDLE, entry.result)
            return
        self.state = entry.state
        self._actions[entry.action](blob, now_us)

    def complete(self, now_us: int) -> None:
        """Check the blob in hand, of which every chunk is held."""
        if not self.hand.is_intact():
            self.run(Event.CORRUPT, self.hand.blob, now_us)
            return
        self.verdict = self._check(self.hand.blob.kind, self.hand.data())
        event = Event.CHECK_PASSED if self.verdict.ok else Event.CHECK_REFUSED
        self.run(event, self.hand.blob, now_us)

    def take_events(self) -> list[ReceiverEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    # Actions. The state is already the one afterwards.

    def _begin(self, blob: Blob, now_us: int) -> None:
        if self.hand:
            self._clear(UploadEvent.DISCARDED, "another upload began")
        self.hand.begin(blob)
        self._reports.hear(now_us)
        self._tell(UploadEvent.BEGAN, f"receiving {blob.size} bytes")
        self.report(blob, now_us)

    def report(self, blob: Blob, now_us: int) -> None:
        """Queue the report on the blob in hand, or the answer to a chunk of an unknown one."""
        self._reports.reported()
        if not self.hand:
            if self._reports.stray_tag is not None:
                self._answer_tag(self._reports.stray_tag, UploadState.IDLE, UploadResult.UNKNOWN)
                self._reports.stray_tag = None
            return
        self._reports.remind(now_us)
        refused = self.state is UploadState.REFUSED
        result = UploadResult.REFUSED if refused else UploadResult.OK
        self._answer(self.hand.blob.digest, self.state, result)
        if self.verdict is not None:
            self._reports.verdict(self.hand.blob.digest, self.verdict)

    def _report_soon(self, blob: Blob, now_us: int) -> None:
        self._reports.soon(self.hand.chunks - self.hand.held, now_us)

    def _stage(self, blob: Blob, now_us: int) -> None:
        self._store.stage(self.hand.blob.kind, self.hand.data())
        self._tell(UploadEvent.ACCEPTED, "staged")
        self.report(blob, now_us)

    def _refuse(self, blob: Blob, now_us: int) -> None:
        self._tell(UploadEvent.REFUSED, self.verdict.message if self.verdict else "")
        self.report(blob, now_us)

    def _drop(self, blob: Blob, now_us: int) -> None:
        self._answer(self.hand.blob.digest, UploadState.IDLE, UploadResult.CORRUPT)
        self._clear(UploadEvent.CORRUPT, "its bytes do not make its digest")

    def _commit(self, blob: Blob, now_us: int) -> None:
        kind = self.hand.blob.kind
        try:
            self._store.commit(kind)
        except ValueError:  # the memory failed: the staged blob is lost
            self._drop(blob, now_us)
            return
        self._note_live(kind)
        self._say_live(self.hand.blob, now_us)
        self._clear(UploadEvent.COMMITTED, "live")

    def _refuse_commit(self, blob: Blob, now_us: int) -> None:
        self._answer(self.hand.blob.digest, self.state, self.agreement.result)
        if self.agreement.verdict is not None:
            self._reports.verdict(self.hand.blob.digest, self.agreement.verdict)

    def _say_busy(self, blob: Blob, now_us: int) -> None:
        self._answer(self.hand.blob.digest, self.state, UploadResult.BUSY)

    def _say_live(self, blob: Blob, now_us: int) -> None:
        self._answer(blob.digest, UploadState.LIVE, UploadResult.OK)

    def _discard(self, blob: Blob, now_us: int) -> None:
        self._answer(self.hand.blob.digest, UploadState.IDLE, UploadResult.OK)
        self._clear(UploadEvent.DISCARDED, "aborted")

    def _check_again(self, blob: Blob, now_us: int) -> None:
        self.complete(now_us)

    # Helpers.

    def _resume(self, incoming: Incoming | None) -> None:
        """Resume the upload that the store holds, without a report yet."""
        for kind in Kind:
            if incoming is None or kind != incoming.kind:
                self._store.discard(kind)
        if incoming is None:
            return
        self.hand.resume(incoming)
        self.state = UploadState.RECEIVING
        if self.hand.held == self.hand.chunks:
            self.complete(0)
        self._reports.take()  # reports follow a request

    def _clear(self, event: UploadEvent, text: str) -> None:
        self._tell(event, text)
        self.hand.forget(discard=event is not UploadEvent.COMMITTED)
        self.verdict = None
        self._reports.forget()

    def _note_live(self, kind: int) -> None:
        live = self._store.live(kind)
        if live is not None:
            self.live[kind] = hashlib.sha256(live).digest()

    def _tell(self, event: UploadEvent, text: str) -> None:
        self._events.append(
            ReceiverEvent(event=event, kind=self.hand.blob.kind, id=self.hand.blob.id, text=text)
        )

    def _answer(self, digest: bytes, state: UploadState, result: UploadResult) -> None:
        self._answer_tag(tag_of(digest), state, result)

    def _answer_tag(self, tag: int, state: UploadState, result: UploadResult) -> None:
        self._reports.answer(
            tag, state, result, kind=self.hand.blob.kind, held=self.hand.held, have=self.hand.held_chunks
        )
