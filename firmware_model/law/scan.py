"""Check a reference against the limits at samples inside every piece, including the thrust of each rotor.

The same functions evaluate one sample in floats, as on board (`least_margins`), or all samples of a reference
in arrays, as on the host: a scalar of a `Part` or of `Curves` is then an array with one value per sample.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeAlias

from trimtab.firmware_model.law.flatness import Body, flat_full
from trimtab.firmware_model.law.limits import Airframe, Limits
from trimtab.firmware_model.law.ops import FLOAT, CheckOps, Scalar, Vector
from trimtab.firmware_model.law.reference import (
    cubic_acceleration,
    cubic_at,
    cubic_coefficients,
    septic_at,
    septic_coefficients,
)
from trimtab.firmware_model.law.reference_verdict import ReferenceReason, ReferenceVerdict, refused

Node = tuple[int, Sequence[float]]
"""t_us and the 12 numbers p, v, a, j in NED."""
YawNode = tuple[int, float, float]
"""t_us, yaw and yaw rate."""

SAMPLE_INTERVAL_MAX_US = 12_500
SAMPLES_MAX = 512
"""Greatest number of samples in a piece: a longer piece does not curve faster."""

REASONS: dict[str, tuple[ReferenceReason, str]] = {
    "geofence_m": (ReferenceReason.GEOFENCE, "m"),
    "floor_m": (ReferenceReason.TOO_LOW, "m"),
    "speed_m_s": (ReferenceReason.SPEED, "m/s"),
    "tilt_deg": (ReferenceReason.TILT, "deg"),
    "body_rate_rad_s": (ReferenceReason.BODY_RATE, "rad/s"),
    "jerk_m_s3": (ReferenceReason.JERK, "m/s^3"),
    "thrust_low": (ReferenceReason.THRUST_LOW, "of max"),
    "thrust_high": (ReferenceReason.THRUST_HIGH, "of max"),
}
"""ReferenceReason and unit by name of the margin."""
_AXES = ("north", "east", "down")
_DEG_PER_RAD = math.degrees(1.0)

_Margin: TypeAlias = tuple[str, Scalar, Scalar, Scalar, str]
"""Name of the margin, margin, value, bound, quantity."""


class YawPiece(NamedTuple):
    """Piece of yaw: its start, its length, yaw and yaw rate at both ends. A held yaw has both ends alike."""

    start_us: Scalar
    length_s: Scalar
    yaw0: Scalar
    rate0: Scalar
    yaw1: Scalar
    rate1: Scalar


class Part(NamedTuple):
    """Part of a flight within one piece of position and one of yaw, sampled at count + 1 even times.

    node: at the start of the piece of position, which has the length piece_s. state0, state1: its ends.
    """

    node: Scalar
    start_us: Scalar
    length_us: Scalar
    count: Scalar
    piece_us: Scalar
    piece_s: Scalar
    state0: Vector
    state1: Vector
    yaw_us: Scalar
    yaw_s: Scalar
    yaw0: Scalar
    rate0: Scalar
    yaw1: Scalar
    rate1: Scalar


class Curves(NamedTuple):
    """Polynomials of a part: start and coefficients of position and of yaw."""

    piece_us: Scalar
    position: Vector
    yaw_us: Scalar
    heading: Vector


Search: TypeAlias = "Callable[[Sequence[Part], Bounds], tuple[dict[str, float], tuple[Part, int] | None]]"
"""Returns the least margins over all samples of the parts, and the first sample that violates a limit."""


def scan(
    nodes: Sequence[Node],
    yaw_nodes: Sequence[YawNode],
    bounds: Bounds,
    samples_per_piece: int,
    search: Search,
) -> ReferenceVerdict:
    """Return the verdict over all samples of the flight: the first violation and the least margins."""
    margins, first = search(split(nodes, yaw_nodes, samples_per_piece), bounds)
    if first is None:
        return ReferenceVerdict(ok=True, margins=margins)
    part, k = first
    t_us = sample_us(part, k)
    name, _, value, bound, quantity = next(
        margin for margin in bounds.margins(FLOAT, curves(part), t_us) if not margin[1] >= 0.0
    )
    reason, unit = REASONS[name]
    side = "below" if value < bound else "above"
    text = f"{quantity} {value:.6g} {side} {bound:.6g} {unit}"
    verdict = refused(reason, part.node, nodes[part.node][0], quantity, value, bound, text, t_us)
    return replace(verdict, margins=margins)


def least_margins(parts: Sequence[Part], bounds: Bounds) -> tuple[dict[str, float], tuple[Part, int] | None]:
    """Search the samples one by one, in order."""
    least = dict.fromkeys(REASONS, math.inf)
    first: tuple[Part, int] | None = None
    for part in parts:
        polynomials = curves(part)
        for k in range(part.count + 1):
            for name, margin, _, _, _ in bounds.margins(FLOAT, polynomials, sample_us(part, k)):
                if not margin >= least[name]:
                    least[name] = margin
                if first is None and not margin >= 0.0:
                    first = part, k
    return least, first


class Bounds:
    """Limits of one vehicle relative to one origin, for the comparison with samples."""

    def __init__(self, model: Airframe, limits: Limits, origin: Sequence[float]) -> None:
        self._limits = limits
        self._origin = origin
        self._body = Body(model.mass_kg, model.inertia_kg_m2)
        self._inverse, self._per_max = model.allocation_inverse, 1.0 / model.thrust_max_n
        self._fence = [
            (low - at, high - at, axis)
            for (low, high), at, axis in zip(limits.geofence_m, origin, _AXES, strict=True)
        ]
        self._rates = [
            (bound, f"body rate {axis}")
            for bound, axis in zip(limits.body_rate_max_rad_s, "xyz", strict=True)
        ]

    def margins(self, ops: CheckOps, polynomials: Curves, t_us: Scalar) -> list[_Margin]:
        """Return every margin of a sample at this time."""
        p, v, a, j, snap = septic_at(polynomials.position, (t_us - polynomials.piece_us) * 1e-6)
        yaw_s = (t_us - polynomials.yaw_us) * 1e-6
        yaw, yaw_rate = cubic_at(polynomials.heading, yaw_s)
        yaw_accel = cubic_acceleration(polynomials.heading, yaw_s)
        limits, inverse = self._limits, self._inverse
        R, rate, _, collective, torque = flat_full(ops, a, j, snap, yaw, yaw_rate, self._body, yaw_accel)
        tx, ty, tz = torque
        out: list[_Margin] = []
        for x, at, (low, high, axis) in zip(p, self._origin, self._fence, strict=True):
            above, below = high - x, x - low
            bound = ops.where(above < below, high, low)
            out.append(("geofence_m", ops.minimum(above, below), x + at, bound + at, axis))
        height = -(p[2] + self._origin[2])
        out.append(("floor_m", height, height, 0.0, "height"))
        tilt = _DEG_PER_RAD * ops.acos(ops.clip(R[8], -1.0, 1.0))
        for name, quantity, value, bound in (
            ("speed_m_s", "speed", ops.hypot(*v), limits.speed_max_m_s),
            ("tilt_deg", "tilt", tilt, limits.tilt_max_deg),
            ("jerk_m_s3", "jerk", ops.hypot(*j), limits.jerk_max_m_s3),
        ):
            out.append((name, bound - value, value, bound, quantity))
        for value, (bound, quantity) in zip(rate, self._rates, strict=True):
            out.append(("body_rate_rad_s", bound - abs(value), abs(value), bound, quantity))
        low_share, high_share = limits.thrust_headroom
        for rotor in range(4):
            k = 4 * rotor
            thrust = inverse[k] * collective + inverse[k + 1] * tx + inverse[k + 2] * ty + inverse[k + 3] * tz
            share, quantity = thrust * self._per_max, f"thrust of rotor {rotor + 1}"
            out.append(("thrust_low", share - low_share, share, low_share, quantity))
            out.append(("thrust_high", high_share - share, share, high_share, quantity))
        return out


def split(nodes: Sequence[Node], yaw_nodes: Sequence[YawNode], samples_per_piece: int) -> list[Part]:
    """Return the parts of a flight, in order: the pieces of position and of yaw, split at each other's ends.

    Each part is sampled at both ends and in between, because snap and yaw acceleration jump from one part to
    the next.
    """
    times = [t_us for t_us, _ in nodes]
    cuts = sorted({*times, *(t_us for t_us, _, _ in yaw_nodes if t_us < times[-1])})
    parts = []
    for start_us, end_us in pairwise(cuts):
        node = bisect_right(times, start_us) - 1
        (t0, state0), (t1, state1) = nodes[node], nodes[node + 1]
        length_us = end_us - start_us
        count = min(max(samples_per_piece, -(-length_us // SAMPLE_INTERVAL_MAX_US)), SAMPLES_MAX)
        turn = yaw_piece(yaw_nodes, start_us)
        parts.append(Part(node, start_us, length_us, count, t0, (t1 - t0) * 1e-6, state0, state1, *turn))
    return parts


def sample_us(part: Part, k: Scalar) -> Scalar:
    """Return the time of sample `k` of a part."""
    return part.start_us + part.length_us * k / part.count


def curves(part: Part) -> Curves:
    """Return the polynomials of a part."""
    return Curves(
        part.piece_us,
        septic_coefficients(part.piece_s, part.state0, part.state1),
        part.yaw_us,
        cubic_coefficients(part.yaw_s, part.yaw0, part.rate0, part.yaw1, part.rate1),
    )


def yaw_piece(yaw_nodes: Sequence[YawNode], t_us: int) -> YawPiece:
    """Return the piece of yaw at `t_us`. Yaw is constant outside the nodes."""
    after = bisect_right(yaw_nodes, t_us, key=lambda node: node[0])
    if after == 0 or after == len(yaw_nodes):
        yaw = yaw_nodes[max(after - 1, 0)][1]
        return YawPiece(t_us, 1.0, yaw, 0.0, yaw, 0.0)
    (t0, *start), (t1, *end) = yaw_nodes[after - 1], yaw_nodes[after]
    return YawPiece(t0, (t1 - t0) * 1e-6, *start, *end)
