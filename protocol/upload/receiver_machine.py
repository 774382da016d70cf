"""State machine of the receiver of an upload: state, current blob, and the action of each transition."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import UploadResult, UploadState
from trimtab.protocol.upload.current_blob import BlobIdentity, BlobStore, CurrentBlob
from trimtab.protocol.upload.receiver_reports import Reports
from trimtab.protocol.upload.receiver_table import TABLE, Action, Event, Refusal
from trimtab.protocol.upload.transfer import (
    Incoming,
    ReceiverEvent,
    SwapAnswer,
    UploadEvent,
    Verdict,
    tag_of,
)


class ReceiverMachine:
    """State machine of one upload after another.

    Parameters
    ----------
    store
        Store in which blobs are received, staged and committed. An upload that it still holds is resumed; a
        complete one is checked again.
    check
        Returns the verdict on a blob (kind, bytes). It is called only with bytes that match the digest.
    reports
        Schedule of the reports to the host.

    Attributes
    ----------
    state
        State of the current blob.
    verdict
        Verdict of the check on the current blob; None before the check.
    live
        SHA-256 digest of the live blob of each kind.
    swap_answer
        Last answer to a request for a swap in flight.
    """

    def __init__(self, store: BlobStore, check: Callable[[int, bytes], Verdict], reports: Reports) -> None:
        self.state = UploadState.IDLE
        self.verdict: Verdict | None = None
        self.live: dict[int, bytes] = {}
        self.swap_answer = SwapAnswer()
        self.current = CurrentBlob(store)
        self._store = store
        self._check = check
        self._reports = reports
        self._events: list[ReceiverEvent] = []
        self._actions: dict[Action, Callable[[BlobIdentity, int], None]] = {
            Action.BEGIN: self._begin,
            Action.KEEP: self._report_soon,
            Action.REPORT: self.report,
            Action.REPORT_SOON: self._report_soon,
            Action.REQUEST_BEGIN: self._report_soon,
            Action.STAGE: self._stage,
            Action.REFUSE: self._refuse,
            Action.DROP: self._drop,
            Action.COMMIT: self._commit,
            Action.REFUSE_COMMIT: self._refuse_commit,
            Action.ANSWER_BUSY: self._answer_busy,
            Action.ANSWER_LIVE: self._answer_live,
            Action.DISCARD: self._discard,
            Action.CHECK_AGAIN: self._check_again,
        }
        for kind in Kind:
            self._note_live(kind)
        self._resume(store.incoming())

    def run(self, event: Event, blob: BlobIdentity, now_us: int) -> None:
        """Take the transition of `event`, which concerns `blob`: change the state, then act."""
        entry = TABLE(self.state, event)
        same = self.current.has_digest(blob.digest)
        if same:
            self._reports.message_arrived(now_us)
        if isinstance(entry, Refusal):
            if entry.result is not None:
                self._answer(blob.digest, self.state if same else UploadState.IDLE, entry.result)
            return
        self.state = entry.state
        self._actions[entry.action](blob, now_us)

    def complete(self, now_us: int) -> None:
        """Check the current blob, all chunks of which are held."""
        if not self.current.is_intact():
            self.run(Event.CORRUPT, self.current.blob, now_us)
            return
        self.verdict = self._check(self.current.blob.kind, self.current.data())
        event = Event.CHECK_PASSED if self.verdict.ok else Event.CHECK_REFUSED
        self.run(event, self.current.blob, now_us)

    def take_events(self) -> list[ReceiverEvent]:
        """Return and clear the events since the last call."""
        events, self._events = self._events, []
        return events

    # Actions. The state has already changed.

    def _begin(self, blob: BlobIdentity, now_us: int) -> None:
        if self.current:
            self._clear(UploadEvent.DISCARDED, "another upload began")
        self.current.begin(blob)
        self._reports.message_arrived(now_us)
        self._emit(UploadEvent.BEGAN, f"receiving {blob.size} bytes")
        self.report(blob, now_us)

    def report(self, blob: BlobIdentity, now_us: int) -> None:
        """Queue a report on the current blob, or the answer to a chunk of an unknown blob."""
        self._reports.clear_due()
        if not self.current:
            if self._reports.stray_tag is not None:
                self._answer_tag(self._reports.stray_tag, UploadState.IDLE, UploadResult.UNKNOWN)
                self._reports.stray_tag = None
            return
        self._reports.schedule_reminder(now_us)
        refused = self.state is UploadState.REFUSED
        result = UploadResult.REFUSED if refused else UploadResult.OK
        self._answer(self.current.blob.digest, self.state, result)
        if self.verdict is not None:
            self._reports.verdict(self.current.blob.digest, self.verdict)

    def _report_soon(self, blob: BlobIdentity, now_us: int) -> None:
        self._reports.schedule(self.current.chunks - self.current.held, now_us)

    def _stage(self, blob: BlobIdentity, now_us: int) -> None:
        self._store.stage(self.current.blob.kind, self.current.data())
        self._emit(UploadEvent.ACCEPTED, "staged")
        self.report(blob, now_us)

    def _refuse(self, blob: BlobIdentity, now_us: int) -> None:
        self._emit(UploadEvent.REFUSED, self.verdict.message if self.verdict else "")
        self.report(blob, now_us)

    def _drop(self, blob: BlobIdentity, now_us: int) -> None:
        self._answer(self.current.blob.digest, UploadState.IDLE, UploadResult.CORRUPT)
        self._clear(UploadEvent.CORRUPT, "its bytes do not match its digest")

    def _commit(self, blob: BlobIdentity, now_us: int) -> None:
        kind = self.current.blob.kind
        try:
            self._store.commit(kind)
        except ValueError:  # the memory is damaged: the staged blob is lost
            self._drop(blob, now_us)
            return
        self._note_live(kind)
        self._answer_live(self.current.blob, now_us)
        self._clear(UploadEvent.COMMITTED, "live")

    def _refuse_commit(self, blob: BlobIdentity, now_us: int) -> None:
        self._answer(self.current.blob.digest, self.state, self.swap_answer.result)
        if self.swap_answer.verdict is not None:
            self._reports.verdict(self.current.blob.digest, self.swap_answer.verdict)

    def _answer_busy(self, blob: BlobIdentity, now_us: int) -> None:
        self._answer(self.current.blob.digest, self.state, UploadResult.BUSY)

    def _answer_live(self, blob: BlobIdentity, now_us: int) -> None:
        self._answer(blob.digest, UploadState.LIVE, UploadResult.OK)

    def _discard(self, blob: BlobIdentity, now_us: int) -> None:
        self._answer(self.current.blob.digest, UploadState.IDLE, UploadResult.OK)
        self._clear(UploadEvent.DISCARDED, "aborted")

    def _check_again(self, blob: BlobIdentity, now_us: int) -> None:
        self.complete(now_us)

    # Helpers.

    def _resume(self, incoming: Incoming | None) -> None:
        """Resume the upload that the store holds, without a report."""
        for kind in Kind:
            if incoming is None or kind != incoming.kind:
                self._store.discard(kind)
        if incoming is None:
            return
        self.current.resume(incoming)
        self.state = UploadState.RECEIVING
        if self.current.held == self.current.chunks:
            self.complete(0)
        self._reports.take()  # discarded: the first report follows a request

    def _clear(self, event: UploadEvent, text: str) -> None:
        self._emit(event, text)
        self.current.forget(discard=event is not UploadEvent.COMMITTED)
        self.verdict = None
        self._reports.forget()

    def _note_live(self, kind: int) -> None:
        live = self._store.live(kind)
        if live is not None:
            self.live[kind] = hashlib.sha256(live).digest()

    def _emit(self, event: UploadEvent, text: str) -> None:
        self._events.append(
            ReceiverEvent(event=event, kind=self.current.blob.kind, id=self.current.blob.id, text=text)
        )

    def _answer(self, digest: bytes, state: UploadState, result: UploadResult) -> None:
        self._answer_tag(tag_of(digest), state, result)

    def _answer_tag(self, tag: int, state: UploadState, result: UploadResult) -> None:
        self._reports.answer(
            tag,
            state,
            result,
            kind=self.current.blob.kind,
            held=self.current.held,
            have=self.current.held_chunks,
        )
