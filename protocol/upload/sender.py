"""The host's end of an upload: announces a blob, sends chunks until they are all there, commits.

Selective repeat: every status says which chunks are held. A chunk counts as lost once one that was sent at
least `_REORDER` later is held; only chunks that were sent once show that, of others it is not known which
copy arrived. Where answers stay out, the announcement goes out again; the answer to it is the receiver's full
word on what it holds, also after it was started anew. Every question has a number that answers repeat: what
was said before, perhaps to a host that was killed, is not taken for the answer.

Chunks leave at the pace of the channel and not as fast as the line takes them: the radio's queue stays
short, so that a status soon shows what was lost and what is sent again is not behind others. Where a link has
lost something, chunks under way are repeated whenever the sender could only wait: at the end of the blob, and
while no status comes. Otherwise each loss among the last chunks would cost a round trip, and a spell of
losses that lasts for a number of frames would last as long as the sender waits.
"""

from __future__ import annotations

import hashlib
import heapq
from collections.abc import Callable
from typing import NamedTuple

from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, UploadResult, UploadState
from trimtab.protocol.upload.sender_table import TABLE, Action, Event, Refusal, SenderState
from trimtab.protocol.upload.transfer import (
    BITMAP_BYTES,
    CHUNK_BYTES,
    SIZE_MAX,
    Verdict,
    chunk_count,
    decode_bitmap,
    tag_of,
)

WINDOW = 40
"""Chunks under way at a time: 4.4 kB, which fit the radio's queue for uploads and the air."""
INTERVAL_US = 2_150
"""Least time between two chunks: a slot of the radio, and a little for what comes back."""
_COPY_INTERVALS = 2
"""A chunk under way is repeated at most every so many intervals ..."""
_COPY_US = 20_000
"""... and each of them so long after it was sent last."""
_QUIET_US = 60_000
"""Time without a status after which chunks under way are repeated also before the end."""
_ASK_US = 10_000
"""Time after which an announcement or a commit that is not answered goes out again."""
_QUERY_US = 10_000
"""Questions are numbered from the time of the first in these: a host that follows another at once has other
numbers, for none asks more often.
"""
_QUERIES = 255
_REORDER = 3
_RESTARTS_MAX = 8
_RTT_FIRST_US = 100_000
_OVERDUE_MIN_US = 50_000
_OVERDUE_MAX_US = 500_000
_NEVER_US = 1 << 62


class _Flight(NamedTuple):
    """One chunk under way: its place in the order of sending, when it left, whether it left before, when its
    last copy left.
    """

    number: int
    sent_us: int
    again: bool
    copy_us: int


