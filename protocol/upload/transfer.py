"""Types shared by both ends of an upload: chunks, tags, bitmaps, verdicts, and transition tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Generic, NamedTuple, TypeVar

from trimtab.protocol.messages import UploadResult
from trimtab.protocol.stream import SIGNATURE_BYTES

CHUNK_BYTES = 99
"""Bytes of a blob in one UPLOAD_CHUNK: the message then fills a radio frame."""
SIGNED_CHUNK_BYTES = CHUNK_BYTES - SIGNATURE_BYTES
"""Bytes of a blob in one signed UPLOAD_CHUNK, likewise. The rest of its field is zero and is not sent."""
CHUNK_SIZES = (CHUNK_BYTES, SIGNED_CHUNK_BYTES)
"""Sizes of chunks that the vehicle accepts. The host chooses."""
CHUNKS_MAX = 0xFFFF
SIZE_MAX = SIGNED_CHUNK_BYTES * CHUNKS_MAX
BITMAP_BYTES = 64
MESSAGE_BYTES = 64

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)
T = TypeVar("T")


class UploadEvent(IntEnum):
    """Events of an upload that its owner receives."""

    BEGAN = 0
    ACCEPTED = 1
    REFUSED = 2
    CORRUPT = 3
    COMMITTED = 4
    DISCARDED = 5
    FAILED = 6


@dataclass(frozen=True, kw_only=True)
class ReceiverEvent:
    """An event with kind and id of its blob (12 hex digits of the SHA-256) and a text for people."""

    event: UploadEvent
    kind: int
    id: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Verdict of the on-board check.

    Fields:
        node: index of the node concerned, or None.
        reason: code of the reason; 0 if accepted.
        value, bound: the value out of bounds and its bound; 0 without one.
        message: text for people; only its first 64 bytes of UTF-8 are sent.
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
class SwapAnswer:
    """Answer to a swap request: OK, or the result of the refusal with a verdict."""

    result: UploadResult = UploadResult.OK
    verdict: Verdict | None = None


class Table(Generic[S, E, T]):
    """Transition table. Raises ValueError unless every pair of state and event has an entry."""

    def __init__(self, states: Iterable[S], events: Iterable[E], rows: Mapping[S, Mapping[E, T]]) -> None:
        events = list(events)
        for state in states:
            missing = [event.name for event in events if event not in rows.get(state, {})]
            if missing:
                raise ValueError(f"{state.name} has no entry for {', '.join(missing)}")
        self.rows = rows

    def __call__(self, state: S, event: E) -> T:
        """Return the entry."""
        return self.rows[state][event]


class Incoming(NamedTuple):
    """A blob being received: kind, size, SHA-256, size of its chunks, and for each chunk 1 if it is held."""

    kind: int
    size: int
    digest: bytes
    chunk_bytes: int
    held: bytearray


def chunk_count(size: int, chunk_bytes: int = CHUNK_BYTES) -> int:
    """Return the number of chunks of a blob of `size` bytes."""
    return -(-size // chunk_bytes)


def tag_of(digest: bytes) -> int:
    """Return the tag that identifies the blob in chunks and answers."""
    return digest[0] | digest[1] << 8


def encode_bitmap(held: bytearray, base: int) -> bytes:
    """Return UPLOAD_STATUS.bitmap for the chunks from `base` on. held: one byte for each chunk, 1 if held."""
    window = held[base : base + 8 * BITMAP_BYTES]
    bits = sum(1 << i for i, is_held in enumerate(window) if is_held)
    return bits.to_bytes(BITMAP_BYTES, "little")


def decode_bitmap(bitmap: bytes, base: int) -> list[int]:
    """Return the indices of the chunks that are held according to the bitmap."""
    bits = int.from_bytes(bitmap, "little")
    indices = []
    while bits:
        low = bits & -bits
        indices.append(base + low.bit_length() - 1)
        bits ^= low
    return indices


def encode_text(text: str) -> bytes:
    """Return `text` as UTF-8, truncated after a whole character to at most MESSAGE_BYTES."""
    return text.encode()[:MESSAGE_BYTES].decode(errors="ignore").encode()
