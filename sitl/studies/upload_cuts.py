"""Interrupted uploads: the link is cut for 5 s, the host is killed, or the vehicle is reset.

A trial has three uploads, one for each interruption, at a time drawn from the duration of the undisturbed
upload. Each must meet three conditions:

- It ends with the new blob live.
- After every write to the vehicle's memory, the live blob is either the complete old or the complete new one.
- No received chunk is sent again. After a cut or a reset, this concerns every chunk that the vehicle held and
  the host knew of; chunks or statuses in transit may be repeated. A restarted host asks first, so it concerns
  every chunk that the vehicle held.
"""

from __future__ import annotations

from typing import Any

from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import Message, UploadChunk, UploadStatus
from trimtab.protocol.upload import SenderState
from trimtab.protocol.upload.transfer import decode_bitmap
from trimtab.sitl.seeds import Purpose, flight_generator
from trimtab.sitl.studies.upload_blob import reference_blob
from trimtab.sitl.studies.upload_rig import UploadRig
from trimtab.sitl.studies.uploads import CHANNELS, GIVE_UP_US
from trimtab.sitl.world import RadioSettings

CUT_S = 5.0
INTERRUPTIONS = ("cut", "host", "vehicle")
_CHANNEL = CHANNELS["upload"]


class _Watch:
    """Chunks that the host has sent since the interruption, and those that it knows the vehicle holds."""

    def __init__(self) -> None:
        self.known: set[int] = set()
        self.sent: list[int] = []

    def __call__(self, now_us: int, is_sent: bool, message: Message) -> None:
        if is_sent and isinstance(message, UploadChunk):
            self.sent.append(message.index)
        elif not is_sent and isinstance(message, UploadStatus):
            self.known |= {*range(message.base), *decode_bitmap(bytes(message.bitmap), message.base)}


def interrupt(seed: int, number: int) -> dict[str, Any]:
    """Run one trial, and return the time of the interruption and the result of each kind as plain data."""
    alone = _rig(seed, number, _CHANNEL, _Watch())
    alone.run(GIVE_UP_US)
    share = float(flight_generator(seed, number, Purpose.TURBULENCE).random())
    at_us = alone.begin_us + round(share * (alone.now_us - alone.begin_us))
    return {
        "share": share,
        **{kind: _interrupted(kind, seed, number, at_us) for kind in INTERRUPTIONS},
    }


def _interrupted(kind: str, seed: int, number: int, at_us: int) -> dict[str, Any]:
    """Run an interrupted upload and return its result.

    `held` counts the chunks on board at the interruption, `resent` those sent again although they should not,
    and `seconds` runs from the end of the interruption.
    """
    radio, watch = _CHANNEL, _Watch()
    if kind == "cut":
        radio = radio.model_copy(update={"cuts_s": ((at_us * 1e-6, CUT_S),)})
    rig = _rig(seed, number, radio, watch)
    whole = _run(rig, at_us)
    held = _held(rig)
    spared = held if kind == "host" else held & watch.known
    watch.sent.clear()
    if kind == "host":
        rig.start_host()
    elif kind == "vehicle":
        rig.vehicle.reset(rig.now_us)
    whole = _run(rig, GIVE_UP_US) and whole
    resent = len(spared.intersection(watch.sent))
    done = rig.sender.state is SenderState.DONE and rig.live == rig.blob
    over_us = at_us + round(CUT_S * 1e6) if kind == "cut" else at_us
    return {
        "done": done,
        "whole": whole,
        "held": len(held),
        "resent": resent,
        "seconds": (rig.now_us - over_us) * 1e-6,
        "failed": not (done and whole) or resent > 0,
    }


def _rig(seed: int, number: int, radio: RadioSettings, watch: _Watch) -> UploadRig:
    old, new = (reference_blob("research", k) for k in (0, 1))
    return UploadRig(new, old=old, radio=radio, seed=seed, number=number, on_message=watch)


def _run(rig: UploadRig, until_us: int) -> bool:
    """Run to `until_us`. Return whether the live blob was complete after every write to memory."""
    flash, written = rig.vehicle.store.flash, -1
    while rig.now_us < until_us and not rig.sender.over:
        rig.step(until_us)
        if flash.written != written:
            written = flash.written
            if rig.live not in (rig.old, rig.blob):
                return False
    return True


def _held(rig: UploadRig) -> set[int]:
    """Return the chunks of the blob that the vehicle's memory holds."""
    if rig.live == rig.blob:
        return set(range(rig.sender.chunks))
    incoming = rig.vehicle.store.incoming()
    if incoming is None or incoming.kind != Kind.REFERENCE:
        return set()
    return {index for index, have in enumerate(incoming.held) if have}
