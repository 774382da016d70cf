"""Inputs for the fuzzer, and a search for the valid messages in them.

Frames are packed from the dialect's field tables with pymavlink's checksum. Valid messages are found by
trying pymavlink's decoder at every offset. Neither shares code with the tested programs. pymavlink's stream
parser cannot serve as the oracle: after damage, it drops as many bytes as a false header claims.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from random import Random
from typing import Any, NamedTuple

from trimtab.protocol.messages import VEHICLE, Message, mavlink

MAGIC = 0xFD
HEADER_BYTES = 10
SIGNATURE_BYTES = 13
FLUSH = bytes(HEADER_BYTES + 255 + 2 + SIGNATURE_BYTES)
"""Padding after which no earlier header is still incomplete."""
PRIVATE = 52100
"""First id of Trimtab's messages. They have no extensions, so a longer payload is invalid."""

_REFUSED = (mavlink.MAVError, struct.error, ValueError, IndexError, UnicodeDecodeError)
_parser = mavlink.MAVLink(None)

_SIZES = {"c": 1, "s": 1, "B": 1, "b": 1, "H": 2, "h": 2, "I": 4, "i": 4, "Q": 8, "q": 8, "f": 4, "d": 8}
_CODES = {
    "char": "c",
    "uint8_t": "B",
    "int8_t": "b",
    "uint16_t": "H",
    "int16_t": "h",
    "uint32_t": "I",
    "int32_t": "i",
    "uint64_t": "Q",
    "int64_t": "q",
    "float": "f",
    "double": "d",
}
REALS = (
    math.nan,
    math.inf,
    -math.inf,
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    3.4028235e38,
    -3.4028235e38,
    1e-45,
    1e10,
    65535.0,
    65536.0,
    21196.0,
    400.0,
)


class Field(NamedTuple):
    """A field in a message's payload: `values` values of type `code` from byte `at`."""

    name: str
    at: int
    code: str
    values: int


class Kind(NamedTuple):
    """A message of the dialect: id, checksum seed, size of its payload, its fields."""

    number: int
    seed: int
    size: int
    fields: tuple[Field, ...]


def _kind(made: Any) -> Kind:
    types = dict(zip(made.fieldnames, made.fieldtypes, strict=True))
    fields, at = [], 0
    for name, length in zip(made.ordered_fieldnames, made.array_lengths, strict=True):
        code, count = _CODES[types[name]], max(1, length)
        fields.append(Field(name, at, code, count))
        at += count * _SIZES[code]
    return Kind(made.id, made.crc_extra, at, tuple(fields))


KINDS: dict[int, Kind] = {number: _kind(made) for number, made in mavlink.mavlink_map.items()}
"""Every message of the dialect by id."""


class Found(NamedTuple):
    """A valid message in a byte string: the frame, its end, and the decoded message."""

    frame: bytes
    end: int
    message: Message


def valid_messages(data: bytes) -> list[Found]:
    """Return the valid messages in `data` in order. After each, the search continues after its last byte."""
    messages: list[Found] = []
    at = data.find(MAGIC)
    while 0 <= at <= len(data) - HEADER_BYTES - 2:
        one = _valid_at(data, at)
        if one is not None:
            messages.append(one)
        at = data.find(MAGIC, at + 1 if one is None else one.end)
    return messages


def _valid_at(data: bytes, at: int) -> Found | None:
    kind = KINDS.get(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)
    flags, length = data[at + 2], data[at + 1]
    if kind is None or flags > mavlink.MAVLINK_IFLAG_SIGNED:
        return None
    if kind.number >= PRIVATE and length > kind.size:
        return None
    end = at + HEADER_BYTES + length + 2 + (SIGNATURE_BYTES if flags else 0)
    if end > len(data):
        return None
    frame = data[at:end]
    try:
        return Found(frame, end, _parser.decode(bytearray(frame)))
    except _REFUSED:
        return None


def frame(
    number: int,
    payload: bytes,
    *,
    sender: tuple[int, int] = (255, 190),
    sequence: int = 0,
    flags: int = 0,
    wrong: int = 0,
) -> bytes:
    """Return a frame with this payload. `wrong` corrupts its checksum; a signature consists of zeros."""
    head = bytes([len(payload), flags, 0, sequence & 0xFF, *sender]) + number.to_bytes(3, "little")
    kind = KINDS.get(number)
    body = head + payload
    crc = mavlink.x25crc(body + bytes([kind.seed if kind else 0])).crc ^ wrong
    return bytes([MAGIC]) + body + crc.to_bytes(2, "little") + bytes(SIGNATURE_BYTES if flags & 1 else 0)


