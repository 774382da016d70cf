"""Blobs that a vehicle receives: references and feed-forwards. Standard library only.

The format is little-endian without padding. The length must match exactly. Both kinds start with a header of
46 B:

    magic "TRTB", kind u8, version u8, flags u16, vehicle id 6 B, origin 3 x float64, count u32, count u32

A reference continues with its nodes and its yaw nodes. The first count is the number of nodes, the second the
number of yaw nodes. A node has 52 B: t_us u32 and p, v, a, j (3 float32 each, NED, p relative to the origin).
A yaw node has 12 B: t_us u32, yaw and yaw rate (float32).

A feed-forward continues with the model id (6 B), the number of hidden layers u8 and their widths (u8 each).
float32 numbers follow: the first count is the number of values of form (a), a block of coefficients; the
second, of form (b), a network. The flags name the forms.

The id of a blob is the first 12 hex digits of the SHA-256 of its bytes. Objects round their values to float32
when they are built, so the host holds exactly what the vehicle flies.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, NamedTuple

from trimtab.protocol.blob_fields import (
    HEADER_BYTES,
    ORIGIN_BYTES,
    VERSION,
    BlobError,
    Kind,
    check_id,
    check_increasing,
    check_length,
    finite_floats,
    float32s,
    kind_of,
    pack_header,
    unpack_header,
    whole_time,
)

BLOB_BYTES_MAX = 256 * 1024
"""Longest blob that a vehicle stores: a reference of 5040 nodes without yaw nodes."""


class Node(NamedTuple):
    """A node of a reference: time and the 12 numbers p, v, a, j in NED."""

    t_us: int
    state: tuple[float, ...]


class YawNode(NamedTuple):
    """A node of the yaw profile. Yaw is a cubic Hermite spline between nodes and constant outside them."""

    t_us: int
    yaw: float
    yaw_rate: float


_NODE = struct.Struct("<I12f")
_YAW = struct.Struct("<I2f")
_NODE_FIELDS = tuple(f"{name}_{axis}" for name in "pvaj" for axis in "ned")

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
"""Names and sizes of the fields of form (a), in order."""

BLOCK_SIZE = sum(size for _, size in BLOCK_FIELDS)
NEUTRAL_BLOCK: tuple[float, ...] = (1.0, *(0.0 for _ in range(BLOCK_SIZE - 1)))
"""Block of form (a) that has no effect."""

NETWORK_INPUTS = 6
NETWORK_OUTPUTS = 3
HIDDEN_MAX = 3
WIDTH_MAX = 32


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A trajectory as nodes of position, velocity, acceleration and jerk: a C3 spline of degree 7.

    Fields:
        vehicle_id: id of the vehicle that the reference was planned for, 12 hex digits.
        origin_ned: m; positions of the nodes are relative to it.
        nodes: at least two; the first is at t_us 0; times are strictly increasing.
        yaws: times are strictly increasing; an empty tuple stands for yaw 0 throughout.
        free_ends: whether the reference may start and end in motion. A flight cannot start with a reference
            whose ends move.

    Raises BlobError that names the invalid field.
    """

    KIND: ClassVar[Kind] = Kind.REFERENCE
    _FREE_ENDS: ClassVar[int] = 1

    vehicle_id: str
    origin_ned: tuple[float, float, float]
    nodes: tuple[Node, ...]
    yaws: tuple[YawNode, ...] = ()
    free_ends: bool = False

    def __post_init__(self) -> None:
        check_id("vehicle_id", self.vehicle_id)
        object.__setattr__(self, "origin_ned", finite_floats("origin_ned", self.origin_ned, 3))
        nodes = tuple(
            Node(whole_time(f"nodes[{i}].t_us", t), float32s(f"nodes[{i}]", state, _NODE_FIELDS))
            for i, (t, state) in enumerate(self.nodes)
        )
        yaws = tuple(
            YawNode(
                whole_time(f"yaws[{i}].t_us", t), *float32s(f"yaws[{i}]", (yaw, rate), ("yaw", "yaw_rate"))
            )
            for i, (t, yaw, rate) in enumerate(self.yaws)
        )
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "yaws", yaws)
        if len(nodes) < 2:
            raise BlobError(f"nodes: a reference needs at least 2, not {len(nodes)}")
        if nodes[0].t_us != 0:
            raise BlobError(f"nodes[0].t_us: must be 0, not {nodes[0].t_us}")
        check_increasing("nodes", [node.t_us for node in nodes])
        check_increasing("yaws", [yaw.t_us for yaw in yaws])

    def to_bytes(self) -> bytes:
        """Return the blob: `HEADER_BYTES + 52 len(nodes) + 12 len(yaws)` bytes."""
        flags = self._FREE_ENDS if self.free_ends else 0
        counts = (len(self.nodes), len(self.yaws))
        head = pack_header(self.KIND, flags, self.vehicle_id, self.origin_ned, counts)
        rows = [_NODE.pack(node.t_us, *node.state) for node in self.nodes]
        rows += [_YAW.pack(*yaw) for yaw in self.yaws]
        return head + b"".join(rows)

    @classmethod
    def from_bytes(cls, data: bytes) -> Reference:
        """Return the reference in `data`.

        Raises BlobError that names the invalid field, and no other exception.
        """
        head = unpack_header(data, cls.KIND)
        if head.flags & ~cls._FREE_ENDS:
            raise BlobError(f"flags: {head.flags:#06x} has bits unknown to version {VERSION}")
        check_length(data, HEADER_BYTES + head.first * NODE_BYTES + head.second * YAW_BYTES)
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
        """First 12 hex digits of the SHA-256 of the blob's bytes."""
        return blob_id(self.to_bytes())

    @property
    def duration_us(self) -> int:
        """Time of the last node in us."""
        return self.nodes[-1].t_us

    def nodes_ned(self) -> tuple[Node, ...]:
        """Return the nodes with the origin added to their positions, in double precision."""
        n, e, d = self.origin_ned
        return tuple(
            Node(t, (state[0] + n, state[1] + e, state[2] + d, *state[3:])) for t, state in self.nodes
        )

    def yaw_nodes(self) -> tuple[YawNode, ...]:
        """Return the yaw nodes, or a single node of yaw 0 if the blob has none."""
        return self.yaws or (YawNode(0, 0.0, 0.0),)


