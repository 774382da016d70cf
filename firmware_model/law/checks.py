"""The verdict on a reference: whether the vehicle can and may fly it; one function for planner and vehicle.

Judged is what is flown: the pieces between the nodes, septic in position and cubic in yaw, not the nodes.
Limits are compared inside every piece of either, every 12.5 ms or in pieces over 6.4 s 512 times, with the
thrust of every rotor from the flat outputs. Floats only.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import pairwise

from trimtab.firmware_model.law.allocation import allocation_matrix, invert4
from trimtab.firmware_model.law.flatness import Body, flat_full
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.reference import (
    cubic_acceleration,
    cubic_at,
    cubic_coefficients,
    septic_at,
    septic_coefficients,
)
from trimtab.firmware_model.law.smoothness import QUANTITIES, worst_misfit

Node = tuple[int, Sequence[float]]
"""t_us and the 12 numbers p, v, a, j in NED."""
YawNode = tuple[int, float, float]
"""t_us, yaw and yaw rate."""

LONGEST_SAMPLE_US = 12_500
MOST_SAMPLES = 512
"""In one piece, however long it is: its polynomials bend no faster for being longer."""
REST = (1e-3, 1e-2, 1e-1)
"""Greatest speed, acceleration and jerk that count as rest: what rounding to float32 leaves, and some."""
REST_YAW_RATE = 1e-3
"""Greatest yaw rate that counts as rest."""
GREATEST_NUMBER = 1e6
"""A number beyond this in a node is as little a reference as NaN."""


class Reason(IntEnum):
    """Why a reference was refused; the numbers travel on the wire and never change."""

    NONE = 0
    TOO_FEW_NODES = 1
    NOT_FINITE = 2
    TIME_ORDER = 3
    NOT_AT_REST = 4
    TOO_LOW = 5
    GEOFENCE = 6
    SPEED = 7
    TILT = 8
    BODY_RATE = 9
    JERK = 10
    THRUST_LOW = 11
    THRUST_HIGH = 12
    NOT_SMOOTH = 13
    BATTERY = 14  # found by the vehicle, which alone knows its voltage


@dataclass(frozen=True, kw_only=True)
class Airframe:
    """What the thrusts of the rotors follow from.

    inertia_kg_m2 about x, y, z of FRD; allocation_inverse: 16, row-major, [T, tau] to rotor thrusts.
    """

    mass_kg: float
    inertia_kg_m2: tuple[float, float, float]
    allocation_inverse: tuple[float, ...]
    thrust_max_n: float

    def __post_init__(self) -> None:
        if len(self.inertia_kg_m2) != 3 or len(self.allocation_inverse) != 16:
            raise ValueError("an airframe has 3 moments of inertia and a 4 x 4 inverse allocation")
        for value in (self.mass_kg, self.thrust_max_n, *self.inertia_kg_m2):
            if not 0.0 < value < math.inf:
                raise ValueError(f"mass, inertia and greatest thrust must be positive, not {value!r}")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a reference may ask for.

    thrust_headroom: least and greatest share of a rotor's greatest thrust; geofence_m: (low, high) of north,
    east and down; end_height_m: least height of both ends above the floor z = 0.
    """

    speed_max_m_s: float
    tilt_max_deg: float
    body_rate_max_rad_s: tuple[float, float, float]
    jerk_max_m_s3: float
    thrust_headroom: tuple[float, float]
    geofence_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    end_height_m: float = 0.5

    def __post_init__(self) -> None:
        if len(self.body_rate_max_rad_s) != 3 or len(self.geofence_m) != 3:
            raise ValueError("limits have 3 body rates and 3 geofence intervals")
        for name, intervals in (("thrust share", (self.thrust_headroom,)), ("geofence", self.geofence_m)):
            for low, high in intervals:
                if not low < high:
                    raise ValueError(f"{name} {low:.6g} to {high:.6g} is no interval")


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What was found: `ok`, or the first node whose piece breaks a limit, and the numbers.

    text: what is wrong there, at most 64 bytes; message: with node and time, for people. margins: least
    distance to each bound over the whole flight, negative where broken; empty where the nodes are no
    reference at all.
    """

    ok: bool
    node: int = -1
    quantity: str = ""
    value: float = 0.0
    bound: float = 0.0
    reason_code: Reason = Reason.NONE
    text: str = ""
    message: str = "within all limits"
    margins: Mapping[str, float] = field(default_factory=dict)


def from_parameters(table: Mapping[str, float]) -> tuple[Airframe, Limits]:
    """Airframe and limits by the names of protocol's parameter table.

    Raises KeyError for a missing name, ValueError for values that make no vehicle.
    """
    rotors = ("ROTOR1", "ROTOR2", "ROTOR3", "ROTOR4")
    positions = [(table[f"{rotor}_X"], table[f"{rotor}_Y"]) for rotor in rotors]
    spins = [table[f"{rotor}_SPIN"] for rotor in rotors]
    airframe = Airframe(
        mass_kg=table["MASS"],
        inertia_kg_m2=(table["INERTIA_X"], table["INERTIA_Y"], table["INERTIA_Z"]),
        allocation_inverse=invert4(allocation_matrix(positions, spins, table["TORQUE_PER_N"])),
        thrust_max_n=table["THRUST_MAX"],
    )
    limits = Limits(
        speed_max_m_s=table["LIM_SPEED"],
        tilt_max_deg=table["LIM_TILT_DEG"],
        body_rate_max_rad_s=(table["LIM_RATE_X"], table["LIM_RATE_Y"], table["LIM_RATE_Z"]),
        jerk_max_m_s3=table["LIM_JERK"],
        thrust_headroom=(table["LIM_THR_LO"], table["LIM_THR_HI"]),
        geofence_m=(
            (table["FENCE_N_MIN"], table["FENCE_N_MAX"]),
            (table["FENCE_E_MIN"], table["FENCE_E_MAX"]),
            (table["FENCE_D_MIN"], table["FENCE_D_MAX"]),
        ),
        end_height_m=table["END_HEIGHT"],
    )
    return airframe, limits


def check_reference(
    nodes: Sequence[Node],
    yaw_nodes: Sequence[YawNode],
    model: Airframe,
    limits: Limits,
    samples_per_piece: int = 8,
    *,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    ends_at_rest: bool = True,
) -> Verdict:
    """Return the verdict on the reference through `nodes` (NED, positions relative to `origin`) and
    `yaw_nodes`.

    Nodes are judged as stored: first t_us 0, strictly increasing, finite. With `ends_at_rest` (the default)
    both ends are at rest and at least `limits.end_height_m` above the floor. Nothing lies below the floor
    z = 0, whatever the geofence, and yaw is at rest where it comes out of a hold or goes into one.
    """
    broken = _structure(nodes, yaw_nodes, origin)
    if broken is None:
        broken = _holds(nodes, yaw_nodes, ends_at_rest)
    if broken is None and ends_at_rest:
        broken = check_ends(nodes, limits, origin, ends=(0, len(nodes) - 1))
    if broken is None:
        broken = _smooth(nodes)
    if broken is not None:
        return broken
    return _scan(nodes, yaw_nodes, model, limits, samples_per_piece, origin)


def _refused(
    reason: Reason,
    node: int,
    t_us: int,
    quantity: str,
    value: float,
    bound: float,
    text: str,
    at_us: float | None = None,
) -> Verdict:
    """Return a refusal: of the node at t_us, or of the piece after it at the time at_us."""
    message = f"node {node} at {t_us * 1e-6:.3f} s: {text}"
    if at_us is not None:
        message += f", at {at_us * 1e-6:.3f} s"
    return Verdict(
        ok=False,
        node=node,
        quantity=quantity,
        value=value,
        bound=bound,
        reason_code=reason,
        text=text,
        message=message,
    )


def _structure(
    nodes: Sequence[Node], yaw_nodes: Sequence[YawNode], origin: Sequence[float]
) -> Verdict | None:
    """Return the refusal of what is no reference at all, or None."""
    if len(nodes) < 2 or len(yaw_nodes) < 1:
        text = f"{len(nodes)} nodes and {len(yaw_nodes)} yaw nodes, at least 2 and 1 are needed"
        return _refused(Reason.TOO_FEW_NODES, len(nodes), 0, "nodes", float(len(nodes)), 2.0, text)
    rows = [(t, tuple(state), "node") for t, state in nodes]
    rows += [(t, (yaw, rate), "yaw node") for t, yaw, rate in yaw_nodes]
    for k, (t_us, values, what) in enumerate(rows):
        node = k if what == "node" else k - len(nodes)
        for value in (*values, *origin):
            if not abs(value) <= GREATEST_NUMBER:
                text = f"{what} holds {value:.6g}, not a number to fly by"
                return _refused(Reason.NOT_FINITE, node, t_us, what, value, GREATEST_NUMBER, text)
    if nodes[0][0] != 0:
        text = "the first node must be at 0"
        return _refused(Reason.TIME_ORDER, 0, nodes[0][0], "time", nodes[0][0] * 1e-6, 0.0, text)
    for times, what in (([t for t, _ in nodes], "node"), ([t for t, _, _ in yaw_nodes], "yaw node")):
        for k, (before, after) in enumerate(pairwise(times), start=1):
            if after <= before:
                text = f"{what} is not after the one before, at {before * 1e-6:.6f} s"
                return _refused(Reason.TIME_ORDER, k, after, "time", after * 1e-6, before * 1e-6, text)
    return None


def check_ends(
    nodes: Sequence[Node], limits: Limits, origin: Sequence[float], *, ends: Sequence[int]
) -> Verdict | None:
    """Return the refusal of a start or end that is not at rest or too low, or None.

    ends: which nodes are judged.
    """
    for node in ends:
        t_us, state = nodes[node]
        end = "start" if node == 0 else "end"
        for k, (quantity, unit) in enumerate(
            (("speed", "m/s"), ("acceleration", "m/s^2"), ("jerk", "m/s^3"))
        ):
            value = math.hypot(*state[3 * k + 3 : 3 * k + 6])
            if not value <= REST[k]:
                text = f"the {end} is not at rest, {quantity} {value:.4g} {unit}"
                return _refused(Reason.NOT_AT_REST, node, t_us, quantity, value, REST[k], text)
        height, bound = -(state[2] + origin[2]), limits.end_height_m
        if not height >= bound - 1e-6:
            text = f"the {end} is {height:.3g} m above the floor, less than {bound:.3g} m"
            return _refused(Reason.TOO_LOW, node, t_us, "height", height, bound, text)
    return None


def _holds(nodes: Sequence[Node], yaw_nodes: Sequence[YawNode], ends_at_rest: bool) -> Verdict | None:
    """Return the refusal of a yaw rate that jumps, or None.

    Yaw is held outside its nodes, and before and after a flight whose ends are at rest.
    """
    end_us = nodes[-1][0]
    first_us, last_us = max(yaw_nodes[0][0], 0), min(yaw_nodes[-1][0], end_us)
    if first_us >= last_us:
        return None
    start, stop = _yaw_piece(yaw_nodes, first_us), _yaw_piece(yaw_nodes, last_us - 1)
    for (t0, coefficients), t_us, free in (
        (start, first_us, first_us == 0),
        (stop, last_us, last_us == end_us),
    ):
        rate = abs(cubic_at(coefficients, (t_us - t0) * 1e-6)[1])
        if not rate <= REST_YAW_RATE and (ends_at_rest or not free):
            node = max(0, bisect_left([t for t, _ in nodes], t_us) - 1)
            text = f"yaw rate {rate:.4g} rad/s where yaw is held"
            return _refused(
                Reason.NOT_AT_REST, node, nodes[node][0], "yaw rate", rate, REST_YAW_RATE, text, t_us
            )
    return None


def _smooth(nodes: Sequence[Node]) -> Verdict | None:
    """Return the refusal of the node that fits its neighbours least, or None where every node fits."""
    worst = worst_misfit(nodes)
    if worst is None or worst.value <= worst.bound:
        return None
    quantity, unit = QUANTITIES[worst.quantity]
    text = f"{quantity} off its neighbours by {worst.value:.3g}, above {worst.bound:.3g} {unit}"
    t_us = nodes[worst.node][0]
    return _refused(Reason.NOT_SMOOTH, worst.node, t_us, quantity, worst.value, worst.bound, text)


_REASONS: dict[str, tuple[Reason, str]] = {
    "geofence_m": (Reason.GEOFENCE, "m"),
    "floor_m": (Reason.TOO_LOW, "m"),
    "speed_m_s": (Reason.SPEED, "m/s"),
    "tilt_deg": (Reason.TILT, "deg"),
    "body_rate_rad_s": (Reason.BODY_RATE, "rad/s"),
    "jerk_m_s3": (Reason.JERK, "m/s^3"),
    "thrust_low": (Reason.THRUST_LOW, "of max"),
    "thrust_high": (Reason.THRUST_HIGH, "of max"),
}
"""Reason and unit by the margin's name."""
_AXES = ("north", "east", "down")