def pack(number: int, **values: Any) -> bytes:
    """Return the payload of a message whose other fields are 0."""
    kind = KINDS[number]
    payload = bytearray(kind.size)
    for field in kind.fields:
        if field.name in values:
            value = values[field.name]
            many = value if isinstance(value, tuple | list) else (value,)
            if isinstance(value, bytes):
                payload[field.at : field.at + len(value)] = value
            else:
                struct.pack_into(f"<{len(many)}{field.code}", payload, field.at, *many)
    return bytes(payload)


def random_bytes(rng: Random, most: int) -> bytes:
    """Return random bytes of any length up to `most`, some with many starts of messages."""
    size = rng.randrange(1, most) if rng.random() < 0.3 else rng.randrange(1, 1 + min(most, 120))
    data = bytearray(rng.randbytes(size))
    for _ in range(rng.choice((0, 0, 1, 3, 20))):
        at = rng.randrange(size)
        head = bytes([MAGIC, rng.randrange(256), rng.choice((0, 0, 0, 1, 2, 255)), 0])
        head += rng.randbytes(3) + rng.choice(_NUMBERS).to_bytes(3, "little")
        data[at : at + len(head)] = head
    return bytes(data[: max(size, 1)])


_NUMBERS = tuple(KINDS)


def random_message(
    rng: Random, numbers: Sequence[int] = _NUMBERS, sender: Callable[[Random], tuple[int, int]] | None = None
) -> bytes:
    """Return a frame of a message of the dialect with unusual values, sometimes damaged."""
    kind = KINDS[rng.choice(numbers)]
    draw = rng.random()
    if draw < 0.3:
        payload = bytearray(rng.randbytes(kind.size))
    else:
        payload = bytearray(kind.size if draw < 0.9 else b"\xff" * kind.size)
        for _ in range(rng.randrange(1, 6)):
            _put_odd(rng, payload, rng.choice(kind.fields))
    for field in kind.fields:
        if field.name in ("target_system", "target_component") and rng.random() < 0.85:
            payload[field.at] = rng.choice((VEHICLE[0], VEHICLE[0], VEHICLE[0], 0))
        elif field.name == "command" and rng.random() < 0.8:
            struct.pack_into("<H", payload, field.at, rng.choice(COMMANDS))
    data = bytes(payload)
    draw = rng.random()
    if draw < 0.6:
        data = data.rstrip(b"\0") or b"\0"
    elif draw < 0.7:
        data = data[: rng.randrange(len(data) + 1)]
    elif draw < 0.78:
        data = (data + rng.randbytes(rng.randrange(1, 60)))[:255]
    wrong = rng.randrange(1, 65536) if rng.random() < 0.15 else 0
    flags = rng.choice((1, 1, 2, 3, 255)) if rng.random() < 0.1 else 0
    made = frame(
        kind.number,
        data,
        sender=any_sender(rng) if sender is None else sender(rng),
        sequence=rng.randrange(256),
        flags=flags,
        wrong=wrong,
    )
    return made if rng.random() < 0.93 else made[: rng.randrange(len(made))]


COMMANDS = (
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_MISSION_START,
    mavlink.MAV_CMD_NAV_LAND,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION,
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    mavlink.MAV_CMD_USER_1,
    22,  # NAV_TAKEOFF
    176,  # DO_SET_MODE
    511,  # SET_MESSAGE_INTERVAL
    410,  # GET_HOME_POSITION
    519,
    520,
)
"""Usual commands in COMMAND_LONG and COMMAND_INT. Those that Trimtab does not support must be refused."""


def any_sender(rng: Random) -> tuple[int, int]:
    """Return a sender: mostly a ground station, sometimes the vehicle itself or any other."""
    draw = rng.random()
    if draw < 0.8:
        return (255, 190)
    return (1, rng.choice((1, 68))) if draw < 0.9 else (rng.randrange(256), rng.randrange(256))


def _put_odd(rng: Random, payload: bytearray, field: Field) -> None:
    """Replace one value of the field by an unusual one."""
    size = _SIZES[field.code]
    at = field.at + size * rng.randrange(field.values)
    if field.code in "fd":
        value = rng.choice(REALS) if rng.random() < 0.7 else rng.uniform(-100.0, 100.0)
        struct.pack_into("<" + field.code, payload, at, value)
        return
    bits = 8 * size
    whole = rng.choice(
        (0, 1, 2, 3, (1 << bits) - 1, 1 << (bits - 1), (1 << (bits - 1)) - 1, 1 << bits // 2, -1)
    )
    if whole == -1:
        whole = rng.getrandbits(bits)
    payload[at : at + size] = whole.to_bytes(size, "little")
