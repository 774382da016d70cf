"""Encode messages to bytes and decode bytes to messages, without I/O.

`stream.StreamSplitter` finds the messages. After damaged bytes it resumes the search one byte later;
pymavlink's own stream parser would discard as many bytes as a false header claims. Packing and unpacking use
the field tables of the dialect. They give the same bytes and messages as its own methods, two to three times
faster (tests compare both). Byte arrays are decoded as `bytes`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx

from trimtab.protocol.generated import trimtab as mavlink
from trimtab.protocol.messages import Message
from trimtab.protocol.signing import Signer, Verdict, Verifier
from trimtab.protocol.stream import HEADER_BYTES, MAGIC, SIGNED_FLAG, StreamSplitter

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
_LATE = 128  # a sequence number this far ahead of the last one, modulo 256, belongs to an older message


class _Layout(NamedTuple):
    """Decoding of a payload: size, unpacker, and the message of the unpacked values."""

    size: int
    unpack: Callable[[bytes], tuple[Any, ...]]
    build: Callable[[tuple[Any, ...]], Message]


def _layout(kind: Any) -> _Layout:
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    form, at, fields = "<", 0, {}
    for name, count in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        code = _CODES[types[name]]
        if count == 0:
            form, fields[name], at = form + code, f"values[{at}]", at + 1
        elif code in "sB":
            form, fields[name], at = f"{form}{count}s", f"values[{at}]", at + 1
        else:
            form, fields[name], at = f"{form}{count}{code}", f"values[{at}:{at + count}]", at + count
    layout = struct.Struct(form)
    # Written out field by field, as in `_packing`.
    build = eval(
        f"lambda values: kind({', '.join(fields[name] for name in kind.fieldnames)})", {"kind": kind}
    )
    return _Layout(layout.size, layout.unpack, build)


class _Packing(NamedTuple):
    """Encoding of a message: untrimmed payload, checksum seed, and message id as it is in the header."""

    payload: Callable[[Any], bytes]
    seed: bytes
    number: bytes


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
    # Written out field by field like the dialect's own methods: a loop over the fields takes twice as long.
    payload = eval(f"lambda message: pack({', '.join(values)})", {"pack": kind.unpacker.pack})
    return _Packing(payload, bytes([kind.crc_extra]), kind.id.to_bytes(3, "little"))


_PACKINGS: dict[type[Message], _Packing] = {kind: _packing(kind) for kind in mavlink.mavlink_map.values()}
_MAGIC = bytes([MAGIC])
_HEADER = struct.Struct("<BBBBBB3s")  # without the magic byte
_LAYOUTS: dict[bytes, _Layout] = {
    number.to_bytes(3, "little"): _layout(kind) for number, kind in mavlink.mavlink_map.items()
}


class Codec:
    """One end of a link: numbers sent messages, decodes received bytes and counts lost messages.

    Without `signer`, messages are sent unsigned. Without `verifier`, signatures are not checked. The owner
    advances the clocks of both.

    Parameters
    ----------
    system, component
        MAVLink address of the sender, for example `messages.HOST`.
    accepts_unsigned
        With a verifier: returns whether an unsigned message (complete, as bytes) is accepted.

    Attributes
    ----------
    signer
        Signs the messages that are sent, or None.
    verifier
        Verifies the messages that arrive, or None. What it refuses is not decoded.
    refused
        Messages that the last call of `decode` refused, each with its verdict.
    sent, received
        Numbers of messages.
    lost
        Number of messages that did not arrive, by the gaps in their senders' sequence numbers. An overtaken
        message counts as lost until it arrives.
    repeated
        Number of messages that arrived twice; both copies are decoded.
    """

    def __init__(
        self,
        system: int,
        component: int,
        *,
        accepts_unsigned: Callable[[bytes], bool] = lambda message: False,
    ) -> None:
        for name, value in (("system", system), ("component", component)):
            if not 0 <= value <= 255:
                raise ValueError(f"{name} must be 0..255, not {value}")
        self.signer: Signer | None = None
        self.verifier: Verifier | None = None
        self.refused: list[tuple[Verdict, bytes]] = []
        self._accepts_unsigned = accepts_unsigned
        self.sent = 0
        self.received = 0
        self.lost = 0
        self.repeated = 0
        self._splitter = StreamSplitter()
        self._system, self._component = system, component
        self._sequence = 0
        self._last: dict[int, int] = {}
        self._missing: dict[int, set[int]] = {}

    @property
    def bad_bytes(self) -> int:
        """Number of received bytes that belonged to no message of the dialect."""
        return self._splitter.bad_bytes

    @property
    def bad_checksums(self) -> int:
        """Number of plausible headers with a wrong checksum: noise, or another dialect version."""
        return self._splitter.bad_checksums

    def encode(self, message: Message) -> bytes:
        """Return the message as bytes with a new sequence number. Raises ValueError if a field overflows."""
        pack, seed, number = _PACKINGS[type(message)]
        try:
            payload = pack(message).rstrip(b"\0") or b"\0"
        except (struct.error, TypeError, OverflowError, IndexError) as error:
            raise ValueError(f"{message.get_type()}: {error}") from error
        signer = self.signer
        flags = 0 if signer is None else SIGNED_FLAG
        sequence = self._sequence
        body = _HEADER.pack(len(payload), flags, 0, sequence, self._system, self._component, number) + payload
        crc = mcrf4xx(body + seed)
        self._sequence = (sequence + 1) & 0xFF
        self.sent += 1
        data = _MAGIC + body + crc.to_bytes(2, "little")
        return data if signer is None else data + signer.sign(data)

    def decode(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes, oldest first. Never raises, whatever the bytes are.

        A float field may hold any float32, including NaN.
        """
        frames = self._splitter.feed(data)
        if self.verifier is not None:
            frames = self._verified(frames, self.verifier)
        if not frames:
            return []
        self.received += len(frames)
        messages, newest = [], self._last
        for frame in frames:
            messages.append(decode_message(frame))
            source, sequence = frame[5] << 8 | frame[6], frame[4]
            last = newest.get(source)
            if last is None or sequence == (last + 1) & 0xFF:
                newest[source] = sequence
            else:
                self._count_gap(source, last, sequence)
        return messages

    def _verified(self, frames: list[bytes], verifier: Verifier) -> list[bytes]:
        """Return the accepted messages. The signer's clock follows those of the other end."""
        accepted, self.refused = [], []
        for frame in frames:
            verdict = verifier.check(frame)
            if verdict is Verdict.ACCEPTED or (verdict is Verdict.UNSIGNED and self._accepts_unsigned(frame)):
                accepted.append(frame)
            else:
                self.refused.append((verdict, frame))
        if self.signer is not None:
            self.signer.follow(verifier.newest)
        return accepted

    def _count_gap(self, source: int, last: int, sequence: int) -> None:
        """Update the counters after an unexpected sequence number: a gap, a late or a repeated message."""
        missing = self._missing.setdefault(source, set())
        ahead = (sequence - last) & 0xFF
        if ahead >= _LATE or ahead == 0:
            if sequence in missing:
                missing.remove(sequence)
                self.lost -= 1
            else:
                self.repeated += 1
            return
        self._last[source] = sequence
        self.lost += ahead - 1
        missing.update((last + k) & 0xFF for k in range(1, ahead))
        for old in [k for k in missing if (sequence - k) & 0xFF >= _LATE]:
            missing.remove(old)


def decode_message(frame: bytes) -> Message:
    """Return the message in a complete frame. Assumes that `StreamSplitter` has verified the checksum."""
    size, unpack, build = _LAYOUTS[frame[7:HEADER_BYTES]]
    payload = frame[HEADER_BYTES : HEADER_BYTES + frame[1]]
    message: Any = build(unpack(payload if len(payload) == size else payload.ljust(size, b"\0")[:size]))
    message._msgbuf = frame
    return message
