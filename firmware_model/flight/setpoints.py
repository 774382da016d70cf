"""Setpoints of a stream: what they may say, and the way from the present reference to what one asks for.

Every setpoint of position or velocity becomes a short polynomial that begins in the reference's present
position, velocity, acceleration and jerk, so that the reference never steps; where no newer one comes, it
goes on as the setpoint says. Repeated at a steady rate this filters the stream: a position that moves is
followed 0.29 s late, or without delay where its velocity is given too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from trimtab.firmware_model.flight.braking import (
    EASE_S,
    QUINTIC_PEAK,
    Node,
    Room,
    Vector,
    braked,
    coast,
    eased,
    samples,
    seconds_us,
)
from trimtab.firmware_model.flight.track import ENDLESS_US, SEPTIC_PEAK, Track, YawState, track

SHORTEST_S = 0.5
"""Least length of a piece; a setpoint lasts as long as that even where it asks for little."""
SEPTIC_ACCEL = 7.52
"""Greatest acceleration of a septic from rest to rest, times its length squared over its way."""
RENEWAL_S = 1.0
"""Time in which an acceleration ends that no newer setpoint renews."""
ASIDE_M = 0.2
"""How far a piece may swing out beyond both its ends and beyond what a stop takes."""
_FIRST = 0.6  # of the time that rest to rest would take: who moves already needs less
_STRETCH = 1.15
_STRETCHES = 12
_SAMPLES = 12

Axes = tuple[float | None, float | None, float | None]


@dataclass(frozen=True, kw_only=True)
class PositionTarget:
    """Position and velocity by axis, None where not given; each axis has at least one of the two.

    NED, m and SI; `ahead`: velocity and acceleration are forward, right, down of the vehicle's heading.
    yaw (rad) and yaw_rate (rad/s): None where not given; without either, the present yaw is held.
    """

    p: Axes
    v: Axes
    a: Vector = (0.0, 0.0, 0.0)
    yaw: float | None = None
    yaw_rate: float | None = None
    ahead: bool = False

    def __post_init__(self) -> None:
        if any(p is None and v is None for p, v in zip(self.p, self.v, strict=True)):
            raise ValueError("an axis needs a position or a velocity")

    @property
    def rests(self) -> bool:
        """Whether it names one place to stay at."""
        still = all(not v for v in self.v) and not any(self.a) and not self.yaw_rate
        return still and all(p is not None for p in self.p)


@dataclass(frozen=True, kw_only=True)
class AttitudeTarget:
    """thrust: collective, as a share of all rotors' greatest. rate (rad/s, FRD).

    q: attitude q_ned_frd, a unit quaternion, w first; the rate then comes on top. None: rate alone.
    """

    thrust: float
    rate: Vector
    q: tuple[float, float, float, float] | None = None


Target = PositionTarget | AttitudeTarget


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """What setpoints are kept within: a room, speed (m/s), acceleration (m/s^2), yaw rates (rad/s).

    turn_rate: greatest yaw rate of the turn to a new yaw.
    """

    room: Room
    speed: float
    accel: float
    yaw_rate: float
    turn_rate: float


def turned(target: PositionTarget, yaw: float) -> PositionTarget:
    """Return the same in NED for a vehicle that heads this way."""
    if not target.ahead:
        return target
    c, s = math.cos(yaw), math.sin(yaw)
    (vx, vy, vz), (ax, ay, az) = (tuple(x or 0.0 for x in axes) for axes in (target.v, target.a))
    return replace(
        target,
        v=(c * vx - s * vy, s * vx + c * vy, vz),
        a=(c * ax - s * ay, s * ax + c * ay, az),
        ahead=False,
    )


def upwards(target: PositionTarget, state: Node) -> PositionTarget:
    """Return what is left of a target in NED where the vehicle may only rise from here (p, v, a, j): the
    height.
    """
    return replace(
        target,
        p=(state[0], state[1], target.p[2]),
        v=(None, None, target.v[2]),
        a=(0.0, 0.0, target.a[2]),
    )


def towards(target: PositionTarget, state: Node, yaw: YawState, bounds: Bounds) -> tuple[Track, bool]:
    """Return the track from the reference state (p, v, a, j) to the target and on, and whether bounds
    changed it.

    It has no end of its own. `target.ahead` is for whoever knows the heading: here it must be False.
    """
    aims, asked = _aims(target, state, bounds)
    nodes = _nodes(aims, asked, target.a, state, bounds)
    t_us, end = nodes[-1]
    velocity: Vector = (end[3], end[4], end[5])
    if any(end[6:9]):
        t_us += seconds_us(RENEWAL_S)
        end = _moving(coast(end, velocity, RENEWAL_S), velocity)
        nodes.append((t_us, end))
    far = ENDLESS_US * 1e-6
    p: Vector = (end[0] + far * end[3], end[1] + far * end[4], end[2] + far * end[5])
    nodes.append((t_us + ENDLESS_US, _moving(p, velocity)))
    bounded = aims != target.p or any(
        abs(v - (w or 0.0)) > 1e-6 for v, w in zip(asked, target.v, strict=True)
    )
    return track(nodes, _turn(target, yaw, t_us + ENDLESS_US, bounds)), bounded


def _nodes(aims: Axes, asked: Vector, accel: Vector, state: Node, bounds: Bounds) -> list[tuple[int, Node]]:
    """Return nodes from the state to the setpoint's goal.

    They lead there in one piece if possible; else after the acceleration has faded; else after a stop. At
    worst the vehicle stays at the stop.
    """
    sure: list[tuple[int, Node]] = []
    begun = [(0, state)]
    for sure, begun in _beginnings(state, bounds):
        t_us, node = begun[-1]
        length_s = _length_s(aims, asked, node, bounds)
        for _ in range(_STRETCHES):
            end = _end(aims, asked, accel, node, length_s, bounds)
            nodes = [*begun, (t_us + seconds_us(length_s), end)]
            if _gentle(nodes, bounds):
                return [*sure, *nodes]
            length_s *= _STRETCH
    t_us, node = begun[-1]
    return [*sure, *begun, (t_us + seconds_us(SHORTEST_S), node)]


def _beginnings(
    state: Node, bounds: Bounds
) -> Iterator[tuple[list[tuple[int, Node]], list[tuple[int, Node]]]]:
    """Yield nodes that are flown in any case, and the nodes from which a way to the goal starts."""
    yield [], [(0, state)]
    yield [], [(0, state), (seconds_us(EASE_S), eased(state, EASE_S))]
    stop = braked(state, bounds.accel, bounds.room)
    yield stop[:-1], stop[-1:]


def _aims(target: PositionTarget, state: Node, bounds: Bounds) -> tuple[Axes, Vector]:
    """Return the requested positions and velocities, within the box and the speed limit."""
    wanted = [v or 0.0 for v in target.v]
    speed = math.hypot(*wanted)
    if speed > bounds.speed:
        wanted = [v * bounds.speed / speed for v in wanted]
    aims: list[float | None] = []
    for i, (p, low, high) in enumerate(zip(target.p, *bounds.room, strict=True)):
        aim = None if p is None else min(max(p, low), high)
        aims.append(aim)
        here = state[i] if aim is None else aim
        wanted[i] = min(max(wanted[i], -_speed_left(here - low, bounds)), _speed_left(high - here, bounds))
    return (aims[0], aims[1], aims[2]), (wanted[0], wanted[1], wanted[2])


def _speed_left(way: float, bounds: Bounds) -> float:
    """Greatest speed at which a stop ends within this way, some of it flown while no setpoint comes."""
    return max(0.0, min(math.sqrt(0.5 * bounds.accel * max(way, 0.0)), way))


def _length_s(aims: Axes, velocity: Vector, state: Node, bounds: Bounds) -> float:
    """Length that the search for the shortest gentle piece begins with."""
    way = math.hypot(*(0.0 if aim is None else aim - state[i] for i, aim in enumerate(aims)))
    change = math.hypot(*(velocity[i] - state[3 + i] for i, aim in enumerate(aims) if aim is None))
    return max(
        SHORTEST_S,
        _FIRST * SEPTIC_PEAK * way / bounds.speed,
        _FIRST * math.sqrt(SEPTIC_ACCEL * way / bounds.accel),
        _FIRST * QUINTIC_PEAK * change / bounds.accel,
    )


def _end(aims: Axes, velocity: Vector, accel: Vector, state: Node, length_s: float, bounds: Bounds) -> Node:
    """Return the node at the end of a piece: the aims have moved on as the setpoint says, within the
    bounds.
    """
    size = math.hypot(*accel)
    most = min(1.0, bounds.accel / size) if size else 1.0
    a = [most * x for x in accel]
    v = [w + b * length_s for w, b in zip(velocity, a, strict=True)]
    speed = math.hypot(*v)
    if speed > bounds.speed:
        v = [x * bounds.speed / speed for x in v]
    p = [
        here if aim is None else aim + (w + 0.5 * b * length_s) * length_s
        for here, aim, w, b in zip(_coasted(state, v, length_s, a), aims, velocity, a, strict=True)
    ]
    for i, (low, high) in enumerate(zip(*bounds.room, strict=True)):
        if aims[i] is None:
            within = min(max(v[i], -_speed_left(p[i] - low, bounds)), _speed_left(high - p[i], bounds))
            if within != v[i]:
                v[i], a[i] = within, 0.0
                p[i] = _coasted(state, v, length_s, a)[i]
        elif not low <= p[i] <= high:
            p[i], v[i], a[i] = min(max(p[i], low), high), 0.0, 0.0
    return (*p, *v, *a, 0.0, 0.0, 0.0)


def _coasted(state: Node, v: Sequence[float], length_s: float, a: Sequence[float]) -> Vector:
    return coast(state, (v[0], v[1], v[2]), length_s, (a[0], a[1], a[2]))


def _gentle(nodes: Sequence[tuple[int, Node]], bounds: Bounds) -> bool:
    """Whether the way stays within speed, acceleration and room, or within those of its nodes, and swings out
    no further than it has to.
    """
    state, end = nodes[0][1], nodes[-1][1]
    fastest = max(bounds.speed, *(math.hypot(*node[3:6]) for _, node in nodes)) * 1.001 + 1e-6
    hardest = max(bounds.accel, *(math.hypot(*node[6:9]) for _, node in nodes)) * 1.001 + 1e-6
    beyond = bounds.room.beyond(state) + 1e-3
    swing = Room(*(_swing(state, end, side, bounds) for side in (-1.0, 1.0)))
    return all(
        math.hypot(*v) <= fastest
        and math.hypot(*a) <= hardest
        and bounds.room.beyond(p) <= beyond
        and swing.beyond(p) <= 0.0
        for p, v, a in samples(nodes, _SAMPLES)
    )


def _swing(state: Node, end: Node, side: float, bounds: Bounds) -> Vector:
    """How far a way from the state to the end may lead to this side (-1 or 1) of both, by axis."""
    least = []
    for i in range(3):
        on = max(0.0, side * (state[3 + i] + 0.5 * EASE_S * state[6 + i]))
        off = max(0.0, -side * end[3 + i])
        out = max(side * state[i] + on**2 / bounds.accel, side * end[i] + off**2 / bounds.accel)
        least.append(side * (out + ASIDE_M))
    return (least[0], least[1], least[2])


def _moving(p: Vector, velocity: Vector) -> Node:
    return (*p, *velocity, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _turn(
    target: PositionTarget, yaw: YawState, end_us: int, bounds: Bounds
) -> list[tuple[int, float, float]]:
    """Yaw nodes from this yaw and rate to the target's."""
    now, rate = yaw
    final = min(max(target.yaw_rate or 0.0, -bounds.yaw_rate), bounds.yaw_rate)
    if target.yaw is None:
        t_s = SHORTEST_S
        reached = now + 0.5 * (rate + final) * t_s
    else:
        turn = math.remainder(target.yaw - now, 2.0 * math.pi)
        t_s = max(SHORTEST_S, QUINTIC_PEAK * abs(turn) / bounds.turn_rate)
        reached = now + turn + final * t_s
    t_us = seconds_us(t_s)
    nodes = [(0, now, rate), (t_us, reached, final)]
    if final:
        nodes.append((end_us, reached + final * (end_us - t_us) * 1e-6, final))
    return nodes
