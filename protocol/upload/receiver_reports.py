"""When the receiver of an upload says how far it is, and with which message."""

from __future__ import annotations

from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, UploadResult, UploadState
from trimtab.protocol.upload.receiver_table import STATES
from trimtab.protocol.upload.transfer import Verdict, encode_bitmap, encode_text, tag_of

REPORT_CHUNKS, REPORT_US = 24, 40_000
"""Chunks after which a status goes out, and time after a chunk by which it does. Each takes a slot from the
chunks, so there are few of them ...
"""
LAST_CHUNKS = 8
LAST_REPORT_CHUNKS, LAST_REPORT_US = 4, 1_000
"""... until so many are missing: then the sender waits to hear which, and slots are free."""
REMIND_US = (60_000, 1_000_000)
"""Time of quiet after which the last status goes out again: at first, and at most, doubling in between."""


class Reports:
    """What waits to be sent, and when the next report is due.

    Parameters
    ----------
    silence_us
        after this time without a message about the blob in hand nobody is reminded of it.

    `heard_us` is when the last message about it came. `stray_tag`: of a chunk of a blob that is not known.
    `query`: number of the last UPLOAD_BEGIN, which every status repeats.
    """

    def __init__(self, silence_us: int) -> None:
        self.heard_us = -silence_us
        self.stray_tag: int | None = None
        self.query = 0
        self._silence_us = silence_us
        self._unreported = 0  # chunks
        self._report_us: int | None = None
        self._remind_us = 0
        self._reminders = 0
        self._base = 0  # chunks that are held without a gap
        self._out: list[Message] = []

    # When.

    def hear(self, now_us: int) -> None:
        """Note that a message about the current blob arrived."""
        self.heard_us = now_us
        self._reminders = 0
        self._remind_us = now_us + REMIND_US[0]

    def reminding(self, at_us: int) -> bool:
        """Whether the host still asks about the blob in hand at that time."""
        return at_us - self.heard_us < self._silence_us

    def soon(self, missing: int, now_us: int) -> None:
        """Schedule a report: a chunk arrived and `missing` are still missing."""
        last = missing <= LAST_CHUNKS
        self._unreported += 1
        if self._unreported >= (LAST_REPORT_CHUNKS if last else REPORT_CHUNKS):
            self._unreported = 0
            self._report_us = now_us
        elif self._report_us is None:
            self._report_us = now_us + (LAST_REPORT_US if last else REPORT_US)

    def due(self, now_us: int, in_hand: bool) -> bool:
        """Whether to report now, with a blob in hand or without."""
        if self._report_us is not None and now_us >= self._report_us:
            return True
        if in_hand and self.reminding(now_us) and now_us >= self._remind_us:
            self._reminders += 1
            return True
        return False

    def next_us(self, in_hand: bool) -> int | None:
        """When there is next something to send, with a blob in hand or without; None where nothing is."""
        if self._out:
            return 0
        deadlines = [] if self._report_us is None else [self._report_us]
        if in_hand and self.reminding(self._remind_us):
            deadlines.append(self._remind_us)
        return min(deadlines, default=None)

    def reported(self) -> None:
        """Clear the report that was due for the chunks so far."""
        self._report_us = None
        self._unreported = 0

    def remind(self, now_us: int) -> None:
        """Schedule a repetition of the present report in case nothing arrives."""
        self._remind_us = now_us + min(REMIND_US[0] << min(self._reminders, 8), REMIND_US[1])

    def fall_silent(self, now_us: int) -> None:
        """Stop reporting on the current blob: nobody waits for it."""
        self.heard_us = now_us - self._silence_us
        self._report_us = None
        self._out.clear()

    def forget(self) -> None:
        """Forget the current blob."""
        self._base = self._unreported = 0
        self._report_us = None

    # What.

    def answer(
        self, tag: int, state: UploadState, result: UploadResult, *, kind: int, held: int, have: bytearray
    ) -> None:
        """Queue UPLOAD_STATUS. `have`: a byte for each chunk of the current blob, 1 if held."""
        base, bitmap = 0, bytes(64)
        if state in STATES[1:]:
            while self._base < len(have) and have[self._base]:
                self._base += 1
            base, bitmap = self._base, encode_bitmap(have, self._base)
        else:
            held = 0
        self._out.append(m.UploadStatus(tag, base, held, state, result, kind, self.query, bitmap))

    def verdict(self, digest: bytes, verdict: Verdict) -> None:
        """Queue UPLOAD_VERDICT on the blob of this digest."""
        self._out.append(
            m.UploadVerdict(
                verdict.value,
                verdict.bound,
                tag_of(digest),
                m.NO_NODE if verdict.node is None else verdict.node,
                int(verdict.ok),
                verdict.reason,
                encode_text(verdict.message),
            )
        )

    def take(self) -> list[Message]:
        """Return what waits; it waits no longer."""
        out, self._out = self._out, []
        return out
