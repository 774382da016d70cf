"""The host's end of an upload: announces a blob, sends chunks until all are held, and commits.

Every status reports which chunks are held; `chunk_schedule` decides which chunk is sent next. If no answer
arrives, the sender repeats the announcement. The answer lists all chunks that the receiver holds, also after
a restart. Every announcement has a number that its answers repeat, so an answer to an earlier announcement,
possibly of a host that was killed, is not mistaken for the answer to the present one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable

from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, UploadResult, UploadState
from trimtab.protocol.upload.chunk_schedule import ChunkSchedule
from trimtab.protocol.upload.sender_table import TABLE, Action, Event, Refusal, SenderState
from trimtab.protocol.upload.transfer import (
    BITMAP_BYTES,
    CHUNK_BYTES,
    CHUNK_SIZES,
    SIZE_MAX,
    Verdict,
    chunk_count,
    decode_bitmap,
    tag_of,
)

WINDOW = 40
"""Greatest number of chunks in flight, 4.6 kB: 4.1 kB fit the radio's queue, the rest is on its way."""
INTERVAL_US = 2_150
"""Least time between two chunks: one slot of the radio plus a margin for the return traffic."""
_REPEAT_US = 10_000
"""Time after which an unanswered announcement or commit is repeated."""
_ANNOUNCEMENT_US = 10_000
"""The first announcement takes its number from the clock in this unit, so a restarted host begins with
another number."""
_ANNOUNCEMENTS = 255
_RESTARTS_MAX = 8
_OVERDUE_MIN_US = 50_000
_OVERDUE_MAX_US = 500_000


