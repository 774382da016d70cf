"""Blobs that a vehicle receives: references and feed-forwards. Standard library only.

The format is little-endian without padding. The length must match exactly. Both kinds start with a header of
46 B:

    magic "TRTB", kind u8, version u8, flags u16, vehicle id 6 B, origin 3 x float64, count u32, count u32

A reference continues with its nodes and its yaw nodes. The first count is the number of nodes, the second the
number of yaw nodes. A node has 52 B: t_us u32 and p, v, a, j (3 float32 each, NED, p relative to the origin).
A yaw node has 12 B: t_us u32, yaw and yaw rate (float32).

`trimtab.protocol.feedforward_blob` describes what follows in a feed-forward.

The id of a blob is the first 12 hex digits of the SHA-256 of its bytes. Objects round their values to float32
when they are built, so the host holds exactly what the vehicle flies.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from trimtab.protocol.blob_fields import (
    HEADER_BYTES,
    VERSION,
    BlobError,
    Kind,
    blob_id,
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
from trimtab.protocol.feedforward_blob import (
    BLOCK_FIELDS,
    BLOCK_SIZE,
    HIDDEN_MAX,
    NEUTRAL_BLOCK,
    WIDTH_MAX,
    FeedForward,
    TrainedRegion,
)

__all__ = [
    "BLOB_BYTES_MAX",
    "BLOCK_FIELDS",
    "BLOCK_SIZE",
    "HIDDEN_MAX",
    "NEUTRAL_BLOCK",
    "NODE_BYTES",
    "WIDTH_MAX",
    "YAW_BYTES",
    "Blob",
    "BlobError",
    "FeedForward",
    "Kind",
    "Node",
    "Reference",
    "TrainedRegion",
    "YawNode",
    "blob_id",
    "from_bytes",
    "least_bytes",
]

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


Blob = Reference | FeedForward


def least_bytes(head: bytes) -> int:
    """Return the least length in bytes of a blob that begins with `head`, by the counts in its header.

    It is the exact length of a reference. Raises BlobError if the header is incomplete or invalid.
    """
    kind = kind_of(head)
    header = unpack_header(head, kind, versions=range(256))
    sizes = (NODE_BYTES, YAW_BYTES) if kind is Kind.REFERENCE else (4, 4)
    return HEADER_BYTES + header.first * sizes[0] + header.second * sizes[1]


def from_bytes(data: bytes) -> Blob:
    """Return the blob in `data`, of the kind that its header states. Raises BlobError if it is invalid."""
    return FeedForward.from_bytes(data) if kind_of(data) is Kind.FEEDFORWARD else Reference.from_bytes(data)
