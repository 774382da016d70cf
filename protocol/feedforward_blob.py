"""Blob of a feed-forward: a correction of the control law. Standard library only.

After the header (`trimtab.protocol.blobs`) come the model id (6 B), the number of hidden layers u8 and their
widths (u8 each). float32 numbers follow: the first count of the header is the number of values of form (a), a
block of coefficients; the second, of form (b), a network. Version 2 ends with the region, 4 float32, if its
flag is set. Flags: 1 block, 2 network, 4 network in the body frame, 8 region. Version 1 has the first 13
values of the block and the first two flags.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Literal, NamedTuple

from trimtab.protocol.blob_fields import (
    HEADER_BYTES,
    ORIGIN_BYTES,
    BlobError,
    Kind,
    blob_id,
    check_id,
    check_length,
    float32s,
    pack_header,
    unpack_header,
)

Frame = Literal["world", "body"]

BLOCK_FIELDS: tuple[tuple[str, int], ...] = (
    ("gain", 1),
    ("bias_ned", 3),
    ("linear_drag", 3),
    ("quadratic_drag", 3),
    ("attitude_offset", 2),
    ("prediction_time_s", 1),
    ("wind_ned", 3),
    ("voltage_exponent", 1),
)
"""Names and sizes of the fields of form (a), in order. The last two need version 2."""

BLOCK_SIZE = sum(size for _, size in BLOCK_FIELDS)
NEUTRAL_BLOCK: tuple[float, ...] = (1.0, *(0.0 for _ in range(BLOCK_SIZE - 1)))
"""Block of form (a) that has no effect."""
_BLOCK_SIZES = {1: 13, 2: BLOCK_SIZE}
_PREDICTION_TIME = 12

NETWORK_INPUTS: dict[Frame, int] = {"world": 6, "body": 3}
"""Inputs of form (b): velocity (NED) and Euler angles, or velocity (FRD)."""
NETWORK_OUTPUTS = 3
HIDDEN_MAX = 3
WIDTH_MAX = 32


class TrainedRegion(NamedTuple):
    """Region in which a model was trained. Beyond it the vehicle fades the residual acceleration out."""

    speed_max_m_s: float
    tilt_max_rad: float
    thrust_min_m_s2: float
    """Least and greatest thrust over mass."""
    thrust_max_m_s2: float


@dataclass(frozen=True, kw_only=True)
class FeedForward:
    """A correction of the control law: form (a), a block of numbers; form (b), a network; or both.

    Fields:
        vehicle_id, model_id: 12 hex digits each.
        block: form (a), BLOCK_SIZE numbers in the order of BLOCK_FIELDS, or None.
        layers: form (b), widths of the hidden layers: at most 3 layers of at most 32 neurons; empty without a
            network.
        weights: weights by layer, the output layer last; for each neuron its input weights, then its bias.
        frame: frame of the network's inputs and outputs.
        region: where the model was trained; None stands for everywhere.
        version: of the format. In version 1 the network is in the world frame, and the vehicle feeds only its
            acceleration forward, not its derivative.

    Raises BlobError that names the invalid field.
    """

    KIND: ClassVar[Kind] = Kind.FEEDFORWARD
    _BLOCK: ClassVar[int] = 1
    _NETWORK: ClassVar[int] = 2
    _BODY: ClassVar[int] = 4
    _REGION: ClassVar[int] = 8
    _FLAGS: ClassVar[dict[int, int]] = {1: 3, 2: 15}

    vehicle_id: str
    model_id: str
    block: tuple[float, ...] | None = None
    layers: tuple[int, ...] = ()
    weights: tuple[float, ...] = ()
    frame: Frame = "world"
    region: TrainedRegion | None = None
    version: int = 2

    def __post_init__(self) -> None:
        check_id("vehicle_id", self.vehicle_id)
        check_id("model_id", self.model_id)
        object.__setattr__(self, "layers", tuple(self.layers))
        if self.version not in _BLOCK_SIZES:
            raise BlobError(f"version: {self.version} is not 1 or 2")
        if self.block is not None:
            self._check_block(self.block)
        elif not self.layers:
            raise BlobError("block: a feed-forward needs a block, a network or both")
        if self.frame not in NETWORK_INPUTS:
            raise BlobError(f"frame: {self.frame!r} is not world or body")
        expected = _weight_count(self.layers, self.frame)
        if len(self.weights) != expected:
            raise BlobError(f"weights: layers {list(self.layers)} need {expected}, not {len(self.weights)}")
        names = tuple(map(str, range(expected)))
        object.__setattr__(self, "weights", float32s("weights", self.weights, names))
        if self.frame == "body" and not self.layers:
            raise BlobError("frame: body needs a network")
        if self.region is not None:
            self._check_region(self.region)
        if self.version == 1 and (self.frame == "body" or self.region is not None):
            raise BlobError("version: 1 has no body frame and no region; use version 2")

    def _check_block(self, block: tuple[float, ...]) -> None:
        numbers = float32s("block", block, _BLOCK_NAMES)
        object.__setattr__(self, "block", numbers)
        gain, prediction_time_s = numbers[0], numbers[_PREDICTION_TIME]
        if not gain > 0.0:
            raise BlobError(f"block.gain: must be positive, not {gain:g}")
        if not prediction_time_s >= 0.0:
            raise BlobError(f"block.prediction_time_s: must not be negative, not {prediction_time_s:g}")
        if any(numbers[_BLOCK_SIZES[self.version] :]):
            raise BlobError("version: 1 has no wind and no voltage exponent; use version 2")

    def _check_region(self, region: TrainedRegion) -> None:
        names = TrainedRegion._fields
        numbers = TrainedRegion(*float32s("region", region, names))
        object.__setattr__(self, "region", numbers)
        for name, number in zip(names, numbers, strict=True):
            if not number >= 0.0:
                raise BlobError(f"region.{name}: must not be negative, not {number:g}")
        if not numbers.tilt_max_rad <= math.pi:
            raise BlobError(f"region.tilt_max_rad: must be at most pi, not {numbers.tilt_max_rad:g}")
        if not numbers.thrust_min_m_s2 <= numbers.thrust_max_m_s2:
            raise BlobError(
                f"region.thrust_max_m_s2: must be at least {numbers.thrust_min_m_s2:g}, "
                f"not {numbers.thrust_max_m_s2:g}"
            )

    def to_bytes(self) -> bytes:
        """Return the blob."""
        block = (self.block or ())[: _BLOCK_SIZES[self.version]]
        flags = (
            (self._BLOCK if block else 0)
            | (self._NETWORK if self.layers else 0)
            | (self._BODY if self.frame == "body" else 0)
            | (self._REGION if self.region else 0)
        )
        counts = (len(block), len(self.weights))
        origin = (0.0, 0.0, 0.0)
        head = pack_header(self.KIND, flags, self.vehicle_id, origin, counts, version=self.version)
        sizes = bytes([len(self.layers), *self.layers])
        values = (*block, *self.weights, *(self.region or ()))
        return head + bytes.fromhex(self.model_id) + sizes + struct.pack(f"<{len(values)}f", *values)

    @classmethod
    def from_bytes(cls, data: bytes) -> FeedForward:
        """Return the feed-forward in `data`.

        Raises BlobError that names the invalid field, and no other exception.
        """
        head = unpack_header(data, cls.KIND, versions=tuple(_BLOCK_SIZES))
        if head.flags & ~cls._FLAGS[head.version]:
            raise BlobError(f"flags: {head.flags:#06x} has bits unknown to version {head.version}")
        if any(data[ORIGIN_BYTES]):  # -0.0 is refused too: the same content would have two ids
            raise BlobError("origin: must be 0 in a feed-forward")
        sizes_at = HEADER_BYTES + 6
        if len(data) <= sizes_at:
            raise BlobError(f"length: {len(data)} bytes end before the layers")
        numbers_at = sizes_at + 1 + data[sizes_at]
        has_region = bool(head.flags & cls._REGION)
        count = head.first + head.second + (len(TrainedRegion._fields) if has_region else 0)
        check_length(data, numbers_at + 4 * count)
        layers = tuple(data[sizes_at + 1 : numbers_at])
        for bit, present, name in ((cls._BLOCK, head.first, "block"), (cls._NETWORK, len(layers), "layers")):
            if bool(head.flags & bit) != bool(present):
                raise BlobError(f"flags: {head.flags:#06x} does not go with {present} {name}")
        size = _BLOCK_SIZES[head.version]
        if head.first not in (0, size):
            raise BlobError(f"block: has {head.first} numbers, not {size}")
        numbers = struct.unpack(f"<{count}f", data[numbers_at:])
        weights_end = head.first + head.second
        padding = (0.0,) * (BLOCK_SIZE - size)
        return cls(
            vehicle_id=head.vehicle_id,
            model_id=data[HEADER_BYTES:sizes_at].hex(),
            block=(*numbers[: head.first], *padding) if head.first else None,
            layers=layers,
            weights=numbers[head.first : weights_end],
            frame="body" if head.flags & cls._BODY else "world",
            region=TrainedRegion(*numbers[weights_end:]) if has_region else None,
            version=head.version,
        )

    @property
    def body_frame(self) -> bool:
        """Whether the network is in the body frame."""
        return self.frame == "body"

    @property
    def feeds_jerk(self) -> bool:
        """Whether the derivative of the network is fed forward too."""
        return self.version > 1

    @property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256 of the blob's bytes."""
        return blob_id(self.to_bytes())


_BLOCK_NAMES = tuple(
    name if size == 1 else f"{name}[{i}]" for name, size in BLOCK_FIELDS for i in range(size)
)


def _weight_count(layers: tuple[int, ...], frame: Frame) -> int:
    """Return the number of weights of a network with these hidden widths. Raises BlobError if invalid."""
    if not layers:
        return 0
    if len(layers) > HIDDEN_MAX or not all(isinstance(n, int) and 1 <= n <= WIDTH_MAX for n in layers):
        raise BlobError(f"layers: {list(layers)} must be 1 to {HIDDEN_MAX} widths of 1 to {WIDTH_MAX}")
    sizes = (NETWORK_INPUTS[frame], *layers, NETWORK_OUTPUTS)
    return sum((inputs + 1) * outputs for inputs, outputs in pairwise(sizes))
