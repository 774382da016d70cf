"""A second reference that is sent in flight and takes over from the first at an agreed time."""

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
"""Least time between two chunks in flight: 100 a second, and about 45 answers, of the 500 slots."""
_INTERVAL_US = PACE_US - TICK_US
"""Of the sender: poses that come a tick early still take a chunk along."""
_BEHIND_US = 2 * TICK_US
"""From a pose to what follows it: the serial line goes idle between them, else the radio would be handed both
at once, when the chunk is there.
"""
_NO_POSE_US = 3 * PACE_US
"""Without poses for so long things go out all the same."""
SLOTS_PER_S = 500
"""Of the radio in its default setting."""


def swap_time_us(first: Reference, then: Reference, at_us: int | None) -> int:
    """When `then` takes over, in us of the first reference: `at_us` on a tick, or the latest time possible.

    Raises UsageError where it does not go on with `first` there, or nowhere.
    """
    start = reference_at(then, np.zeros(1, dtype=np.int64))[0]
    if at_us is None:
        times = np.arange(0, first.duration_us, TICK_US)
    else:
        times = np.array([round(at_us / TICK_US) * TICK_US])
        if not 0 < times[0] < first.duration_us:
            raise UsageError(
                f"--at {at_us * 1e-6:g}: the reference {first.id} lasts {first.duration_us * 1e-6:g} s, "
                "give a time within"
            )
    bounds = np.array([bound for _, bound, _ in JUMPS])
    found = [jumps(row, start) for row in reference_at(first, times)]
    excess = (np.array(found) / bounds).max(axis=1)
    fits = np.flatnonzero(excess <= 1.0)
    if len(fits):
        return int(times[fits[-1]])
    nearest = int(excess.argmin())
    jump = jump_text(found[nearest])
    where = f"at {times[nearest] * 1e-6:.3f} s"
    raise UsageError(
        f"the reference {then.id} does not go on with {first.id}: {where}"
        f"{'' if at_us is not None else ', where it is nearest,'} {jump[0] if jump else ''}; "
        "plan one that starts there, or give another --at"
    )


@dataclass(frozen=True, kw_only=True)
class SwapEnd:
    """What became of a swap.

    at_s: on the first reference; upload_s: from the announcement to the agreement, None where there was none;
    slots_share: messages of the upload both ways against the slots in that time; reason: why it did not
    happen, None where it did.
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
    """Sends `reference` while another is flown, to take over `at_us` after that one's start.

    poses: how many poses have gone to the vehicle. What is sent leaves shortly behind one, so that it delays
    neither that one nor, being through the air by then, the next.
    """

    wants = (m.UploadStatus, m.UploadVerdict)

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
        """Begin to send once the first reference is flown."""
        tracking = message.state == m.mavlink.TRIMTAB_STATE_TRACKING
        if self._sender is None and tracking and message.reference_tick != m.NO_TICK:
            tick = (message.reference_tick + self._at_us // TICK_US) & 0xFFFF_FFFF
            data, kind = self._reference.to_bytes(), self._reference.KIND
            self._sender = UploadSender(data, kind, at_tick=tick, interval_us=_INTERVAL_US)
            self._begin_us = now_us
            self._pump(client, now_us)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        """Take the vehicle's answers."""
        if self._sender is not None and self._sender.receive(message, now_us):
            self._answers += not self._end_us
            self._pump(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        """Act on the time that has passed."""
        if self._sender is not None:
            self._sender.advance(now_us)
            self._pump(client, now_us)

    def end(self, live: str) -> SwapEnd:
        """Return what became of it, `live` being the reference that the vehicle says it flew last."""
        sender, happened = self._sender, live == self._reference.id
        seconds = share = reason = None
        if sender is not None and sender.over:
            seconds = (self._end_us - self._begin_us) * 1e-6
            share = (sender.messages_sent + self._answers) / (SLOTS_PER_S * max(seconds, 1e-3))
        if not happened:
            if sender is None:
                reason = "its time never came"
            elif not sender.over:
                reason = f"{sender.held} of {sender.chunks} chunks were on board in time"
            else:
                reason = sender.reason or "called off on board"
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
