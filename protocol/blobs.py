"""Blobs that are uploaded: a reference to fly and a feed-forward block. Standard library only.

Little-endian, no padding, exact length. Both begin with a header of 46 B:

    magic "TRTB", kind u8, version u8, flags u16, vehicle id 6 B, origin 3 x float64, count u32, count u32

A reference goes on with as many nodes as the first count says, t_us u32 and p, v, a, j (3 float32 each, NED,
p relative to the origin; 52 B), then as many yaw rows as the second says, t_us u32, yaw, yaw rate (float32;
12 B). A feed-forward goes on with the model id (6 B), the number of hidden layers u8, their widths (u8 each),
then float32 numbers: the first count's of form (a), the second's of form (b). Its flags say which it has.

The id of a blob is the first 12 hex digits of the SHA-256 of its bytes. What travels as float32 is rounded
when an object is built, so that what the host holds is what flies.
"""

from __future__ import annotations

import hashlib
import math
import operator
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import ClassVar, NamedTuple

MAGIC = b"TRTB"
VERSION = 1
T_US_MAX = 0xFFFF_FFFF
BLOB_BYTES_MAX = 256 * 1024
"""Longest blob that a vehicle keeps: 5040 nodes of a reference without yaw rows."""


class Kind(IntEnum):
    """Kind of a blob; the value is the header's, and TRIMTAB_BLOB's on the wire."""

    REFERENCE = 1
    FEEDFORWARD = 2


class BlobError(ValueError):
    """Report bytes or values that make no blob; the message names the field."""


class Node(NamedTuple):
    """A node of a reference: time and the 12 numbers p, v, a, j, NED."""

    t_us: int
    state: tuple[float, ...]


class YawNode(NamedTuple):
    """A node of the yaw profile: cubic Hermite pieces between nodes, held outside them."""

    t_us: int
    yaw: float
    yaw_rate: float


_HEADER = struct.Struct("<4sBBH6s3dII")
_ORIGIN = slice(14, 38)
"""Bytes of the header."""
_NODE = struct.Struct("<I12f")
_YAW = struct.Struct("<I2f")
_NODE_FIELDS = tuple(f"{name}_{axis}" for name in "pvaj" for axis in "ned")

HEADER_BYTES = _HEADER.size
NODE_BYTES = _NODE.size
YAW_BYTES = _YAW.size

BLOCK_FIELDS: tuple[tuple[str, int], ...] = (
    ("gain", 1),
    ("bias_ned", 3),
    ("linear_drag", 3),
    ("quadratic_drag", 3),
    ("attitude_offset", 2),
    ("prediction_time_s", 1),
)
"""Form (a): names and sizes in order."""

BLOCK_SIZE = sum(size for _, size in BLOCK_FIELDS)
NEUTRAL_BLOCK: tuple[float, ...] = (1.0, *(0.0 for _ in range(BLOCK_SIZE - 1)))
"""The block that changes nothing."""

