"""Forged and replayed frames against the verifier of a vehicle with a key.

Every forged frame is valid in form: header, checksum and length are right, and all but one field is taken
from a genuine frame of the owner. Each one arrives before the genuine frame, which must still be accepted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from random import Random
from typing import Any, cast

from trimtab.protocol import messages as m
from trimtab.protocol import unsigned
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.signing import (
    SIMULATED_EPOCH,
    UNIT_US,
    WINDOW_US,
    Signer,
    SigningKey,
    Verifier,
)
from trimtab.protocol.stream import SIGNATURE_BYTES

KEY = SigningKey(bytes(range(1, 33)))
OTHER_KEY = SigningKey(bytes(range(2, 34)))
STEP_US = 5_000
"""Interval between two genuine frames."""
DELAY_US = WINDOW_US + 500_000
"""How long delayed frames are held back."""
BLOCK = 8
"""Number of frames that arrive in a random order, each of them twice."""
_SECOND_STATION = (254, 190)


class _Stolen:
    """A signer that appends a given signature to any message."""

    def __init__(self) -> None:
        self.tail = bytes(SIGNATURE_BYTES)

    def sign(self, message: bytes) -> bytes:
        return self.tail


def message(rng: Random) -> Message:
    """Return a message that acts on the vehicle."""
    kind = rng.randrange(4)
    if kind == 0:
        values = [rng.random() for _ in range(7)]
        return m.CommandLong(*m.VEHICLE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, *values)
    if kind == 1:
        return m.ParamSet(*m.VEHICLE, b"HOLD_S", rng.random(), mavlink.MAV_PARAM_TYPE_REAL32)
    if kind == 2:
        x, y, z = (rng.uniform(-5.0, 5.0) for _ in range(3))
        return m.AttPosMocap(rng.randrange(1 << 40), (1.0, 0.0, 0.0, 0.0), x, y, z)
    return m.SetAttitudeTarget(0, *m.VEHICLE, 0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, rng.random())


@dataclass
class Link:
    """The owner, an attacker who hears all of its frames, and the vehicle's decoder."""

    rng: Random
    verifier: Verifier
    now_us: int = 0
    owner: Codec = field(default_factory=lambda: Codec(*m.HOST))
    vehicle: Codec = field(
        default_factory=lambda: Codec(*m.VEHICLE, accepts_unsigned=unsigned.vehicle_accepts)
    )

    def __post_init__(self) -> None:
        self.signer = Signer(KEY, link_id=0, epoch=SIMULATED_EPOCH)
        self.owner.signer, self.vehicle.verifier = self.signer, self.verifier
        self.stolen = _Stolen()
        self.attackers: dict[tuple[int, int], Codec] = {}

    def genuine(self) -> tuple[Message, bytes]:
        """Return the owner's next message and its frame."""
        self.now_us += STEP_US
        self.signer.advance(self.now_us)
        self.verifier.advance(self.now_us)
        sent = message(self.rng)
        return sent, self.owner.encode(sent)

    def forge(self, sent: Message, tail: bytes, address: tuple[int, int] = m.HOST, skip: int = 0) -> bytes:
        """Return `sent` under an address with a given signature; `skip`: sequence numbers left out."""
        attacker = self.attackers.setdefault(address, Codec(*address))
        attacker.signer = cast(Any, self.stolen)
        self.stolen.tail = tail
        for _ in range(skip):
            attacker.encode(sent)
        return attacker.encode(sent)

    def accepts(self, frame: bytes) -> bool:
        """Return whether the vehicle handles a frame."""
        return bool(self.vehicle.decode(frame))


def _tail(frame: bytes) -> bytearray:
    return bytearray(frame[-SIGNATURE_BYTES:])


def _with_timestamp(frame: bytes, change: int) -> bytes:
    tail = _tail(frame)
    timestamp = max(0, min((1 << 48) - 1, int.from_bytes(tail[1:7], "little") + change))
    return bytes(tail[:1] + timestamp.to_bytes(6, "little") + tail[7:])


def _flipped(link: Link, frame: bytes) -> bytes:
    tail = _tail(frame)
    tail[7 + link.rng.randrange(6)] ^= 1 << link.rng.randrange(8)
    return bytes(tail)


def _random_signature(link: Link, frame: bytes) -> bytes:
    return bytes(_tail(frame)[:7]) + link.rng.randbytes(6)


def _other_link(link: Link, frame: bytes) -> bytes:
    tail = _tail(frame)
    tail[0] ^= link.rng.randrange(1, 256)
    return bytes(tail)


def _retargeted(link: Link, sent: Message) -> Message:
    target = link.rng.randrange(2, 256)
    return m.CommandLong(target, 1, mavlink.MAV_CMD_NAV_LAND, 0, *(0.0,) * 7)


def _resequenced(link: Link, sent: Message, frame: bytes) -> bytes:
    forged = link.forge(sent, bytes(_tail(frame)), skip=link.rng.randrange(1, 4))
    return forged if forged != frame else link.forge(sent, bytes(_tail(frame)))


