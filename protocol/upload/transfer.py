"""What both ends of an upload share: chunks, tags, bitmaps, verdicts, and the table of a state machine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Generic, NamedTuple, TypeVar

from trimtab.protocol.messages import UploadResult

CHUNK_BYTES = 99
"""Bytes of a blob in one UPLOAD_CHUNK, which then fills a radio frame."""
CHUNKS_MAX = 0xFFFF
SIZE_MAX = CHUNK_BYTES * CHUNKS_MAX
BITMAP_BYTES = 64
MESSAGE_BYTES = 64

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)
T = TypeVar("T")


class UploadEvent(IntEnum):
    """What an upload told its owner."""

    BEGAN = 0
    ACCEPTED = 1
    REFUSED = 2
    CORRUPT = 3
    COMMITTED = 4
    DISCARDED = 5
    FAILED = 6


@dataclass(frozen=True, kw_only=True)
class ReceiverEvent:
    """One event, the blob it is about (12 hex digits of its SHA-256, its kind) and a line for people."""

    event: UploadEvent
    kind: int
    id: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the on-board check found.

    Fields:
        node: number of the node concerned, None for none.
        reason: code of the reason, 0 where accepted.
        value, bound: the quantity out of bounds and its bound, 0 where there is none.
        message: at most 64 bytes of UTF-8 travel.
    """

    ok: bool
    node: int | None = None
    reason: int = 0
    value: float = 0.0
    bound: float = 0.0
    message: str = ""

    def __post_init__(self) -> None:
        if self.node is not None and not 0 <= self.node < 0xFFFF:
            raise ValueError(f"node must be 0..65534, not {self.node}")
        if not 0 <= self.reason <= 255:
            raise ValueError(f"reason must be 0..255, not {self.reason}")


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Whether a staged blob takes over at a tick: OK, or the result to answer and why."""

    result: UploadResult = UploadResult.OK
    verdict: Verdict | None = None


class Table(Generic[S, E, T]):
    """What happens on which event in which state. Complete: built only where every pair has an entry."""

    def __init__(self, states: Iterable[S], events: Iterable[E], rows: Mapping[S, Mapping[E, T]]) -> None:
        events = list(events)
        for state in states:
            missing = [event.name for event in events if event not in rows.get(state, {})]
            if missing:
                raise ValueError(f"{state.name} says nothing about {', '.join(missing)}")
        self.rows = rows

    def __call__(self, state: S, event: E) -> T:
        """Return the entry."""
        return self.rows[state][event]


class Incoming(NamedTuple):
    """A blob that is gathered: kind, size, SHA-256, and one byte for each chunk, 1 where it is here."""

    kind: int
    size: int
    digest: bytes
    held: bytearray


def chunk_count(size: int) -> int:
    """Return number of chunks of a blob of `size` bytes."""
    return -(-size // CHUNK_BYTES)


def tag_of(digest: bytes) -> int:
    """Return the number by which chunks and answers name the blob."""
    return digest[0] | digest[1] << 8


def encode_bitmap(held: bytearray, base: int) -> bytes:
    """UPLOAD_STATUS.bitmap for chunks from `base` on; `held` has one byte a chunk, 1 where it is held."""
    window = held[base : base + 8 * BITMAP_BYTES]
    bits = sum(1 << i for i, have in enumerate(window) if have)
    return bits.to_bytes(BITMAP_BYTES, "little")


def decode_bitmap(bitmap: bytes, base: int) -> list[int]:
    """Numbers of the chunks that the bitmap says are held."""
    bits = int.from_bytes(bitmap, "little")
    found = []
    while bits:
        low = bits & -bits
        found.append(base + low.bit_length() - 1)
        bits ^= low
    return found


def encode_text(text: str) -> bytes:
    """`text` as UTF-8, cut at a character's end to what a message holds."""
    return text.encode()[:MESSAGE_BYTES].decode(errors="ignore").encode()
