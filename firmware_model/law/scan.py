"""Check a reference against the limits at samples inside every piece, including the thrust of each rotor."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from trimtab.firmware_model.law.flatness import Body, flat_full
from trimtab.firmware_model.law.limits import Airframe, Limits
from trimtab.firmware_model.law.ops import FLOAT
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

_REASONS: dict[str, tuple[ReferenceReason, str]] = {
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

_Flat = tuple[Sequence[float], Sequence[float], Sequence[float], Sequence[float], Sequence[float]]
"""p, v, a, j, snap in NED."""
_Margin = tuple[str, float, float, float, str]
"""Name of the margin, margin, value, bound, quantity."""


def scan(
    nodes: Sequence[Node],
    yaw_nodes: Sequence[YawNode],
    model: Airframe,
    limits: Limits,
    samples_per_piece: int,
    origin: Sequence[float],
) -> ReferenceVerdict:
    """Return the verdict over all samples of the flight: the first violation and the least margins."""
    margins = dict.fromkeys(_REASONS, math.inf)
    first: ReferenceVerdict | None = None
    bounds = _Bounds(model, limits, origin)
    for node, t_us, flat, *heading in _samples(nodes, yaw_nodes, samples_per_piece):
        for name, margin, value, bound, quantity in bounds.margins(flat, *heading):
            if not margin >= margins[name]:
                margins[name] = margin
            if first is None and not margin >= 0.0:
                reason, unit = _REASONS[name]
                side = "below" if value < bound else "above"
                text = f"{quantity} {value:.6g} {side} {bound:.6g} {unit}"
                first = refused(reason, node, nodes[node][0], quantity, value, bound, text, t_us)
    if first is None:
        return ReferenceVerdict(ok=True, margins=margins)
    return replace(first, margins=margins)


class _Bounds:
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

    def margins(self, flat: _Flat, yaw: float, yaw_rate: float, yaw_accel: float) -> list[_Margin]:
        """Return every margin of one sample."""
        p, v, a, j, snap = flat
        limits, inverse = self._limits, self._inverse
        R, rate, _, collective, torque = flat_full(FLOAT, a, j, snap, yaw, yaw_rate, self._body, yaw_accel)
        tx, ty, tz = torque
        out: list[_Margin] = []
        for x, at, (low, high, axis) in zip(p, self._origin, self._fence, strict=True):
            bound = high if high - x < x - low else low
            out.append(("geofence_m", min(high - x, x - low), x + at, bound + at, axis))
        height = -(p[2] + self._origin[2])
        out.append(("floor_m", height, height, 0.0, "height"))
        for name, value, bound in (
            ("speed_m_s", math.hypot(*v), limits.speed_max_m_s),
            ("tilt_deg", math.degrees(math.acos(max(-1.0, min(1.0, R[8])))), limits.tilt_max_deg),
            ("jerk_m_s3", math.hypot(*j), limits.jerk_max_m_s3),
        ):
            out.append((name, bound - value, value, bound, name.partition("_")[0]))
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


def _samples(
    nodes: Sequence[Node], yaw_nodes: Sequence[YawNode], samples_per_piece: int
) -> Iterator[tuple[int, float, _Flat, float, float, float]]:
    """Yield piece, time (us), p to snap, yaw, yaw rate and yaw acceleration of every sample, in order.

    The pieces of position and of yaw are split at each other's ends. Each part is sampled at both ends and in
    between, because snap and yaw acceleration jump from one part to the next.
    """
    times = [t_us for t_us, _ in nodes]
    cuts = sorted({*times, *(t_us for t_us, _, _ in yaw_nodes if t_us < times[-1])})
    for start_us, end_us in pairwise(cuts):
        piece = bisect_right(times, start_us) - 1
        (t0, node0), (t1, node1) = nodes[piece], nodes[piece + 1]
        position = septic_coefficients((t1 - t0) * 1e-6, node0, node1)
        yaw_us, heading = yaw_piece(yaw_nodes, start_us)
        length = end_us - start_us
        count = min(max(samples_per_piece, -(-length // SAMPLE_INTERVAL_MAX_US)), SAMPLES_MAX)
        for k in range(count + 1):
            t_us = start_us + length * k / count
            yaw_s = (t_us - yaw_us) * 1e-6
            yield (
                piece,
                t_us,
                septic_at(position, (t_us - t0) * 1e-6),
                *cubic_at(heading, yaw_s),
                cubic_acceleration(heading, yaw_s),
            )


def yaw_piece(yaw_nodes: Sequence[YawNode], t_us: int) -> tuple[int, tuple[float, float, float, float]]:
    """Return start (us) and coefficients of the yaw piece at `t_us`. Yaw is constant outside the nodes."""
    after = bisect_right(yaw_nodes, t_us, key=lambda node: node[0])
    if after == 0 or after == len(yaw_nodes):
        return t_us, (yaw_nodes[max(after - 1, 0)][1], 0.0, 0.0, 0.0)
    (t0, *start), (t1, *end) = yaw_nodes[after - 1], yaw_nodes[after]
    return t0, cubic_coefficients((t1 - t0) * 1e-6, *start, *end)