class UploadSender:
    """Sends one blob.

    The owner sends the messages that `send` returns, passes received messages to `receive`, and calls
    `advance` at the deadline.

    Parameters
    ----------
    blob
        Bytes of the blob, 1 to SIZE_MAX.
    kind
        One of `blobs.Kind`.
    commit
        Whether to make the blob live once it is accepted; otherwise it stays staged.
    at_tick
        Tick of the vehicle at which the blob takes over in flight; None for an immediate commit on the floor.
    chunk_bytes
        Bytes in each chunk, one of CHUNK_SIZES: SIGNED_CHUNK_BYTES if messages are signed.
    window, interval_us
        Greatest number of chunks in flight, and least time between two chunks.
    patience_us
        Time without progress after which the upload fails.

    Attributes
    ----------
    state
        Progress of the upload; `over` is true once it is DONE or FAILED.
    reason
        Text that explains a failure; empty before.
    verdict
        Verdict of the vehicle's check; None before the check.
    chunks, held
        Number of chunks, and number of chunks that the vehicle holds.
    messages_sent, chunks_sent, chunks_repeated
        Counts. chunks_sent includes repeated chunks.
    restarts
        Number of times that the vehicle had lost all chunks.
    """

    def __init__(
        self,
        blob: bytes,
        kind: int,
        *,
        commit: bool = True,
        at_tick: int | None = None,
        chunk_bytes: int = CHUNK_BYTES,
        window: int = WINDOW,
        interval_us: int = INTERVAL_US,
        patience_us: int = 15_000_000,
    ) -> None:
        if not 0 < len(blob) <= SIZE_MAX:
            raise ValueError(f"a blob has 1 to {SIZE_MAX} bytes, not {len(blob)}")
        if chunk_bytes not in CHUNK_SIZES:
            raise ValueError(f"chunk_bytes must be one of {CHUNK_SIZES}, not {chunk_bytes}")
        if not 0 < window <= 8 * BITMAP_BYTES:
            raise ValueError(f"window must be 1 to {8 * BITMAP_BYTES}, not {window}")
        self.state = SenderState.OPENING
        self.reason = ""
        self.silent = False
        self.verdict: Verdict | None = None
        self.digest = hashlib.sha256(blob).digest()
        self.chunks = chunk_count(len(blob), chunk_bytes)
        self.messages_sent = 0
        self.chunks_sent = 0
        self.restarts = 0
        self._blob = bytes(blob)
        self._chunk_bytes = chunk_bytes
        self._kind = int(kind)
        self._commit_wanted = commit
        self._target = m.VEHICLE[0]
        self._at_tick = m.NO_TICK if at_tick is None else at_tick
        self._status_us = 0
        self._patience_us = patience_us
        self._tag = tag_of(self.digest)
        self._schedule = ChunkSchedule(self.chunks, window=window, interval_us=interval_us)
        self._announcement = 0
        self._answer_pending = False
        self._overdue = 0
        self._waiting_since_us: int | None = None  # None before the first send
        self._progress_us = 0
        self._out: list[Message] = []
        self._actions: dict[Action, Callable[[Message | None, int], None]] = {
            Action.NOTHING: lambda message, now_us: None,
            Action.NOTE_HELD: self._note_held,
            Action.RESTART: self._restart,
            Action.ANNOUNCE: self._announce,
            Action.COMMIT: self._commit,
            Action.FAIL_REFUSED: self._fail_refused,
            Action.FAIL_RESTARTS: lambda message, now_us: self._fail("the vehicle lost it repeatedly"),
            Action.FAIL_REJECTED: self._fail_rejected,
            Action.FAIL_BUSY: self._fail_busy,
            Action.FAIL_SILENCE: self._fail_silence,
            Action.ABORT: self._abort,
        }

    @property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256 of the blob."""
        return self.digest[:6].hex()

    @property
    def held(self) -> int:
        """Number of chunks that the vehicle is known to hold."""
        return self._schedule.held.count(1)

    @property
    def chunks_repeated(self) -> int:
        """Number of chunks sent more than once."""
        return self._schedule.repeated

    @property
    def over(self) -> bool:
        """Whether the upload has ended."""
        return self.state in (SenderState.DONE, SenderState.FAILED)

    def receive(self, message: Message, now_us: int) -> bool:
        """Handle a message; return whether it was about this upload."""
        if isinstance(message, m.UploadVerdict) and message.tag == self._tag:
            self.verdict = _read_verdict(message)
            event = self._staged() if self.verdict.ok else Event.REFUSAL_VERDICT
        elif isinstance(message, m.UploadStatus) and message.tag == self._tag:
            if self.state is SenderState.OPENING and message.query != self._announcement:
                return True  # an answer to an earlier announcement
            event = self._status_event(message)
        else:
            return False
        if self._waiting_since_us is None:
            self._progress_us = now_us
        self._status_us = now_us
        if self._do(event, message, now_us):
            self._waiting_since_us = now_us
            self._overdue = 0
        return True

    def advance(self, now_us: int) -> None:
        """Repeat an overdue request; fail after `patience_us` without progress."""
        if self.over or self._waiting_since_us is None:
            return
        if now_us - self._progress_us >= self._patience_us:
            self._do(Event.SILENCE, None, now_us)
        elif now_us >= self._waiting_since_us + self._overdue_us():
            self._overdue += 1
            self._waiting_since_us = now_us
            self._do(Event.OVERDUE, None, now_us)

    def send(self, now_us: int) -> list[Message]:
        """Return the messages that are due; the first call announces the blob."""
        if self._waiting_since_us is None:
            self._waiting_since_us = self._progress_us = now_us
            self._announcement = now_us // _ANNOUNCEMENT_US
            self._announce(None, now_us)
        out, self._out = self._out, []
        if self.state is SenderState.SENDING:
            out.extend(self._chunk(index) for index in self._schedule.due(now_us, self._status_us))
        if out:
            self._waiting_since_us = now_us
            self.messages_sent += len(out)
        return out

    def next_deadline_us(self) -> int | None:
        """Return the time by which to call `advance` and `send`; None after the end."""
        if self.over and not self._out:
            return None
        if self._waiting_since_us is None or self._out:
            return 0
        deadline_us = min(self._waiting_since_us + self._overdue_us(), self._progress_us + self._patience_us)
        if self.state is SenderState.SENDING:
            deadline_us = min(deadline_us, self._schedule.next_us(self._status_us))
        return deadline_us

    def cancel(self, now_us: int) -> None:
        """End the upload as failed and tell the vehicle to discard its chunks."""
        self._do(Event.CANCEL, None, now_us)

    # Classify answers as events.

    def _staged(self) -> Event:
        return Event.STAGED if self._commit_wanted else Event.STAGED_ONLY

    def _status_event(self, status: m.UploadStatus) -> Event:
        state, result = status.state, status.result
        if state == UploadState.LIVE:
            return Event.LIVE
        if state == UploadState.SCHEDULED:
            return Event.SCHEDULED
        if state == UploadState.STAGED:
            if result in (UploadResult.NOT_CONTINUOUS, UploadResult.TOO_LATE):
                return Event.NOT_TAKEN
            return Event.BUSY if result == UploadResult.BUSY else self._staged()
        if state == UploadState.REFUSED:
            return Event.REFUSED
        if state == UploadState.RECEIVING and result == UploadResult.OK:
            return Event.RECEIVING
        if result in (UploadResult.TOO_LARGE, UploadResult.BAD_KIND) or (
            state == UploadState.IDLE and result == UploadResult.BAD_REQUEST
        ):
            return Event.REJECTED
        if self.restarts >= _RESTARTS_MAX:
            return Event.TOO_MANY_RESTARTS
        return Event.CORRUPT if result == UploadResult.CORRUPT else Event.FORGOTTEN

    def _do(self, event: Event, message: Message | None, now_us: int) -> bool:
        """Take the transition of `event`; return False if this state ignores it."""
        entry = TABLE(self.state, event)
        if isinstance(entry, Refusal):
            return False
        if entry.state is not self.state and entry.action is not Action.RESTART:
            self._progress_us = now_us
        self.state = entry.state
        self._actions[entry.action](message, now_us)
        return True

    # Actions.

    def _announce(self, message: Message | None, now_us: int) -> None:
        self._schedule.note_announcement()
        if not self._answer_pending:  # a repetition keeps its number: any answer to it is valid
            self._answer_pending = True
            self._announcement = self._announcement % _ANNOUNCEMENTS + 1
        size, digest = len(self._blob), self.digest
        self._out.append(
            m.UploadBegin(size, self._target, self._kind, self._chunk_bytes, self._announcement, digest)
        )

    def _restart(self, message: Message | None, now_us: int) -> None:
        self.restarts += 1
        self.verdict = None
        self._schedule.restart()
        self._answer_pending = False
        self._announce(message, now_us)

    def _commit(self, message: Message | None, now_us: int) -> None:
        self._out.append(m.UploadCommit(self._at_tick, self._target, self._kind, self.digest))

    def _note_held(self, message: Message | None, now_us: int) -> None:
        if not isinstance(message, m.UploadStatus) or message.base > self.chunks:
            return
        lists_all = self._answer_pending and message.query == self._announcement
        if lists_all:
            self._answer_pending = False
        bitmap = decode_bitmap(bytes(message.bitmap), message.base)
        if self._schedule.note_held(message.base, bitmap, now_us, complete=lists_all):
            self._progress_us = now_us

    def _chunk(self, index: int) -> Message:
        self.chunks_sent += 1
        step = self._chunk_bytes
        data = self._blob[index * step : (index + 1) * step]
        return m.UploadChunk(self._tag, index, self._target, data.ljust(CHUNK_BYTES, b"\0"))

    def _overdue_us(self) -> int:
        """Return the time after which a request is repeated.

        It is constant up to the fifth repetition, then doubles with each one up to _OVERDUE_MAX_US.
        """
        initial_us = _REPEAT_US
        if self.state is SenderState.SENDING:
            initial_us = max(_OVERDUE_MIN_US, self._schedule.rtt_us + self._schedule.rtt_us // 4 + 10_000)
        return min(initial_us << max(0, min(self._overdue - 4, 8)), max(initial_us, _OVERDUE_MAX_US))

    def _abort(self, message: Message | None, now_us: int) -> None:
        self._fail("cancelled")
        self._out.append(m.UploadAbort(self._target, self.digest))

    def _fail(self, reason: str) -> None:
        self.reason = reason

    def _fail_busy(self, message: Message | None, now_us: int) -> None:
        at_once = self._at_tick == m.NO_TICK
        self._fail(
            "the vehicle is armed or flying; it swaps a blob only at an agreed tick"
            if at_once
            else "the vehicle is not tracking a reference, so there is nothing to swap"
        )

    def _fail_silence(self, message: Message | None, now_us: int) -> None:
        self.silent = True
        self._fail(f"no progress for {self._patience_us / 1e6:g} s at {self.held} of {self.chunks} chunks")

    def _fail_refused(self, message: Message | None, now_us: int) -> None:
        verdict = self.verdict
        node = "" if verdict is None or verdict.node is None else f" at node {verdict.node}"
        self._fail(f"refused on board{node}: {verdict.message if verdict else ''}")

    def _fail_rejected(self, message: Message | None, now_us: int) -> None:
        result = message.result if isinstance(message, m.UploadStatus) else 0
        if result == UploadResult.TOO_LARGE:
            self._fail(f"the vehicle has no room for {len(self._blob)} bytes")
        elif result == UploadResult.BAD_KIND:
            self._fail(f"the vehicle accepts no blobs of kind {self._kind}")
        else:
            self._fail("the vehicle accepts no chunks of this size")


def _read_verdict(message: m.UploadVerdict) -> Verdict:
    return Verdict(
        ok=bool(message.ok),
        node=None if message.node == m.NO_NODE else message.node,
        reason=message.reason,
        value=message.value,
        bound=message.bound,
        message=message.message,
    )
