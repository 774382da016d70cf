"""Reports of the receiver of an upload: their schedule and their messages."""

from __future__ import annotations

from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, UploadResult, UploadState
from trimtab.protocol.upload.receiver_table import STATES
from trimtab.protocol.upload.transfer import Verdict, encode_bitmap, encode_text, tag_of

REPORT_CHUNKS, REPORT_US = 24, 40_000
"""Greatest number of chunks and greatest time between a chunk and its report. Each report takes a slot of the
radio from the chunks, so reports are rare.
"""
LAST_CHUNKS = 8
"""Number of missing chunks below which reports become frequent: the sender then waits for them, and slots are
free.
"""
LAST_REPORT_CHUNKS, LAST_REPORT_US = 4, 1_000
"""As REPORT_CHUNKS and REPORT_US, for the last chunks."""
REMINDER_US = (60_000, 1_000_000)
"""Silence after which the last status is repeated: initial and greatest value. It doubles each time."""


class Reports:
    """Queue and schedule of reports.

    Parameters
    ----------
    silence_us
        Time without a message about the current blob after which it is no longer reported.

    Attributes
    ----------
    arrival_us
        Time of the last message about the current blob.
    stray_tag
        Tag of a chunk of an unknown blob, or None.
    query
        Number of the last UPLOAD_BEGIN, which every status repeats.
    """

    def __init__(self, silence_us: int) -> None:
        self.arrival_us = -silence_us
        self.stray_tag: int | None = None
        self.query = 0
        self._silence_us = silence_us
        self._unreported = 0  # chunks
        self._report_us: int | None = None
        self._reminder_us = 0
        self._reminders = 0
        self._base = 0  # all chunks below this index are held
        self._out: list[Message] = []

    # Schedule.

    def message_arrived(self, now_us: int) -> None:
        """Record that a message about the current blob arrived."""
        self.arrival_us = now_us
        self._reminders = 0
        self._reminder_us = now_us + REMINDER_US[0]

    def awaited(self, at_us: int) -> bool:
        """Return whether the host still expects reports on the current blob at this time."""
        return at_us - self.arrival_us < self._silence_us

    def schedule(self, missing: int, now_us: int) -> None:
        """Schedule a report: a chunk arrived and `missing` are still missing."""
        last = missing <= LAST_CHUNKS
        self._unreported += 1
        if self._unreported >= (LAST_REPORT_CHUNKS if last else REPORT_CHUNKS):
            self._unreported = 0
            self._report_us = now_us
        elif self._report_us is None:
            self._report_us = now_us + (LAST_REPORT_US if last else REPORT_US)

    def due(self, now_us: int, has_blob: bool) -> bool:
        """Return whether a report is due. has_blob: whether there is a current blob."""
        if self._report_us is not None and now_us >= self._report_us:
            return True
        if has_blob and self.awaited(now_us) and now_us >= self._reminder_us:
            self._reminders += 1
            return True
        return False

    def next_us(self, has_blob: bool) -> int | None:
        """Return the time of the next message, or None. has_blob: whether there is a current blob."""
        if self._out:
            return 0
        deadlines = [] if self._report_us is None else [self._report_us]
        if has_blob and self.awaited(self._reminder_us):
            deadlines.append(self._reminder_us)
        return min(deadlines, default=None)

    def clear_due(self) -> None:
        """Clear the report that was due for the chunks so far."""
        self._report_us = None
        self._unreported = 0

    def schedule_reminder(self, now_us: int) -> None:
        """Schedule a repetition of the present report for the case that no message arrives."""
        self._reminder_us = now_us + min(REMINDER_US[0] << min(self._reminders, 8), REMINDER_US[1])

    def fall_silent(self, now_us: int) -> None:
        """Stop reporting on the current blob: no host waits for it."""
        self.arrival_us = now_us - self._silence_us
        self._report_us = None
        self._out.clear()

    def forget(self) -> None:
        """Reset the schedule: there is no current blob."""
        self._base = self._unreported = 0
        self._report_us = None

    # Messages.

    def answer(
        self, tag: int, state: UploadState, result: UploadResult, *, kind: int, held: int, have: bytearray
    ) -> None:
        """Queue UPLOAD_STATUS. have: one byte for each chunk of the current blob, 1 if held."""
        base, bitmap = 0, bytes(64)
        if state in STATES[1:]:
            while self._base < len(have) and have[self._base]:
                self._base += 1
            base, bitmap = self._base, encode_bitmap(have, self._base)
        else:
            held = 0
        self._out.append(m.UploadStatus(tag, base, held, state, result, kind, self.query, bitmap))

    def verdict(self, digest: bytes, verdict: Verdict) -> None:
        """Queue UPLOAD_VERDICT on the blob with this digest."""
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
        """Return and clear the queue."""
        out, self._out = self._out, []
        return out