class UploadSender:
    """Sends one blob. Call `send` for what is due, `receive` with what arrives, `advance` at the deadline.

    Parameters
    ----------
    blob
        the bytes, 1 to SIZE_MAX.
    kind
        `blobs.Kind`.
    commit
        make it live once accepted; otherwise an accepted blob stays staged.
    at_tick
        the vehicle's tick at which it takes over in flight; None makes it live at once, on the
        floor.
    window
        chunks under way at a time. interval_us: least time between two chunks, which paces an
        upload in flight.
    patience_us
        time without progress after which the upload fails.

    Attributes
    ----------
    state
        how far it is; `over` once DONE or FAILED.
    reason
        why it failed, for people; empty before.
    verdict
        what the vehicle's check said, None before.
    chunks
        number of chunks; `held`: how many the vehicle has.
    messages_sent, chunks_sent, chunks_repeated
        counts; chunks_sent holds those repeated.
    restarts
        how often the vehicle had to be told everything again.
    """

    def __init__(
        self,
        blob: bytes,
        kind: int,
        *,
        commit: bool = True,
        target_system: int = m.VEHICLE[0],
        at_tick: int | None = None,
        window: int = WINDOW,
        interval_us: int = INTERVAL_US,
        patience_us: int = 15_000_000,
    ) -> None:
        if not 0 < len(blob) <= SIZE_MAX:
            raise ValueError(f"a blob has 1 to {SIZE_MAX} bytes, not {len(blob)}")
        if not 0 < window <= 8 * BITMAP_BYTES:
            raise ValueError(f"window must be 1 to {8 * BITMAP_BYTES}, not {window}")
        self.state = SenderState.OPENING
        self.reason = ""
        self.silent = False
        self.verdict: Verdict | None = None
        self.digest = hashlib.sha256(blob).digest()
        self.chunks = chunk_count(len(blob))
        self.messages_sent = 0
        self.chunks_sent = 0
        self.chunks_repeated = 0
        self.restarts = 0
        self._blob = bytes(blob)
        self._kind = int(kind)
        self._commit_wanted = commit
        self._target = target_system
        self._at_tick = m.NO_TICK if at_tick is None else at_tick
        self._window = window
        self._interval_us = interval_us
        self._chunk_us = 0
        self._status_us = 0
        self._patience_us = patience_us
        self._tag = tag_of(self.digest)
        self._held = bytearray(self.chunks)
        self._base = 0
        self._next = 0
        self._sent_once = bytearray(self.chunks)
        self._flight: dict[int, _Flight] = {}
        self._lost: list[int] = []
        self._number = 0
        self._query = 0
        self._asked = False
        self._rtt_us = _RTT_FIRST_US
        self._overdue = 0
        self._active_us: int | None = None
        self._progress_us = 0
        self._out: list[Message] = []
        self._actions: dict[Action, Callable[[Message | None, int], None]] = {
            Action.NOTHING: lambda message, now_us: None,
            Action.NOTE_HELD: self._note_held,
            Action.RESTART: self._restart,
            Action.ASK: self._ask,
            Action.COMMIT: self._commit,
            Action.FAIL_REFUSED: self._fail_refused,
            Action.FAIL_HOPELESS: lambda message, now_us: self._fail("the vehicle lost it again and again"),
            Action.FAIL_REJECTED: self._fail_rejected,
            Action.FAIL_BUSY: self._fail_busy,
            Action.FAIL_SILENCE: self._fail_silence,
            Action.ABORT: self._abort,
        }

    @property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256."""
        return self.digest[:6].hex()

    @property
    def held(self) -> int:
        """Chunks that the vehicle is known to hold."""
        return sum(self._held)

    @property
    def over(self) -> bool:
        """Whether nothing more will happen."""
        return self.state in (SenderState.DONE, SenderState.FAILED)

    def receive(self, message: Message, now_us: int) -> bool:
        """Whether the message was about this upload."""
        if isinstance(message, m.UploadVerdict) and message.tag == self._tag:
            self.verdict = _read_verdict(message)
            event = self._staged() if self.verdict.ok else Event.REFUSED_WHY
        elif isinstance(message, m.UploadStatus) and message.tag == self._tag:
            if self.state is SenderState.OPENING and message.query != self._query:
                return True  # said before the vehicle heard the question
            event = self._status_event(message)
        else:
            return False
        if self._active_us is None:
            self._progress_us = now_us
        self._status_us = now_us
        if self._do(event, message, now_us):
            self._active_us = now_us
            self._overdue = 0
        return True

    def advance(self, now_us: int) -> None:
        """Ask again where an answer is overdue, and give up at the end of the patience."""
        if self.over or self._active_us is None:
            return
        if now_us - self._progress_us >= self._patience_us:
            self._do(Event.SILENCE, None, now_us)
        elif now_us >= self._active_us + self._overdue_us():
            self._overdue += 1
            self._active_us = now_us
            self._do(Event.OVERDUE, None, now_us)

    def send(self, now_us: int) -> list[Message]:
        """Return the messages that are due; the first call announces the blob."""
        if self._active_us is None:
            self._active_us = self._progress_us = now_us
            self._query = now_us // _QUERY_US
            self._ask(None, now_us)
        out, self._out = self._out, []
        if self.state is SenderState.SENDING:
            out.extend(self._chunks(now_us) or self._copies(now_us))
        if out:
            self._active_us = now_us
            self.messages_sent += len(out)
        return out

    def next_deadline_us(self) -> int | None:
        """Time by which to call `advance` and `send`; None when it is over."""
        if self.over and not self._out:
            return None
        if self._active_us is None or self._out:
            return 0
        deadline_us = min(self._active_us + self._overdue_us(), self._progress_us + self._patience_us)
        if self.state is SenderState.SENDING:
            may_send = not self._exhausted() and len(self._flight) < self._window
            deadline_us = min(deadline_us, self._chunk_us if may_send else self._copy_due_us())
        return deadline_us

    def cancel(self, now_us: int) -> None:
        """End the upload as failed and tell the vehicle to discard what it has."""
        self._do(Event.CANCEL, None, now_us)

    # Which event an answer is.

    def _staged(self) -> Event:
        return Event.STAGED if self._commit_wanted else Event.STAGED_ENOUGH

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
            return Event.HOPELESS
        return Event.CORRUPT if result == UploadResult.CORRUPT else Event.FORGOTTEN

    def _do(self, event: Event, message: Message | None, now_us: int) -> bool:
        """Whether the event means something in this state."""
        entry = TABLE(self.state, event)
        if isinstance(entry, Refusal):
            return False
        if entry.state is not self.state and entry.action is not Action.RESTART:
            self._progress_us = now_us
        self.state = entry.state
        self._actions[entry.action](message, now_us)
        return True

    # What is done.

    def _ask(self, message: Message | None, now_us: int) -> None:
        self._number += _REORDER
        if not self._asked:  # a repeated question keeps its number: whichever answer comes first will do
            self._asked = True
            self._query = self._query % _QUERIES + 1
        size, digest = len(self._blob), self.digest
        self._out.append(m.UploadBegin(size, self._target, self._kind, CHUNK_BYTES, self._query, digest))

    def _restart(self, message: Message | None, now_us: int) -> None:
        self.restarts += 1
        self.verdict = None
        self._held = bytearray(self.chunks)
        self._flight.clear()
        self._lost.clear()
        self._base = self._next = 0
        self._asked = False
        self._ask(message, now_us)

    def _commit(self, message: Message | None, now_us: int) -> None:
        self._out.append(m.UploadCommit(self._at_tick, self._target, self._kind, self.digest))

    def _note_held(self, message: Message | None, now_us: int) -> None:
        if not isinstance(message, m.UploadStatus) or message.base > self.chunks:
            return
        before, newest = self._held, 0
        if self._asked and message.query == self._query:
            # This is the whole truth, what it does not name is not there.
            self._asked = False
            self._held, self._base = bytearray(self.chunks), 0
        bitmap = decode_bitmap(bytes(message.bitmap), message.base)
        for index in (*range(self._base, message.base), *bitmap):
            if index >= self.chunks or self._held[index]:
                continue
            if not before[index]:
                self._progress_us = now_us
            self._held[index] = 1
            flight = self._flight.pop(index, None)
            if flight is not None and not flight.again:
                newest = max(newest, flight.number)
                self._rtt_us += (now_us - flight.sent_us - self._rtt_us) // 8
        self._base = max(self._base, message.base)
        if before is not self._held:
            for index in range(self._base, self._next):
                if before[index] and not self._held[index]:
                    heapq.heappush(self._lost, index)
        newest -= _REORDER
        oldest_us = now_us - self._rtt_us - self._rtt_us // 2
        overtaken = [i for i, f in self._flight.items() if f.number <= newest or f.sent_us < oldest_us]
        for index in overtaken:
            del self._flight[index]
            heapq.heappush(self._lost, index)

    def _chunks(self, now_us: int) -> list[Message]:
        out: list[Message] = []
        while len(self._flight) < self._window and now_us >= self._chunk_us:
            index = self._pick()
            if index is None:
                break
            self._number += 1
            again = bool(self._sent_once[index])
            self._flight[index] = _Flight(self._number, now_us, again, now_us)
            self.chunks_repeated += again
            self._sent_once[index] = 1
            out.append(self._chunk(index))
            self._pace(now_us, 1)
        return out

    def _copies(self, now_us: int) -> list[Message]:
        """Return the chunk under way that left longest ago, where it is time to repeat one."""
        if now_us < self._copy_due_us():
            return []
        index, flight = min(self._flight.items(), key=lambda item: item[1].copy_us)
        self._flight[index] = flight._replace(again=True, copy_us=now_us)
        self.chunks_repeated += 1
        self._pace(now_us, _COPY_INTERVALS)
        return [self._chunk(index)]

    def _copy_due_us(self) -> int:
        """When the next chunk under way is to be repeated; far away where none is."""
        if not self._flight or not self.chunks_repeated:
            return _NEVER_US
        quiet_us = 0 if self._exhausted() else self._status_us + _QUIET_US
        oldest_us = min(flight.copy_us for flight in self._flight.values())
        return max(self._chunk_us, oldest_us + _COPY_US, quiet_us)

    def _exhausted(self) -> bool:
        """Whether every chunk is under way or held."""
        return not self._lost and self._next >= self.chunks

    def _chunk(self, index: int) -> Message:
        self.chunks_sent += 1
        data = self._blob[index * CHUNK_BYTES : (index + 1) * CHUNK_BYTES].ljust(CHUNK_BYTES, b"\0")
        return m.UploadChunk(self._tag, index, self._target, data)

    def _pace(self, now_us: int, intervals: int) -> None:
        """Schedule the next chunk `intervals` later; a late chunk does not delay it."""
        started_us = max(self._chunk_us, now_us - self._interval_us)
        self._chunk_us = started_us + intervals * self._interval_us

    def _pick(self) -> int | None:
        """Return the next chunk to send: lost ones first, then new ones as far as a status can report
        them.
        """
        while self._lost:
            index = heapq.heappop(self._lost)
            if not self._held[index] and index not in self._flight:
                return index
        while self._next < min(self.chunks, self._base + 8 * BITMAP_BYTES):
            index = self._next
            self._next += 1
            if not self._held[index] and index not in self._flight:
                return index
        return None

    def _overdue_us(self) -> int:
        """Time without an answer after which it is asked for again; it doubles where none comes."""
        once = _ASK_US
        if self.state is SenderState.SENDING:
            once = max(_OVERDUE_MIN_US, self._rtt_us + self._rtt_us // 4 + 10_000)
        return min(once << max(0, min(self._overdue - 4, 8)), max(once, _OVERDUE_MAX_US))

    def _abort(self, message: Message | None, now_us: int) -> None:
        self._fail("cancelled")
        self._out.append(m.UploadAbort(self._target, self.digest))

    def _fail(self, reason: str) -> None:
        self.reason = reason

    def _fail_busy(self, message: Message | None, now_us: int) -> None:
        at_once = self._at_tick == m.NO_TICK
        self._fail(
            "the vehicle does not swap it while it flies"
            if at_once
            else "the vehicle flies no reference that it could follow"
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
            self._fail(f"the vehicle takes no blobs of kind {self._kind}")
        else:
            self._fail("the vehicle takes no chunks of this size")


def _read_verdict(message: m.UploadVerdict) -> Verdict:
    return Verdict(
        ok=bool(message.ok),
        node=None if message.node == m.NO_NODE else message.node,
        reason=message.reason,
        value=message.value,
        bound=message.bound,
        message=message.message,
    )