NETWORK_INPUTS = 6
NETWORK_OUTPUTS = 3
HIDDEN_MAX = 3
WIDTH_MAX = 32


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A trajectory as nodes of position, velocity, acceleration and jerk: a C3 spline of degree 7.

    Fields:
        vehicle_id: 12 hex digits, the id of the vehicle it was planned for.
        origin_ned: m; positions of the nodes are relative to it.
        nodes: at least two, the first at t_us 0, times strictly increasing.
        yaws: none means yaw 0 throughout; times strictly increasing.
        free_ends: it need not start and end at rest; the vehicle does not start one whose ends move.

    Raises BlobError naming the field.
    """

    KIND: ClassVar[Kind] = Kind.REFERENCE
    _FREE_ENDS: ClassVar[int] = 1

    vehicle_id: str
    origin_ned: tuple[float, float, float]
    nodes: tuple[Node, ...]
    yaws: tuple[YawNode, ...] = ()
    free_ends: bool = False

    def __post_init__(self) -> None:
        _check_id("vehicle_id", self.vehicle_id)
        object.__setattr__(self, "origin_ned", _floats("origin_ned", self.origin_ned, 3))
        nodes = tuple(
            Node(_time(f"nodes[{i}].t_us", t), _singles(f"nodes[{i}]", state, _NODE_FIELDS))
            for i, (t, state) in enumerate(self.nodes)
        )
        yaws = tuple(
            YawNode(_time(f"yaws[{i}].t_us", t), *_singles(f"yaws[{i}]", (yaw, rate), ("yaw", "yaw_rate")))
            for i, (t, yaw, rate) in enumerate(self.yaws)
        )
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "yaws", yaws)
        if len(nodes) < 2:
            raise BlobError(f"nodes: a reference needs at least 2, not {len(nodes)}")
        if nodes[0].t_us != 0:
            raise BlobError(f"nodes[0].t_us: must be 0, not {nodes[0].t_us}")
        _check_increasing("nodes", [node.t_us for node in nodes])
        _check_increasing("yaws", [yaw.t_us for yaw in yaws])

    def to_bytes(self) -> bytes:
        """Return the blob: `HEADER_BYTES + 52 nodes + 12 yaws` bytes."""
        flags = self._FREE_ENDS if self.free_ends else 0
        counts = (len(self.nodes), len(self.yaws))
        head = _pack_header(self.KIND, flags, self.vehicle_id, self.origin_ned, counts)
        rows = [_NODE.pack(node.t_us, *node.state) for node in self.nodes]
        rows += [_YAW.pack(*yaw) for yaw in self.yaws]
        return head + b"".join(rows)

    @classmethod
    def from_bytes(cls, data: bytes) -> Reference:
        """Return the reference in `data`.

        Raises BlobError, and nothing else, naming the field that is wrong.
        """
        head = _unpack_header(data, cls.KIND)
        if head.flags & ~cls._FREE_ENDS:
            raise BlobError(f"flags: {head.flags:#06x} has bits unknown to version {VERSION}")
        _check_length(data, HEADER_BYTES + head.first * NODE_BYTES + head.second * YAW_BYTES)
        yaws_at = HEADER_BYTES + head.first * NODE_BYTES
        return cls(
            vehicle_id=head.vehicle_id,
            origin_ned=head.origin,
            nodes=tuple(Node(row[0], row[1:]) for row in _NODE.iter_unpack(data[HEADER_BYTES:yaws_at])),
            yaws=tuple(YawNode(*row) for row in _YAW.iter_unpack(data[yaws_at:])),
            free_ends=bool(head.flags & cls._FREE_ENDS),
        )

    @property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256 of the bytes."""
        return blob_id(self.to_bytes())

    @property
    def duration_us(self) -> int:
        """Time of the last node."""
        return self.nodes[-1].t_us

    def nodes_ned(self) -> tuple[Node, ...]:
        """Return the nodes with the origin added to their positions, in double."""
        n, e, d = self.origin_ned
        return tuple(
            Node(t, (state[0] + n, state[1] + e, state[2] + d, *state[3:])) for t, state in self.nodes
        )

    def yaw_nodes(self) -> tuple[YawNode, ...]:
        """Return the yaw nodes, at least one: yaw 0 where the blob has none."""
        return self.yaws or (YawNode(0, 0.0, 0.0),)


