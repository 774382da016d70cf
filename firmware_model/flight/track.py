"""What there is to follow, as a timeline of septic pieces and yaw pieces.

A flight is one track after the other: climb and hover, the live reference, hold, descent. Each is built once,
when its phase begins; a tick then only advances the time inside the current piece. All positions in m, NED; a
node is p, v, a, j, three each.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from trimtab.firmware_model.law.checks import REST, REST_YAW_RATE
from trimtab.firmware_model.law.reference import (
    CUBIC_SIZE,
    SEPTIC_SIZE,
    cubic_at,
    cubic_coefficients,
    septic,
    septic_at,
    septic_coefficients,
)

Vector = tuple[float, float, float]
Node = tuple[float, ...]
YawState = tuple[float, float]
"""Yaw and yaw rate."""

SEPTIC_PEAK = 35.0 / 16.0
"""Peak speed over mean speed of a septic from rest to rest."""
QUINTIC_PEAK = 15.0 / 8.0
"""Peak acceleration over mean acceleration where the speed goes by a quintic."""
BRAKING = 5.0
"""m/s^2 at which a descent without position takes the speed out."""
TURN_US = 500_000
"""Time in which a turn that nothing continues ends."""
SINK = 1.5
"""m/s^2 by which thrust falls short of hover once velocity is unknown too."""
EASE_S = 0.4
"""Time in which a stop takes out the acceleration it begins with, before the speed."""
SHORTEST_STOP_S = 0.8
HARDER = (1.0, 0.85, 0.7, 0.6, 0.5)
"""Shares of its time that a stop is tried with, one after the other, where it leads out of its room."""
ENDLESS_US = 1_000_000_000_000
"""How long something lasts that nothing but an event ends: eleven days."""
_ZERO: Vector = (0.0, 0.0, 0.0)
_SIDEWAYS, _DOWN = (0, 1), (2,)
_SAMPLES = 8  # of a piece


class Room(NamedTuple):
    """Where a reference may lead: between two corners, NED."""

    low: Vector
    high: Vector

    def beyond(self, p: Sequence[float], axes: Sequence[int] = (0, 1, 2)) -> float:
        """How far (m) a position lies outside, along the worst of the axes; 0 inside."""
        return max(0.0, *(max(p[i] - self.high[i], self.low[i] - p[i]) for i in axes))


@dataclass(frozen=True, kw_only=True)
class Track:
    """A timeline from 0 to `end_us`: piece k holds from starts_us[k] until the next one starts.

    blocks[k] is what the law's `piece` input takes: the time inside, 0 here, and the coefficients;
    yaw_blocks[k] likewise. Position and yaw at both ends stand beside them, and whether both are at rest.
    """

    starts_us: tuple[int, ...]
    blocks: tuple[memoryview, ...]
    yaw_starts_us: tuple[int, ...]
    yaw_blocks: tuple[memoryview, ...]
    end_us: int
    start_ned: Vector
    end_ned: Vector
    start_yaw: float
    end_yaw: float
    rests: bool

    def __post_init__(self) -> None:
        for starts, blocks, size in (
            (self.starts_us, self.blocks, 1 + SEPTIC_SIZE),
            (self.yaw_starts_us, self.yaw_blocks, 1 + CUBIC_SIZE),
        ):
            if not starts or starts[0] != 0 or len(starts) != len(blocks):
                raise ValueError("a track begins with a piece at 0 and has as many starts as pieces")
            for start_us, end_us in pairwise((*starts, self.end_us)):
                _duration_s(start_us, end_us)
            if any(len(block) != size for block in blocks):
                raise ValueError(f"a block must have {size} values")

    def state_at(self, t_us: int) -> tuple[float, ...]:
        """p, v, a, j (NED), yaw and yaw rate at a time from 0 to the end."""
        k, y = bisect_right(self.starts_us, t_us) - 1, bisect_right(self.yaw_starts_us, t_us) - 1
        p, v, a, j, _ = septic_at(self.blocks[k][1:], (t_us - self.starts_us[k]) * 1e-6)
        return *p, *v, *a, *j, *cubic_at(self.yaw_blocks[y][1:], (t_us - self.yaw_starts_us[y]) * 1e-6)


def track(
    nodes: Sequence[tuple[int, Node]],
    yaw_nodes: Sequence[tuple[int, float, float]],
) -> Track:
    """Return a Track through nodes (t_us, 12 values) and yaw nodes (t_us, yaw, rate); both times start
    anywhere.

    The track lasts as long as the nodes do. Before its first and after its last node yaw is held.
    """
    if len(nodes) < 2:
        raise ValueError("a track begins with a piece, from one node to another")
    first_us, end_us = nodes[0][0], nodes[-1][0]
    starts = []
    blocks = []
    for (t0, node0), (t1, node1) in pairwise(nodes):
        starts.append(t0 - first_us)
        blocks.append(_block(septic_coefficients(_duration_s(t0, t1), node0, node1)))
    yaw_starts: list[int] = []
    yaw_blocks: list[memoryview] = []
    pieces = _yaw_pieces(yaw_nodes, first_us, end_us)
    for t0, t1, *values in pieces:
        yaw_starts.append(int(t0) - first_us)
        yaw_blocks.append(_block(cubic_coefficients(_duration_s(t0, t1), *values)))
    t0, t1, _, _, end_yaw, end_rate = pieces[-1]
    if t1 > end_us:  # the flight ends inside the piece
        end_yaw, end_rate = cubic_at(yaw_blocks[-1][1:], (end_us - t0) * 1e-6)
    return Track(
        starts_us=tuple(starts),
        blocks=tuple(blocks),
        yaw_starts_us=tuple(yaw_starts),
        yaw_blocks=tuple(yaw_blocks),
        end_us=end_us - first_us,
        start_ned=_position(nodes[0][1]),
        end_ned=_position(nodes[-1][1]),
        start_yaw=pieces[0][2],
        end_yaw=end_yaw,
        rests=_at_rest(nodes[0][1], pieces[0][3]) and _at_rest(nodes[-1][1], end_rate),
    )


def climb(
    p: Vector, yaw: float, target: Vector, yaw_end: float, *, speed: float, clear: float, hover_us: int
) -> Track:
    """From rest at `p` to rest at `target` by septic pieces, then `hover_us` of hover.

    Where the target lies further than `clear` to the side, the vehicle first climbs straight up to its
    height. Peak speed is `speed`, but no piece is shorter than a second and a half. Yaw turns the short way
    round.
    """
    corners = [target]
    if math.hypot(target[0] - p[0], target[1] - p[1]) > clear:
        corners.insert(0, (p[0], p[1], target[2]))
    return _legs([(0, _rest(p))], (yaw, 0.0), corners, yaw_end, speed=speed, hover_us=hover_us)


def transit(
    state: Node,
    yaw: YawState,
    target: Vector,
    yaw_end: float,
    *,
    speed: float,
    deceleration: float,
    room: Room,
    hover_us: int,
    upright: bool = False,
) -> Track:
    """From the reference state (p, v, a, j) in the air to a stop, then straight to rest at `target`; hover.

    upright: first straight up to its height. Speeds, times and yaw as `climb` has them.
    """
    nodes = braked(state, deceleration, room)
    north, east, _ = _position(nodes[-1][1])
    corners = [(north, east, target[2]), target] if upright else [target]
    return _legs(nodes, yaw, corners, yaw_end, speed=speed, hover_us=hover_us)


def _legs(
    nodes: list[tuple[int, Node]],
    yaw: YawState,
    corners: Sequence[Vector],
    yaw_end: float,
    *,
    speed: float,
    hover_us: int,
) -> Track:
    """Septic pieces from rest to rest from the last node through the corners, then hover."""
    turn_us, turn_from, _ = turning = _turning(*yaw)[-1]
    t_us, last = nodes[-1]
    p = _position(last)
    for corner in corners:
        t_us += seconds_us(max(1.5, SEPTIC_PEAK * math.dist(p, corner) / speed))
        nodes.append((t_us, _rest(corner)))
        p = corner
    nodes.append((t_us + hover_us, _rest(p)))
    yaws = [(0, *yaw), turning] if turn_us else [turning]
    turn = math.remainder(yaw_end - turn_from, 2.0 * math.pi)
    # The reference's own yaw at the end: what was turned so far is counted from there.
    yaws = [(at_us, yaw_end - turn + (value - turn_from), rate) for at_us, value, rate in yaws]
    return track(nodes, [*yaws, (t_us, yaw_end, 0.0)])


def hold(p: Vector, yaw: float, duration_us: int) -> Track:
    """At rest at `p` for `duration_us`."""
    return track([(0, _rest(p)), (duration_us, _rest(p))], [(0, yaw, 0.0)])


def stop(state: Node, yaw: YawState, *, deceleration: float, room: Room, hold_us: int = ENDLESS_US) -> Track:
    """From the reference state (p, v, a, j) to a stop, then at rest for `hold_us`."""
    nodes = braked(state, deceleration, room)
    t_us, last = nodes[-1]
    nodes[-1] = (t_us, _rest(_position(last)))
    return track([*nodes, (t_us + hold_us, nodes[-1][1])], _turning(*yaw))


def land(state: Node, yaw: YawState, *, floor: float, speed: float, deceleration: float, room: Room) -> Track:
    """From the reference state (p, v, a, j) to a stop, then straight down at `speed` to 1 m below `floor`.

    A vehicle at rest begins to descend at once. The end of the track is a timeout: touchdown comes before.
    """
    nodes = braked(state, deceleration, room, still=0.05)
    t_us, last = nodes[-1]
    p = _position(last)
    down: Vector = (0.0, 0.0, speed)
    t_us += 1_000_000
    p = _below(p, 0.5 * speed)
    nodes.append((t_us, (*p, *down, *_ZERO, *_ZERO)))
    rest_us = seconds_us(max(1.0, (floor + 1.0 - p[2]) / speed))
    p = _below(p, speed * rest_us * 1e-6)
    nodes.append((t_us + rest_us, (*p, *down, *_ZERO, *_ZERO)))
    return track(nodes, _turning(*yaw))


def level_descent(
    p: Vector, velocity: Vector, yaw: float, *, speed: float, damped_us: int, end_us: int
) -> Track:
    """From `velocity` to `speed` straight down within a second and so on until `damped_us`, then ever faster.

    Meant to be followed without position feedback. Within the second after `damped_us` thrust sinks by SINK,
    where it stays until `end_us`: that part needs no velocity feedback either.
    """
    down: Vector = (0.0, 0.0, speed)
    brake_us = seconds_us(max(1.0, QUINTIC_PEAK * math.dist(velocity, down) / BRAKING))
    start: Node = (*p, *velocity, *_ZERO, *_ZERO)
    p1 = coast(start, down, brake_us * 1e-6)
    damped_us = max(damped_us, brake_us + 100_000)
    p2 = _below(p1, speed * (damped_us - brake_us) * 1e-6)
    p3 = _below(p2, speed + 0.15 * SINK)  # 3 s^2 - 2 s^3, integrated twice
    fall_us = damped_us + 1_000_000
    end_us = max(end_us, fall_us + 1_000_000)
    fall_s = (end_us - fall_us) * 1e-6
    fall = speed + 0.5 * SINK
    p4 = _below(p3, (fall + 0.5 * SINK * fall_s) * fall_s)
    nodes: list[tuple[int, Node]] = [
        (0, start),
        (brake_us, (*p1, *down, *_ZERO, *_ZERO)),
        (damped_us, (*p2, *down, *_ZERO, *_ZERO)),
        (fall_us, (*p3, 0.0, 0.0, fall, 0.0, 0.0, SINK, *_ZERO)),
        (end_us, (*p4, 0.0, 0.0, fall + SINK * fall_s, 0.0, 0.0, SINK, *_ZERO)),
    ]
    return track(nodes, [(0, yaw, 0.0)])


def seconds_us(seconds: float) -> int:
    """Whole microseconds, a whole number of milliseconds: phases begin and end on a tick."""
    return 1000 * math.ceil(1000.0 * seconds - 1e-9)


def coast(state: Node, velocity: Vector, dt_s: float, acceleration: Vector = _ZERO) -> Vector:
    """Where a vehicle ends whose velocity goes from the state's to `velocity` by a quintic within `dt_s`.

    Integral of the quintic Hermite polynomial from the state's v, a, j to `velocity`, `acceleration`, 0.
    """
    x, y, z = (
        state[i]
        + dt_s * (state[3 + i] + velocity[i]) / 2.0
        + dt_s**2 * (state[6 + i] - acceleration[i]) / 10.0
        + dt_s**3 * state[9 + i] / 120.0
        for i in range(3)
    )
    return (x, y, z)


def samples(nodes: Sequence[tuple[int, Node]], count: int) -> Iterator[tuple[Vector, Vector, Vector]]:
    """Position, velocity and acceleration at `count` moments of each piece through the nodes."""
    for (t0, node0), (t1, node1) in pairwise(nodes):
        dt_s = _duration_s(t0, t1)
        coefficients = septic_coefficients(dt_s, node0, node1)
        for k in range(1, count + 1):
            p, v, a, _, _ = septic_at(coefficients, dt_s * k / count)
            yield p, v, a


def eased(state: Node, dt_s: float) -> Node:
    """Return the node `dt_s` on at which acceleration and jerk are gone; the speed is what they made of
    it.
    """
    v = [state[3 + i] + dt_s * state[6 + i] / 2.0 + dt_s**2 * state[9 + i] / 12.0 for i in range(3)]
    velocity: Vector = (v[0], v[1], v[2])
    return (*coast(state, velocity, dt_s), *velocity, *_ZERO, *_ZERO)


def braked(state: Node, deceleration: float, room: Room, still: float = 1e-9) -> list[tuple[int, Node]]:
    """Nodes from the state to rest; the state alone where neither speed nor acceleration exceeds `still`.

    A stop sideways goes straight ahead; the one up or down takes its own time. Where one would lead out of
    the room, it brakes harder than `deceleration`, up to twice; where that is no help, as little as can be.
    """
    if math.hypot(*state[3:6]) <= still and math.hypot(*state[6:9]) <= still:
        return [(0, state)]
    sideways, down = (_within(_along(state, axes), deceleration, room, axes) for axes in (_SIDEWAYS, _DOWN))
    times = sorted({t_us for t_us, _ in (*sideways, *down)})
    return [(t_us, tuple(map(sum, zip(_at(sideways, t_us), _at(down, t_us), strict=True)))) for t_us in times]


def _along(state: Node, axes: Sequence[int]) -> Node:
    """Return the state's share of these axes, 0 for the others."""
    return tuple(x if k % 3 in axes else 0.0 for k, x in enumerate(state))


