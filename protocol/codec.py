"""Bytes to messages and back. No I/O: `encode` returns bytes, `decode` takes whatever arrived.

Messages are found by `uwb.StreamSplitter`, which resumes behind damage one byte later where pymavlink's own
stream parser discards as much as a false header claims. Packing and unpacking use the dialect's field tables
and give the same bytes and messages two to three times faster than its own methods (tests compare both);
byte arrays come as `bytes`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx

from trimtab.protocol.generated import trimtab as mavlink
from trimtab.protocol.messages import Message
from trimtab.protocol.stream import HEADER_BYTES, MAGIC, StreamSplitter

_CODES = {
    "char": "s",
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
_LATE = 128  # a number this far ahead of the last one, modulo 256, is that of an older message


class _Layout(NamedTuple):
    """How a payload becomes fields: its size, its struct, where each field lies in what that returns."""

    build: Callable[..., Message]
    size: int
    unpack: Callable[[bytes], tuple[Any, ...]]
    places: tuple[int | slice, ...]


def _layout(kind: Any) -> _Layout:
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    form, at, places = "<", 0, {}
    for name, count in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        code = _CODES[types[name]]
        if count == 0:
            form, places[name], at = form + code, at, at + 1
        elif code in "sB":
            form, places[name], at = f"{form}{count}s", at, at + 1
        else:
            form, places[name], at = f"{form}{count}{code}", slice(at, at + count), at + count
    layout = struct.Struct(form)
    return _Layout(kind, layout.size, layout.unpack, tuple(places[name] for name in kind.fieldnames))


class _Packing(NamedTuple):
    """How a message becomes a frame: its payload as yet untrimmed, checksum seed, id as the header has it."""

    payload: Callable[[Any], bytes]
    seed: bytes
    number: tuple[int, int]


def _packing(kind: Any) -> _Packing:
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    values = []
    for name, count in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        if not count:
            values.append(f"message.{name}")
        elif types[name] == "char":
            values.append(f"message._{name}_raw")
        else:
            values.append(f"*message.{name}[:{count}]")
    # Written out field by field, as the dialect's own methods are: a loop over them takes twice as long.
    payload = eval(f"lambda message: pack({', '.join(values)})", {"pack": kind.unpacker.pack})
    return _Packing(payload, bytes([kind.crc_extra]), (kind.id & 0xFFFF, kind.id >> 16))


_PACKINGS: dict[type[Message], _Packing] = {kind: _packing(kind) for kind in mavlink.mavlink_map.values()}
_MAGIC = bytes([MAGIC])
_HEADER = struct.Struct("<BBBBBBHB")  # what follows the magic byte
_LAYOUTS: dict[int, _Layout] = {number: _layout(kind) for number, kind in mavlink.mavlink_map.items()}


class Codec:
    """One end of a link: numbers what it sends, decodes what arrives, counts what was lost.

    Parameters
    ----------
    system, component
        MAVLink address put on what is sent (`messages.HOST` and others).

    Attributes
    ----------
    sent, received
        messages.
    lost
        messages that never came, by the gaps in their senders' numbers; what was overtaken on the way
        counts as lost until it arrives.
    repeated
        messages that came twice; both are decoded.
    """

    def __init__(self, system: int, component: int) -> None:
        for name, value in (("system", system), ("component", component)):
            if not 0 <= value <= 255:
                raise ValueError(f"{name} must be 0..255, not {value}")
        self.sent = 0
        self.received = 0
        self.lost = 0
        self.repeated = 0
        self._splitter = StreamSplitter()
        self._address = (system, component)
        self._number = 0
        self._last: dict[int, int] = {}
        self._missing: dict[int, set[int]] = {}

    @property
    def bad_bytes(self) -> int:
        """Bytes received that belonged to no message of the dialect."""
        return self._splitter.bad_bytes

    @property
    def bad_checksums(self) -> int:
        """Plausible headers whose checksum was wrong: noise, or private messages of another version."""
        return self._splitter.bad_checksums

    def encode(self, message: Message) -> bytes:
        """Return the message as bytes, numbered on. Raises ValueError where a field does not fit."""
        packing = _PACKINGS[type(message)]
        try:
            payload = packing.payload(message).rstrip(b"\0") or b"\0"
        except (struct.error, TypeError, OverflowError, IndexError) as error:
            raise ValueError(f"{message.get_type()}: {error}") from error
        body = _HEADER.pack(len(payload), 0, 0, self._number, *self._address, *packing.number) + payload
        crc = mcrf4xx(body + packing.seed)
        self._number = (self._number + 1) & 0xFF
        self.sent += 1
        return _MAGIC + body + crc.to_bytes(2, "little")

    def decode(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes, oldest first. Never raises, whatever the bytes are.

        A float field may hold anything a float32 can, NaN included.
        """
        found = self._splitter.feed(data)
        if not found:
            return []
        messages = [decode_message(frame) for frame in found]
        self.received += len(messages)
        for frame in found:
            source, number = frame[5] << 8 | frame[6], frame[4]
            last = self._last.get(source)
            if last is None or number == (last + 1) & 0xFF:
                self._last[source] = number
            else:
                self._count_gap(source, last, number)
        return messages

    def _count_gap(self, source: int, last: int, number: int) -> None:
        """Count a number out of turn: a gap before it, a late message or a repeated one."""
        missing = self._missing.setdefault(source, set())
        ahead = (number - last) & 0xFF
        if ahead >= _LATE or ahead == 0:
            if number in missing:
                missing.remove(number)
                self.lost -= 1
            else:
                self.repeated += 1
            return
        self._last[source] = number
        self.lost += ahead - 1
        missing.update((last + k) & 0xFF for k in range(1, ahead))
        for old in [k for k in missing if (number - k) & 0xFF >= _LATE]:
            missing.remove(old)


def decode_message(frame: bytes) -> Message:
    """Return the message in `frame`, a whole one as a `StreamSplitter` gives it: the checksum is not looked
    at.
    """
    layout = _LAYOUTS[frame[7] | frame[8] << 8 | frame[9] << 16]
    length = frame[1]
    payload = frame[HEADER_BYTES : HEADER_BYTES + length]
    if length != layout.size:
        payload = payload.ljust(layout.size, b"\0")[: layout.size]
    values = layout.unpack(payload)
    message: Any = layout.build(*[values[place] for place in layout.places])
    header = message._header
    header.mlen = length
    header.incompat_flags = frame[2]
    header.compat_flags = frame[3]
    header.seq = frame[4]
    header.srcSystem = frame[5]
    header.srcComponent = frame[6]
    message._msgbuf = frame
    message._payload = payload
    message._crc = frame[HEADER_BYTES + length] | frame[HEADER_BYTES + length + 1] << 8
    return message
