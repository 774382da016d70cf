"""Sign MAVLink 2 messages and verify their signatures, without I/O. Times are passed in.

A signature has 13 bytes: link id, timestamp, and the first 48 bits of the SHA-256 of key, message, link id
and timestamp. Timestamps count 10 us since 2015-01-01 and increase from message to message, so that a
recorded message cannot be sent again.

The rules are stricter than MAVLink's where that closes a gap, and wider where the radio needs it:

- The signature is checked first. A forged message changes no state.
- The radio reorders messages by priority. A stream (system, component, link id) therefore accepts a
  timestamp that is older than its newest one, within a bounded window and only once.
- A stream that was never met must not be more than NEW_STREAM_US behind the verifier's clock. One message
  moves that clock forward by at most the same time, so no single message locks another station out.
- Timestamps beyond TIMESTAMP_MAX are refused. Otherwise one message could use up all timestamps of a key.
"""

from __future__ import annotations

import hashlib
import heapq
import hmac
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from types import MappingProxyType

from trimtab.protocol.stream import SIGNATURE_BYTES, SIGNED_FLAG, message_id

KEY_BYTES = 32
UNIT_US = 10
"""Unit of timestamps in us."""
EPOCH_UNIX_S = 1_420_070_400
"""Time 0 of timestamps, 2015-01-01, in seconds since 1970."""
SIMULATED_EPOCH = 38_000_000_000_000
"""Timestamp at time 0 of simulated flights, which read no wall clock."""
TIMESTAMP_MAX = (1 << 48) - (1 << 45)
"""Greatest timestamp that is accepted: in the year 2093, eleven years before the counter overflows."""
NEW_STREAM_US = 60_000_000
"""Greatest age of the first message of a stream."""
WINDOW_US = 2_000_000
"""Greatest age of a message against the newest one of its stream."""
WINDOW_MESSAGES = 256
"""Number of timestamps that are remembered for each stream. Older messages are refused."""
STREAMS_MAX = 16
"""Number of streams that are remembered. A further stream replaces the one that has been silent longest."""

_DIGEST_BYTES = 6
_TIMESTAMP_BYTES = 6
_TEXT = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, repr=False)
class SigningKey:
    """A secret key of KEY_BYTES. Its text never appears in messages: `repr` hides it.

    Raises ValueError for another length, or for a key of zeros, which MAVLink reserves for "no key".
    """

    secret: bytes

    def __post_init__(self) -> None:
        if len(self.secret) != KEY_BYTES:
            raise ValueError(f"a key has {KEY_BYTES} bytes, not {len(self.secret)}")
        if not any(self.secret):
            raise ValueError("a key of zeros stands for no key")

    def __repr__(self) -> str:
        return "SigningKey(hidden)"

    @classmethod
    def from_text(cls, text: str) -> SigningKey:
        """Return the key of a key file's text: the SHA-256 of its 64 hexadecimal digits.

        Ground stations derive a key from a passphrase in the same way, so the text is also their passphrase.
        Raises ValueError if the text has another form; the error does not repeat the text.
        """
        if not _TEXT.fullmatch(text):
            raise ValueError("a key is one line of 64 hexadecimal digits in lower case")
        return cls(hashlib.sha256(text.encode("ascii")).digest())


def key_text(randomness: bytes) -> str:
    """Return the text of a new key file. randomness: KEY_BYTES from a secure generator."""
    if len(randomness) != KEY_BYTES:
        raise ValueError(f"a key needs {KEY_BYTES} random bytes, not {len(randomness)}")
    return randomness.hex()


class Verdict(Enum):
    """Result of the check of a message."""

    ACCEPTED = auto()
    UNSIGNED = auto()
    BAD_SIGNATURE = auto()
    REPLAYED = auto()
    TOO_OLD = auto()
    TOO_NEW = auto()