def _within(state: Node, deceleration: float, room: Room, axes: Sequence[int]) -> list[tuple[int, Node]]:
    """Return the gentlest stop that stays in the room along these axes, or no further out than it begins."""
    if not any(state[3:]):
        return [(0, state)]
    allowed = room.beyond(state, axes) + 1e-6
    best, least = [(0, state)], math.inf
    for nodes in _stops(state, deceleration):
        beyond = max(room.beyond(p, axes) for p, _, _ in samples(nodes, _SAMPLES))
        if beyond < least:
            best, least = nodes, beyond
        if beyond <= allowed:
            break
    return best


def _stops(state: Node, deceleration: float) -> Iterator[list[tuple[int, Node]]]:
    """Ways from the state to rest: the shortest that are gentle, then harder ones."""
    begun = [(0, state)]
    whole_s = _stop_s(state, deceleration)
    if any(state[6:12]):
        at_once = [*begun, _stopped(0, state, whole_s)]
        if _hardest(at_once) <= 1.01 * max(deceleration, math.hypot(*state[6:9])):
            yield at_once
        begun.append((seconds_us(EASE_S), eased(state, EASE_S)))
    t_us, node = begun[-1]
    for share in HARDER:
        yield [*begun, _stopped(t_us, node, share * _stop_s(node, deceleration))]
    for share in HARDER:
        yield [(0, state), _stopped(0, state, share * whole_s)]