Forge = Callable[[Link, Message, bytes], bytes]
TAMPERED: Mapping[str, Forge] = {
    "signature, one bit": lambda link, sent, frame: link.forge(sent, _flipped(link, frame)),
    "signature, random": lambda link, sent, frame: link.forge(sent, _random_signature(link, frame)),
    "signature of another key": lambda link, sent, frame: link.forge(
        sent, Signer(OTHER_KEY, link_id=0, epoch=link.signer.time + 1).sign(frame[:-SIGNATURE_BYTES])
    ),
    "timestamp, later": lambda link, sent, frame: link.forge(
        sent, _with_timestamp(frame, link.rng.randrange(1, 1 << 44))
    ),
    "timestamp, earlier": lambda link, sent, frame: link.forge(
        sent, _with_timestamp(frame, -link.rng.randrange(1, 1 << 24))
    ),
    "link id": lambda link, sent, frame: link.forge(sent, _other_link(link, frame)),
    "sender": lambda link, sent, frame: link.forge(
        sent, bytes(_tail(frame)), (link.rng.randrange(2, 255), link.rng.randrange(1, 256))
    ),
    "sequence": lambda link, sent, frame: _resequenced(link, sent, frame),
    "target": lambda link, sent, frame: link.forge(_retargeted(link, sent), bytes(_tail(frame))),
    "content": lambda link, sent, frame: link.forge(message(link.rng), bytes(_tail(frame))),
    "no signature": lambda link, sent, frame: Codec(*m.HOST).encode(sent),
}
"""Forged frames by the field that is wrong."""


@dataclass
class Count:
    """Trials of one kind: frames sent, accepted wrongly, and genuine frames refused."""

    trials: int = 0
    accepted: int = 0
    lockouts: int = 0


def tampered(link: Link, kind: str, count: int) -> Count:
    """Send forged frames of one kind, each followed by the genuine frame."""
    forge, found = TAMPERED[kind], Count()
    for _ in range(count):
        sent, frame = link.genuine()
        found.trials += 1
        found.accepted += link.accepts(forge(link, sent, frame))
        found.lockouts += not link.accepts(frame)
    return found


def replayed(link: Link, count: int) -> Count:
    """Send frames of the owner again, at once or up to a thousand frames later."""
    found, heard = Count(), []
    for _ in range(count):
        _, frame = link.genuine()
        found.lockouts += not link.accepts(frame)
        heard.append(frame)
        del heard[:-1000]
        found.trials += 1
        found.accepted += link.accepts(link.rng.choice((frame, link.rng.choice(heard))))
    return found


def reordered(link: Link, count: int) -> Count:
    """Send frames of the owner in random order, each of them twice: once is right."""
    found = Count()
    for _ in range(-(-count // BLOCK)):
        block = [link.genuine()[1] for _ in range(BLOCK)]
        order = block * 2
        link.rng.shuffle(order)
        times = dict.fromkeys(block, 0)
        for frame in order:
            times[frame] += link.accepts(frame)
        found.trials += BLOCK
        found.accepted += sum(max(0, number - 1) for number in times.values())
        found.lockouts += sum(not number for number in times.values())
    return found


def delayed(link: Link, count: int) -> Count:
    """Hold frames of the owner back for DELAY_US while others arrive."""
    found, held = Count(), []
    number = 0
    while found.trials < count:
        _, frame = link.genuine()
        number += 1
        if number % 2:
            held.append((link.now_us + DELAY_US, frame))
        else:
            found.lockouts += not link.accepts(frame)
        if held and held[0][0] <= link.now_us:
            found.trials += 1
            found.accepted += link.accepts(held.pop(0)[1])
    return found


def after_power_cycle(link: Link, count: int) -> Count:
    """Send what was recorded before a power cycle to the vehicle after it."""
    found, heard = Count(), []
    for _ in range(count):
        _, frame = link.genuine()
        found.lockouts += not link.accepts(frame)
        heard.append(frame)
    make = type(link.verifier)
    link.vehicle.verifier = link.verifier = make(KEY, epoch=link.verifier.newest, floor=link.verifier.newest)
    link.signer.follow(link.verifier.newest + link.now_us // UNIT_US)
    for frame in heard:
        found.trials += 1
        found.accepted += link.accepts(frame)
    found.lockouts += not link.accepts(link.genuine()[1])
    return found


REPEATED: Mapping[str, Callable[[Link, int], Count]] = {
    "replayed": replayed,
    "reordered and repeated": reordered,
    "delayed": delayed,
    "replayed after a power cycle": after_power_cycle,
}
"""Genuine frames of the owner that an attacker sends, by kind."""
KINDS = (*TAMPERED, *REPEATED)


def attack(kind: str, count: int, seed: int, make: Callable[..., Verifier] = Verifier) -> Count:
    """Send `count` frames of a kind to a vehicle with this verifier.

    At the end, a second station with the key, whose clock is right, must be accepted.
    """
    link = Link(Random(f"{seed} {kind}"), make(KEY, epoch=SIMULATED_EPOCH))
    found = tampered(link, kind, count) if kind in TAMPERED else REPEATED[kind](link, count)
    second = Codec(*_SECOND_STATION)
    second.signer = Signer(KEY, link_id=0, epoch=link.signer.time)
    found.lockouts += not link.accepts(second.encode(message(link.rng)))
    return found
