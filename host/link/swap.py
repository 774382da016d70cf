"""Swap: a second reference is uploaded in flight and replaces the first at an agreed time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from trimtab.firmware_model.law.smoothness import JUMPS, jump_text, jumps
from trimtab.host.base.errors import UsageError
from trimtab.host.link.client import NEVER_US, Client
from trimtab.host.log.tracking import reference_at
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import Message
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.upload import UploadSender

PACE_US = 10_000
"""Minimum time between two chunks in flight: 100 chunks and about 45 answers a second, of 500 slots."""
_INTERVAL_US = PACE_US - TICK_US
"""Interval of the sender: one tick shorter, so that a pose that comes a tick early still brings a chunk."""
_BEHIND_US = 2 * TICK_US
"""Delay of a chunk after a pose.

The serial line goes idle between the two. Without the delay, the radio would receive both together, and the
pose would wait for the chunk.
"""
_NO_POSE_US = 3 * PACE_US
"""Without a pose for this long, chunks are sent anyway."""
SLOTS_PER_S = 500
"""Slots per second of the radio with default settings."""


def swap_time_us(first: Reference, then: Reference, at_us: int | None) -> int:
    """Return the swap time in us of the first reference: `at_us` rounded to a tick, or the latest possible.

    Raises UsageError if `then` does not continue `first` smoothly at `at_us`, or at any time.
    """
    start = reference_at(then, np.zeros(1, dtype=np.int64))[0]
    if at_us is None:
        times = np.arange(0, first.duration_us, TICK_US)
    else:
        times = np.array([round(at_us / TICK_US) * TICK_US])
        if not 0 < times[0] < first.duration_us:
            raise UsageError(
                f"--at {at_us * 1e-6:g}: the reference {first.id} lasts {first.duration_us * 1e-6:g} s, "
                "give a time within it"
            )
    bounds = np.array([bound for _, bound, _ in JUMPS])
    jumps_at = [jumps(row, start) for row in reference_at(first, times)]
    excess = (np.array(jumps_at) / bounds).max(axis=1)
    fits = np.flatnonzero(excess <= 1.0)
    if len(fits):
        return int(times[fits[-1]])
    nearest = int(excess.argmin())
    jump = jump_text(jumps_at[nearest])
    where = f"at {times[nearest] * 1e-6:.3f} s"
    raise UsageError(
        f"the reference {then.id} does not continue {first.id} smoothly: {where}"
        f"{'' if at_us is not None else ', where it is nearest,'} {jump[0] if jump else ''}; "
        "plan one that starts at this point, or give another --at"
    )


@dataclass(frozen=True, kw_only=True)
class SwapEnd:
    """Outcome of a swap.

    Attributes
    ----------
    at_s
        Swap time on the first reference.
    reason
        Why the swap did not happen; None if it did.
    upload_s
        Duration of the upload, from the announcement to its end; None if the upload did not end.
    slots_share
        Messages of the upload in both directions over the radio slots in that time.
    """

    reference: str
    at_s: float
    happened: bool
    reason: str | None
    upload_s: float | None
    slots_share: float | None

    def to_json(self) -> dict[str, Any]:
        """Return the entry `swap` of `trimtab fly --json`."""
        return {
            "reference": self.reference,
            "at_s": self.at_s,
            "happened": self.happened,
            "reason": self.reason,
            "upload_s": self.upload_s,
            "slots_share": self.slots_share,
        }


class Swap:
    """Upload of `reference` during a flight; it takes over `at_us` after the start of the first reference.

    `poses` returns the number of poses sent to the vehicle. Each chunk leaves shortly after a pose, so that
    it delays neither this pose nor the next one.
    """

    wants: tuple[type[Message], ...] = (m.UploadStatus, m.UploadVerdict)

    def __init__(self, reference: Reference, at_us: int, poses: Callable[[], int]) -> None:
        self.deadline_us = NEVER_US
        self._poses = poses
        self._posed = 0
        self._due_us = 0
        self._reference = reference
        self._at_us = at_us
        self._sender: UploadSender | None = None
        self._begin_us = self._end_us = 0
        self._answers = 0

    def status(self, client: Client, message: m.FcStatus, now_us: int) -> None:
        """Begin the upload once the vehicle tracks the first reference."""
        tracking = message.state == m.mavlink.TRIMTAB_STATE_TRACKING
        if self._sender is None and tracking and message.reference_tick != m.NO_TICK:
            tick = (message.reference_tick + self._at_us // TICK_US) & 0xFFFF_FFFF
            data, kind = self._reference.to_bytes(), self._reference.KIND
            self._sender = UploadSender(
                data, kind, at_tick=tick, chunk_bytes=client.chunk_bytes, interval_us=_INTERVAL_US
            )
            self._begin_us = now_us
            self._pump(client, now_us)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        """Process an answer of the vehicle."""
        if self._sender is not None and self._sender.receive(message, now_us):
            self._answers += not self._end_us
            self._pump(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        """Send what is due at this time."""
        if self._sender is not None:
            self._sender.advance(now_us)
            self._pump(client, now_us)

    def end(self, live: str) -> SwapEnd:
        """Return the outcome, where `live` is the id of the reference that the vehicle flew last."""
        sender, happened = self._sender, live == self._reference.id
        seconds = share = reason = None
        if sender is not None and sender.over:
            seconds = (self._end_us - self._begin_us) * 1e-6
            share = (sender.messages_sent + self._answers) / (SLOTS_PER_S * max(seconds, 1e-3))
        if not happened:
            if sender is None:
                reason = "the first reference was never tracked"
            elif not sender.over:
                reason = f"only {sender.held} of {sender.chunks} chunks were on board in time"
            else:
                reason = sender.reason or "cancelled on board"
        return SwapEnd(
            reference=self._reference.id,
            at_s=self._at_us * 1e-6,
            happened=happened,
            reason=reason,
            upload_s=seconds,
            slots_share=share,
        )

    def _pump(self, client: Client, now_us: int) -> None:
        sender = self._sender
        assert sender is not None
        poses = self._poses()
        if poses != self._posed:
            self._posed = poses
            self._due_us = min(self._due_us, now_us + _BEHIND_US)
        if now_us < self._due_us and not sender.over:
            self.deadline_us = now_us + TICK_US
            return
        self._due_us = now_us + _NO_POSE_US
        for message in sender.send(now_us):
            client.send(message)
        if sender.over and not self._end_us:
            self._end_us = now_us
        deadline_us = sender.next_deadline_us()
        self.deadline_us = NEVER_US if deadline_us is None else max(deadline_us, now_us + TICK_US)