def _stop_s(node: Node, deceleration: float) -> float:
    """Time of a stop that brakes no harder than `deceleration`, where nothing accelerates at its start."""
    return max(SHORTEST_STOP_S, QUINTIC_PEAK * math.hypot(*node[3:6]) / deceleration)


def _stopped(t_us: int, node: Node, dt_s: float) -> tuple[int, Node]:
    """Rest, `dt_s` after the node at `t_us`."""
    dt_us = seconds_us(dt_s)
    return t_us + dt_us, _rest(coast(node, _ZERO, dt_us * 1e-6))


def _hardest(nodes: Sequence[tuple[int, Node]]) -> float:
    """Greatest acceleration on the way through the nodes."""
    return max(math.hypot(*a) for _, _, a in samples(nodes, _SAMPLES))


def _at(nodes: Sequence[tuple[int, Node]], t_us: int) -> Node:
    """p, v, a, j at a time, on the way through the nodes or behind the last."""
    for (t0, node0), (t1, node1) in pairwise(nodes):
        if t_us < t1:
            p, v, a, j, _ = septic(_duration_s(t0, t1), 1e-6 * (t_us - t0), node0, node1)
            return (*p, *v, *a, *j)
    return nodes[-1][1]


def _turning(yaw: float, rate: float) -> list[tuple[int, float, float]]:
    """Yaw nodes from this yaw and rate to a yaw that is held."""
    if rate == 0.0:
        return [(0, yaw, 0.0)]
    return [(0, yaw, rate), (TURN_US, yaw + 0.5e-6 * TURN_US * rate, 0.0)]