@dataclass(frozen=True, kw_only=True)
class FeedForward:
    """What the law adds: form (a), a block of numbers, form (b), a network, or both; at least one.

    Fields:
        vehicle_id, model_id: 12 hex digits each.
        block: BLOCK_SIZE numbers in the order of BLOCK_FIELDS, or None.
        layers: widths of the network's hidden layers, at most 3 of at most 32; empty for no network.
        weights: layer by layer, the output last; for every neuron its inputs' weights, then its bias.

    Raises BlobError naming the field.
    """

    KIND: ClassVar[Kind] = Kind.FEEDFORWARD
    _BLOCK: ClassVar[int] = 1
    _NETWORK: ClassVar[int] = 2

    vehicle_id: str
    model_id: str
    block: tuple[float, ...] | None = None
    layers: tuple[int, ...] = ()
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _check_id("vehicle_id", self.vehicle_id)
        _check_id("model_id", self.model_id)
        object.__setattr__(self, "layers", tuple(self.layers))
        if self.block is not None:
            object.__setattr__(self, "block", _singles("block", self.block, _block_names()))
            gain, prediction_time_s = self.block[0], self.block[-1]
            if not gain > 0.0:
                raise BlobError(f"block.gain: must be positive, not {gain:g}")
            if not prediction_time_s >= 0.0:
                raise BlobError(f"block.prediction_time_s: must not be negative, not {prediction_time_s:g}")
        elif not self.layers:
            raise BlobError("block: a feed-forward needs a block, a network or both")
        expected = _weight_count(self.layers)
        if len(self.weights) != expected:
            raise BlobError(f"weights: layers {list(self.layers)} need {expected}, not {len(self.weights)}")
        names = tuple(map(str, range(expected)))
        object.__setattr__(self, "weights", _singles("weights", self.weights, names))

    def to_bytes(self) -> bytes:
        """Return the blob."""
        block = self.block or ()
        flags = (self._BLOCK if block else 0) | (self._NETWORK if self.layers else 0)
        counts = (len(block), len(self.weights))
        head = _pack_header(self.KIND, flags, self.vehicle_id, (0.0, 0.0, 0.0), counts)
        sizes = bytes([len(self.layers), *self.layers])
        numbers = struct.pack(f"<{len(block) + len(self.weights)}f", *block, *self.weights)
        return head + bytes.fromhex(self.model_id) + sizes + numbers

    @classmethod
    def from_bytes(cls, data: bytes) -> FeedForward:
        """Return the feed-forward in `data`.

        Raises BlobError, and nothing else, naming the field that is wrong.
        """
        head = _unpack_header(data, cls.KIND)
        if head.flags & ~(cls._BLOCK | cls._NETWORK):
            raise BlobError(f"flags: {head.flags:#06x} has bits unknown to version {VERSION}")
        if any(data[_ORIGIN]):  # -0.0 would be another blob of the same content
            raise BlobError("origin: must be 0 in a feed-forward")
        sizes_at = HEADER_BYTES + 6
        if len(data) <= sizes_at:
            raise BlobError(f"length: {len(data)} bytes end before the layers")
        numbers_at = sizes_at + 1 + data[sizes_at]
        _check_length(data, numbers_at + 4 * (head.first + head.second))
        layers = tuple(data[sizes_at + 1 : numbers_at])
        for bit, count, name in ((cls._BLOCK, head.first, "block"), (cls._NETWORK, len(layers), "layers")):
            if bool(head.flags & bit) != bool(count):
                raise BlobError(f"flags: {head.flags:#06x} does not go with {count} {name}")
        numbers = struct.unpack(f"<{head.first + head.second}f", data[numbers_at:])
        return cls(
            vehicle_id=head.vehicle_id,
            model_id=data[HEADER_BYTES:sizes_at].hex(),
            block=numbers[: head.first] if head.first else None,
            layers=layers,
            weights=numbers[head.first :],
        )

    @property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256 of the bytes."""
        return blob_id(self.to_bytes())


Blob = Reference | FeedForward


def from_bytes(data: bytes) -> Blob:
    """Return the blob in `data`, of whichever kind its header says. Raises BlobError."""
    return FeedForward.from_bytes(data) if kind_of(data) is Kind.FEEDFORWARD else Reference.from_bytes(data)


def kind_of(data: bytes) -> Kind:
    """Return the kind that the header states. Raises BlobError where there is no such header."""
    if data[:4] != MAGIC:
        raise BlobError(f"magic: {bytes(data[:4])!r} is not {MAGIC!r}")
    if len(data) < 5 or data[4] not in tuple(Kind):
        raise BlobError(
            f"kind: {data[4] if len(data) > 4 else 'missing'} is not one of {list(map(int, Kind))}"
        )
    return Kind(data[4])


def blob_id(data: bytes) -> str:
    """First 12 hex digits of the SHA-256 of `data`."""
    return hashlib.sha256(data).hexdigest()[:12]


class _Head(NamedTuple):
    flags: int
    vehicle_id: str
    origin: tuple[float, float, float]
    first: int
    second: int


def _pack_header(
    kind: Kind, flags: int, vehicle_id: str, origin: tuple[float, float, float], counts: tuple[int, int]
) -> bytes:
    return _HEADER.pack(MAGIC, kind, VERSION, flags, bytes.fromhex(vehicle_id), *origin, *counts)


def _unpack_header(data: bytes, kind: Kind) -> _Head:
    found = kind_of(data)
    if found is not kind:
        raise BlobError(f"kind: {found} ({found.name.lower()}) is not {int(kind)} ({kind.name.lower()})")
    if len(data) < HEADER_BYTES:
        raise BlobError(f"length: {len(data)} bytes are less than a header of {HEADER_BYTES}")
    _, _, version, flags, vehicle, n, e, d, first, second = _HEADER.unpack_from(data)
    if version != VERSION:
        raise BlobError(f"version: {version} is not {VERSION}")
    return _Head(flags, vehicle.hex(), (n, e, d), first, second)


def _check_length(data: bytes, expected: int) -> None:
    if len(data) != expected:
        raise BlobError(f"length: {len(data)} bytes where the header makes it {expected}")


def _check_id(name: str, value: str) -> None:
    if not isinstance(value, str) or len(value) != 12 or any(c not in "0123456789abcdef" for c in value):
        raise BlobError(f"{name}: {value!r} is not 12 lower-case hex digits")


def _time(name: str, value: int) -> int:
    try:
        t_us = operator.index(value)
    except TypeError:
        t_us = -1
    if not 0 <= t_us <= T_US_MAX:
        raise BlobError(f"{name}: {value!r} is not a whole number of 0..{T_US_MAX} us")
    return t_us


def _check_increasing(name: str, times: Sequence[int]) -> None:
    for i in range(1, len(times)):
        if times[i] <= times[i - 1]:
            raise BlobError(f"{name}[{i}].t_us: {times[i]} does not come after {times[i - 1]}")


def _floats(name: str, values: Iterable[float], size: int) -> tuple[float, ...]:
    """Return the values as finite floats.

    Raises BlobError with their number or the one that is not finite.
    """
    floats = tuple(map(float, values))
    if len(floats) != size:
        raise BlobError(f"{name}: has {len(floats)} numbers, not {size}")
    for i, value in enumerate(floats):
        if not math.isfinite(value):
            raise BlobError(f"{name}[{i}]: {value} is not finite")
    return floats


def _singles(name: str, values: Iterable[float], names: Sequence[str]) -> tuple[float, ...]:
    """Return the values rounded to float32. Raises BlobError naming the one that has no finite float32."""
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


_FLOAT32_MAX = 3.4028235e38


def _block_names() -> tuple[str, ...]:
    return tuple(name if size == 1 else f"{name}[{i}]" for name, size in BLOCK_FIELDS for i in range(size))


def _weight_count(layers: tuple[int, ...]) -> int:
    """Return number of weights of a network with these hidden widths, 0 for none. Raises BlobError."""
    if not layers:
        return 0
    if len(layers) > HIDDEN_MAX or not all(isinstance(n, int) and 1 <= n <= WIDTH_MAX for n in layers):
        raise BlobError(f"layers: {list(layers)} must be 1 to {HIDDEN_MAX} widths of 1 to {WIDTH_MAX}")
    sizes = (NETWORK_INPUTS, *layers, NETWORK_OUTPUTS)
    return sum((inputs + 1) * outputs for inputs, outputs in pairwise(sizes))