class Signer:
    """Signs the messages of one sender. Timestamps increase strictly.

    Parameters
    ----------
    key
        Secret key.
    link_id
        Link id, 0..255.
    epoch
        Timestamp at time 0 us of the owner's clock.
    links
        Link ids of messages that have another one, by message id.
    """

    def __init__(
        self,
        key: SigningKey,
        *,
        link_id: int,
        epoch: int,
        links: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        for number in (link_id, *links.values()):
            if not 0 <= number <= 255:
                raise ValueError(f"link_id must be 0..255, not {number}")
        self.newest = 0
        self._secret = key.secret
        self._link_id = link_id
        self._links = links
        self._clock = _Clock(epoch)

    @property
    def time(self) -> int:
        """Present time as a timestamp; the next message has at least this one."""
        return self._clock.time

    def advance(self, now_us: int) -> None:
        """Set the time of the owner's clock in us."""
        self._clock.now_us = now_us

    def follow(self, timestamp: int) -> None:
        """Move the clock forward to the timestamp of a verified message. It never moves back."""
        self._clock.forward(timestamp - self._clock.time)

    def sign(self, message: bytes) -> bytes:
        """Return the signature of a complete message whose header has SIGNED_FLAG set.

        Raises OverflowError if the timestamps are used up.
        """
        self.newest = timestamp = max(self.newest + 1, self._clock.time)
        link = self._links.get(message_id(message), self._link_id)
        tail = bytes((link,)) + timestamp.to_bytes(_TIMESTAMP_BYTES, "little")
        return tail + _digest(self._secret, message + tail)


@dataclass
class _Stream:
    """Timestamps of one stream: newest, all recent ones, and the bound at or below which all are refused."""

    newest: int = 0
    floor: int = 0
    seen: set[int] = field(default_factory=set)
    oldest_first: list[int] = field(default_factory=list)

    def remember(self, timestamp: int) -> None:
        self.newest = max(self.newest, timestamp)
        self.seen.add(timestamp)
        heapq.heappush(self.oldest_first, timestamp)
        if len(self.seen) > WINDOW_MESSAGES:
            self.floor = heapq.heappop(self.oldest_first)
            self.seen.remove(self.floor)


class Verifier:
    """Verifies signatures and refuses messages that were sent again.

    Parameters
    ----------
    key
        Secret key.
    epoch
        Timestamp at time 0 us of the owner's clock.
    floor
        Every timestamp up to this one is refused, for example those that were accepted before a restart.

    Attributes
    ----------
    newest
        Newest accepted timestamp; `floor` before the first.
    counts
        Number of messages by verdict.
    """

    def __init__(self, key: SigningKey, *, epoch: int, floor: int = 0) -> None:
        self.newest = floor
        self.counts = dict.fromkeys(Verdict, 0)
        self._secret = key.secret
        self._clock = _Clock(epoch)
        self._floor = floor
        self._streams: dict[tuple[int, int, int], _Stream] = {}

    @property
    def time(self) -> int:
        """Present time as a timestamp, by which new streams are judged."""
        return self._clock.time

    @property
    def streams(self) -> int:
        """Number of streams that are remembered."""
        return len(self._streams)

    def advance(self, now_us: int) -> None:
        """Set the time of the owner's clock in us."""
        self._clock.now_us = now_us

    def check(self, message: bytes) -> Verdict:
        """Return the verdict on a complete message whose checksum is correct, and count it."""
        verdict = self._judge(message)
        self.counts[verdict] += 1
        return verdict

    def _judge(self, message: bytes) -> Verdict:
        if not message[2] & SIGNED_FLAG:
            return Verdict.UNSIGNED
        if not hmac.compare_digest(_digest(self._secret, message[:-_DIGEST_BYTES]), message[-_DIGEST_BYTES:]):
            return Verdict.BAD_SIGNATURE
        tail = message[-SIGNATURE_BYTES:-_DIGEST_BYTES]
        timestamp = int.from_bytes(tail[1:], "little")
        if timestamp > TIMESTAMP_MAX:
            return Verdict.TOO_NEW
        address = message[5], message[6], tail[0]
        stream = self._streams.get(address)
        refusal = self._refusal(stream, timestamp)
        if refusal is not None:
            return refusal
        if stream is None:
            stream = self._add(address)
        stream.remember(timestamp)
        self.newest = max(self.newest, timestamp)
        self._clock.forward(min(timestamp - self._clock.time, NEW_STREAM_US // UNIT_US))
        return Verdict.ACCEPTED

    def _refusal(self, stream: _Stream | None, timestamp: int) -> Verdict | None:
        """Return why the timestamp is not accepted, or None."""
        if stream is None:
            oldest = max(self._floor + 1, self._clock.time - NEW_STREAM_US // UNIT_US)
            return Verdict.TOO_OLD if timestamp < oldest else None
        if timestamp in stream.seen:
            return Verdict.REPLAYED
        oldest = max(stream.floor + 1, stream.newest - WINDOW_US // UNIT_US)
        return Verdict.TOO_OLD if timestamp < oldest else None

    def _add(self, address: tuple[int, int, int]) -> _Stream:
        """Return a new stream. If the table is full, forget one and refuse all that it may have accepted."""
        if len(self._streams) >= STREAMS_MAX:
            silent = min(self._streams, key=lambda other: self._streams[other].newest)
            self._floor = max(self._floor, self._streams.pop(silent).newest)
        stream = self._streams[address] = _Stream(floor=self._floor)
        return stream


class _Clock:
    """The owner's clock in us, as a timestamp that can be moved forward."""

    def __init__(self, epoch: int) -> None:
        self.now_us = 0
        self._epoch = epoch

    @property
    def time(self) -> int:
        return self._epoch + self.now_us // UNIT_US

    def forward(self, units: int) -> None:
        if units > 0:
            self._epoch += units


def _digest(secret: bytes, signed: bytes) -> bytes:
    return hashlib.sha256(secret + signed).digest()[:_DIGEST_BYTES]