def _position(node: Node) -> Vector:
    return (node[0], node[1], node[2])


def _at_rest(node: Node, yaw_rate: float) -> bool:
    speeds = zip((node[3:6], node[6:9], node[9:12]), REST, strict=True)
    return abs(yaw_rate) <= REST_YAW_RATE and all(math.hypot(*vector) <= bound for vector, bound in speeds)


def _below(p: Vector, depth: float) -> Vector:
    return (p[0], p[1], p[2] + depth)


def _rest(p: Vector) -> Node:
    return (*p, *_ZERO, *_ZERO, *_ZERO)


def _block(coefficients: Sequence[float]) -> memoryview:
    return memoryview(array("d", [0.0, *coefficients]))


def _duration_s(start_us: int, end_us: int) -> float:
    """Length of a piece. Raises ValueError where there is none."""
    if end_us <= start_us:
        raise ValueError("pieces must start one after the other, before the end")
    return (end_us - start_us) * 1e-6


def _yaw_pieces(
    yaw_nodes: Sequence[tuple[int, float, float]], first_us: int, end_us: int
) -> list[tuple[int, int, float, float, float, float]]:
    """Pieces (t0, t1, y0, r0, y1, r1) that cover first_us to end_us; held where there is no node."""
    rows = []
    start_us, start_yaw, _ = yaw_nodes[0]
    if start_us > first_us:
        rows.append((first_us, min(start_us, end_us), start_yaw, 0.0, start_yaw, 0.0))
    rows.extend((a[0], b[0], a[1], a[2], b[1], b[2]) for a, b in pairwise(yaw_nodes))
    last_us, last_yaw, _ = yaw_nodes[-1]
    if last_us < end_us:
        rows.append((max(last_us, first_us), end_us, last_yaw, 0.0, last_yaw, 0.0))
    return [row for row in rows if row[0] < end_us and row[1] > first_us]