def _scan(
    nodes: Sequence[Node],
    yaw_nodes: Sequence[YawNode],
    model: Airframe,
    limits: Limits,
    samples_per_piece: int,
    origin: Sequence[float],
) -> Verdict:
    """Return the verdict of every sample along the flight: the first violation, and the least margins."""
    margins = dict.fromkeys(_REASONS, math.inf)
    first: Verdict | None = None
    body = Body(model.mass_kg, model.inertia_kg_m2)
    inverse, per_max = model.allocation_inverse, 1.0 / model.thrust_max_n
    fence = [
        (low - at, high - at, axis)
        for (low, high), at, axis in zip(limits.geofence_m, origin, _AXES, strict=True)
    ]
    rates = [
        (bound, f"body rate {axis}") for bound, axis in zip(limits.body_rate_max_rad_s, "xyz", strict=True)
    ]
    low_share, high_share = limits.thrust_headroom
    for node, t_us, (p, v, a, j, snap), yaw, yaw_rate, yaw_accel in _samples(
        nodes, yaw_nodes, samples_per_piece
    ):
        R, rate, _, collective, torque = flat_full(FLOAT, a, j, snap, yaw, yaw_rate, body, yaw_accel)
        tx, ty, tz = torque
        found: list[
            tuple[str, float, float, float, str]
        ] = []  # margin's name, margin, value, bound, quantity
        for x, at, (low, high, axis) in zip(p, origin, fence, strict=True):
            bound = high if high - x < x - low else low
            found.append(("geofence_m", min(high - x, x - low), x + at, bound + at, axis))
        height = -(p[2] + origin[2])
        found.append(("floor_m", height, height, 0.0, "height"))
        for name, value, bound in (
            ("speed_m_s", math.hypot(*v), limits.speed_max_m_s),
            ("tilt_deg", math.degrees(math.acos(max(-1.0, min(1.0, R[8])))), limits.tilt_max_deg),
            ("jerk_m_s3", math.hypot(*j), limits.jerk_max_m_s3),
        ):
            found.append((name, bound - value, value, bound, name.partition("_")[0]))
        for value, (bound, quantity) in zip(rate, rates, strict=True):
            found.append(("body_rate_rad_s", bound - abs(value), abs(value), bound, quantity))
        for rotor in range(4):
            k = 4 * rotor
            thrust = inverse[k] * collective + inverse[k + 1] * tx + inverse[k + 2] * ty + inverse[k + 3] * tz
            share = thrust * per_max
            found.append(("thrust_low", share - low_share, share, low_share, f"thrust of rotor {rotor + 1}"))
            found.append(
                ("thrust_high", high_share - share, share, high_share, f"thrust of rotor {rotor + 1}")
            )
        for name, margin, value, bound, quantity in found:
            if not margin >= margins[name]:
                margins[name] = margin
            if first is None and not margin >= 0.0:
                reason, unit = _REASONS[name]
                side = "below" if value < bound else "above"
                text = f"{quantity} {value:.6g} {side} {bound:.6g} {unit}"
                first = _refused(reason, node, nodes[node][0], quantity, value, bound, text, t_us)
    if first is None:
        return Verdict(ok=True, margins=margins)
    return replace(first, margins=margins)


