"""How other ways of sending the same bytes do on the same air: one message at a time, each acknowledged.

A model, not the rig: what counts is that one message is under way at a time. It takes the round trip of the
link, its frames are lost with the channel's chance each way, and after a timeout it goes out again.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from trimtab.sitl.radio import BurstLoss
from trimtab.sitl.world import RadioSettings


@dataclass(frozen=True, kw_only=True)
class StopAndWait:
    """A way of sending: bytes a message, radio frames a message takes, its acknowledgement's, timeout."""

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
"""A chunk a frame; and the file transfer of MAVLink: its message of 263 B takes three frames of 116 B, and on
a radio with longer frames one.
"""


def peer_s(peer: StopAndWait, size: int, radio: RadioSettings, round_trip_s: float, seed: int) -> float:
    """Seconds that `size` bytes take. Further frames of a message take a slot each; all must arrive."""
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
