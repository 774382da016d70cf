"""Duration of an upload by other protocols over the same link: one message at a time, each acknowledged.

This is a model, not the rig. Only one message is in transit at a time. It takes one round trip, its frames
are lost with the channel's probability in each direction, and it is repeated after a timeout.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from trimtab.sitl.radio import BurstLoss
from trimtab.sitl.world import RadioSettings


@dataclass(frozen=True, kw_only=True)
class StopAndWait:
    """A stop-and-wait protocol: data bytes and radio frames of a message, and timeout."""

    data_bytes: int
    frames: int
    timeout_s: float


PEERS = {
    "stop-and-wait": StopAndWait(data_bytes=99, frames=1, timeout_s=0.5),
    "MAVLink FTP one by one, frames as long as a message": StopAndWait(
        data_bytes=239, frames=1, timeout_s=0.5
    ),
    "MAVLink FTP one by one": StopAndWait(data_bytes=239, frames=3, timeout_s=0.5),
}
"""One chunk per frame; and MAVLink FTP, whose message of 263 B takes three frames of 116 B or a long one."""


def peer_s(peer: StopAndWait, size: int, radio: RadioSettings, round_trip_s: float, seed: int) -> float:
    """Return the duration, s, for `size` bytes. All frames of a message must arrive; each takes a slot."""
    draw = random.Random(seed).random
    up, down = (BurstLoss(radio.loss, radio.burst_frames, radio.short_risk, draw) for _ in range(2))
    once_s = round_trip_s + (peer.frames - 1) * radio.slot_us * 1e-6
    total_s, messages = 0.0, -(-size // peer.data_bytes)
    while messages:
        lost = [up.lost(116) for _ in range(peer.frames)]
        if any(lost) or down.lost(60):
            total_s += peer.timeout_s
        else:
            total_s += once_s
            messages -= 1
    return total_s