_Flat = tuple[Sequence[float], Sequence[float], Sequence[float], Sequence[float], Sequence[float]]
"""p, v, a, j, snap in NED."""


def _samples(
    nodes: Sequence[Node], yaw_nodes: Sequence[YawNode], samples_per_piece: int
) -> Iterator[tuple[int, float, _Flat, float, float, float]]:
    """Piece, time (us), p to snap, yaw, yaw rate and acceleration of every sample along the flight, in order.

    Pieces of position and of yaw are cut at each other's ends, and what is left of them is sampled at both of
    its ends and in between: snap and yaw acceleration jump from one to the next.
    """
    times = [t_us for t_us, _ in nodes]
    cuts = sorted({*times, *(t_us for t_us, _, _ in yaw_nodes if t_us < times[-1])})
    for start_us, end_us in pairwise(cuts):
        piece = bisect_right(times, start_us) - 1
        (t0, node0), (t1, node1) = nodes[piece], nodes[piece + 1]
        position = septic_coefficients((t1 - t0) * 1e-6, node0, node1)
        yaw_us, heading = _yaw_piece(yaw_nodes, start_us)
        length = end_us - start_us
        count = min(max(samples_per_piece, -(-length // LONGEST_SAMPLE_US)), MOST_SAMPLES)
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


def _yaw_piece(yaw_nodes: Sequence[YawNode], t_us: int) -> tuple[int, tuple[float, float, float, float]]:
    """Start (us) and coefficients of the yaw piece from t_us on; held before the first and after the last."""
    after = bisect_right(yaw_nodes, t_us, key=lambda node: node[0])
    if after == 0 or after == len(yaw_nodes):
        return t_us, (yaw_nodes[max(after - 1, 0)][1], 0.0, 0.0, 0.0)
    (t0, *start), (t1, *end) = yaw_nodes[after - 1], yaw_nodes[after]
    return t0, cubic_coefficients((t1 - t0) * 1e-6, *start, *end)