@dataclass(frozen=True, kw_only=True)
class FeedForward:
    """A correction of the control law: form (a), a block of numbers; form (b), a network; or both.

    Fields:
        vehicle_id, model_id: 12 hex digits each.
        block: form (a), BLOCK_SIZE numbers in the order of BLOCK_FIELDS, or None.
        layers: form (b), widths of the hidden layers: at most 3 layers of at most 32 neurons; empty without a
            network.
        weights: weights by layer, the output layer last; for each neuron its input weights, then its bias.

    Raises BlobError that names the invalid field.
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
        check_id("vehicle_id", self.vehicle_id)
        check_id("model_id", self.model_id)
        object.__setattr__(self, "layers", tuple(self.layers))
        if self.block is not None:
            object.__setattr__(self, "block", float32s("block", self.block, _block_names()))
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
        object.__setattr__(self, "weights", float32s("weights", self.weights, names))

    def to_bytes(self) -> bytes:
        """Return the blob."""
        block = self.block or ()
        flags = (self._BLOCK if block else 0) | (self._NETWORK if self.layers else 0)
        counts = (len(block), len(self.weights))
        head = pack_header(self.KIND, flags, self.vehicle_id, (0.0, 0.0, 0.0), counts)
        sizes = bytes([len(self.layers), *self.layers])
        numbers = struct.pack(f"<{len(block) + len(self.weights)}f", *block, *self.weights)
        return head + bytes.fromhex(self.model_id) + sizes + numbers

    @classmethod
    def from_bytes(cls, data: bytes) -> FeedForward:
        """Return the feed-forward in `data`.

        Raises BlobError that names the invalid field, and no other exception.
        """
        head = unpack_header(data, cls.KIND)
        if head.flags & ~(cls._BLOCK | cls._NETWORK):
            raise BlobError(f"flags: {head.flags:#06x} has bits unknown to version {VERSION}")
        if any(data[ORIGIN_BYTES]):  # -0.0 is refused too: the same content would have two ids
            raise BlobError("origin: must be 0 in a feed-forward")
        sizes_at = HEADER_BYTES + 6
        if len(data) <= sizes_at:
            raise BlobError(f"length: {len(data)} bytes end before the layers")
        numbers_at = sizes_at + 1 + data[sizes_at]
        check_length(data, numbers_at + 4 * (head.first + head.second))
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
        """First 12 hex digits of the SHA-256 of the blob's bytes."""
        return blob_id(self.to_bytes())


Blob = Reference | FeedForward


def from_bytes(data: bytes) -> Blob:
    """Return the blob in `data`, of the kind that its header states. Raises BlobError if it is invalid."""
    return FeedForward.from_bytes(data) if kind_of(data) is Kind.FEEDFORWARD else Reference.from_bytes(data)


def blob_id(data: bytes) -> str:
    """Return the first 12 hex digits of the SHA-256 of `data`."""
    return hashlib.sha256(data).hexdigest()[:12]


def _block_names() -> tuple[str, ...]:
    return tuple(name if size == 1 else f"{name}[{i}]" for name, size in BLOCK_FIELDS for i in range(size))


def _weight_count(layers: tuple[int, ...]) -> int:
    """Return the number of weights of a network with these hidden widths. Raises BlobError if invalid."""
    if not layers:
        return 0
    if len(layers) > HIDDEN_MAX or not all(isinstance(n, int) and 1 <= n <= WIDTH_MAX for n in layers):
        raise BlobError(f"layers: {list(layers)} must be 1 to {HIDDEN_MAX} widths of 1 to {WIDTH_MAX}")
    sizes = (NETWORK_INPUTS, *layers, NETWORK_OUTPUTS)
    return sum((inputs + 1) * outputs for inputs, outputs in pairwise(sizes))
