"""Header and fields of blobs: packing, unpacking and checks. Standard library only."""

from __future__ import annotations

import hashlib
import math
import operator
import struct
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import NamedTuple

MAGIC = b"TRTB"
VERSION = 1
"""Version of references, and first version of feed-forwards."""
T_US_MAX = 0xFFFF_FFFF
_HEADER = struct.Struct("<4sBBH6s3dII")
HEADER_BYTES = _HEADER.size
ORIGIN_BYTES = slice(14, 38)
"""Bytes of the header that hold the origin."""
_FLOAT32_MAX = 3.4028235e38


class Kind(IntEnum):
    """Kind of a blob. The header and TRIMTAB_BLOB on the wire use the same values."""

    REFERENCE = 1
    FEEDFORWARD = 2


class BlobError(ValueError):
    """Invalid bytes or values of a blob. The message names the field."""


class Header(NamedTuple):
    """Header of a blob without magic and kind. first, second: the two counts."""

    version: int
    flags: int
    vehicle_id: str
    origin: tuple[float, float, float]
    first: int
    second: int


def pack_header(
    kind: Kind,
    flags: int,
    vehicle_id: str,
    origin: tuple[float, float, float],
    counts: tuple[int, int],
    *,
    version: int = VERSION,
) -> bytes:
    """Return the header's bytes."""
    return _HEADER.pack(MAGIC, kind, version, flags, bytes.fromhex(vehicle_id), *origin, *counts)


def unpack_header(data: bytes, kind: Kind, *, versions: Sequence[int] = (VERSION,)) -> Header:
    """Return the header of a blob of this kind and of one of these versions. Raises BlobError if invalid."""
    stated = kind_of(data)
    if stated is not kind:
        raise BlobError(f"kind: {stated} ({stated.name.lower()}) is not {int(kind)} ({kind.name.lower()})")
    if len(data) < HEADER_BYTES:
        raise BlobError(f"length: {len(data)} bytes are shorter than a header of {HEADER_BYTES}")
    _, _, version, flags, vehicle, n, e, d, first, second = _HEADER.unpack_from(data)
    if version not in versions:
        raise BlobError(f"version: {version} is not {' or '.join(map(str, versions))}")
    return Header(version, flags, vehicle.hex(), (n, e, d), first, second)


def blob_id(data: bytes) -> str:
    """Return the first 12 hex digits of the SHA-256 of `data`."""
    return hashlib.sha256(data).hexdigest()[:12]


def check_length(data: bytes, expected: int) -> None:
    """Raise BlobError unless `data` has the expected length."""
    if len(data) != expected:
        raise BlobError(f"length: {len(data)} bytes where the header makes it {expected}")


def check_id(name: str, value: str) -> None:
    """Raise BlobError unless `value` is an id of 12 lower-case hex digits."""
    if not isinstance(value, str) or len(value) != 12 or any(c not in "0123456789abcdef" for c in value):
        raise BlobError(f"{name}: {value!r} is not 12 lower-case hex digits")


def whole_time(name: str, value: int) -> int:
    """Return a time in us as an int. Raises BlobError unless it is a whole number in range."""
    try:
        t_us = operator.index(value)
    except TypeError:
        t_us = -1
    if not 0 <= t_us <= T_US_MAX:
        raise BlobError(f"{name}: {value!r} is not a whole number of 0..{T_US_MAX} us")
    return t_us


def check_increasing(name: str, times: Sequence[int]) -> None:
    """Raise BlobError unless the times are strictly increasing."""
    for i in range(1, len(times)):
        if times[i] <= times[i - 1]:
            raise BlobError(f"{name}[{i}].t_us: {times[i]} does not come after {times[i - 1]}")


def finite_floats(name: str, values: Iterable[float], size: int) -> tuple[float, ...]:
    """Return `size` finite floats. Raises BlobError for another count or a value that is not finite."""
    floats = tuple(map(float, values))
    if len(floats) != size:
        raise BlobError(f"{name}: has {len(floats)} numbers, not {size}")
    for i, value in enumerate(floats):
        if not math.isfinite(value):
            raise BlobError(f"{name}[{i}]: {value} is not finite")
    return floats


def float32s(name: str, values: Iterable[float], names: Sequence[str]) -> tuple[float, ...]:
    """Return the values rounded to float32. Raises BlobError that names a value beyond float32."""
    floats = tuple(map(float, values))
    if len(floats) != len(names):
        raise BlobError(f"{name}: has {len(floats)} numbers, not {len(names)}")
    form = f"<{len(floats)}f"
    try:
        rounded = struct.unpack(form, struct.pack(form, *floats))
    except OverflowError:
        rounded = ()
    if len(rounded) != len(floats) or not math.isfinite(sum(rounded)):
        for field, value in zip(names, floats, strict=True):
            if not abs(value) <= _FLOAT32_MAX:
                raise BlobError(f"{name}.{field}: {value} is not finite in float32")
    return rounded


def kind_of(data: bytes) -> Kind:
    """Return the kind that the header states. Raises BlobError if the header is invalid."""
    if data[:4] != MAGIC:
        raise BlobError(f"magic: {bytes(data[:4])!r} is not {MAGIC!r}")
    if len(data) < 5 or data[4] not in tuple(Kind):
        raise BlobError(
            f"kind: {data[4] if len(data) > 4 else 'missing'} is not one of {list(map(int, Kind))}"
        )
    return Kind(data[4])
