"""Setpoints of a stream, and the track from the present reference to a setpoint.

Every setpoint of position or velocity becomes a short polynomial that starts at the present position,
velocity, acceleration and jerk of the reference, so the reference never jumps. It ends with the velocity and
acceleration that the setpoint gives. Without a newer setpoint the acceleration then ends within RENEWAL_S and
the velocity stays. If setpoints arrive at a constant rate, this filters the stream: a moving position is
followed with a delay of 0.29 s, or without delay if the setpoint includes its velocity. A setpoint of
position and velocity that moves is taken as a sample of a trajectory: its pieces may be shorter, so the
reference stays closer to the stream.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from trimtab.firmware_model.flight.braking import (
    EASE_S,
    QUINTIC_PEAK,
    SIDEWAYS_RAMP_US,
    Brakes,
    Node,
    Room,
    Timeline,
    Vector,
    along,
    braked,
    coast,
    eased,
    merged,
    samples,
    seconds_us,
    stopped,
)
from trimtab.firmware_model.flight.track import ENDLESS_US, SEPTIC_PEAK, Track, YawState, track

SHORTEST_S = 0.5
"""Shortest duration of a piece, also for small changes."""
SAMPLE_S = 0.25
"""The same to a sample of a trajectory. It is longer than ten setpoints at 50 Hz, so the jitter of their
arrival and a few lost ones hardly move the acceleration."""
SEPTIC_ACCEL = 7.52
"""Peak acceleration of a septic from rest to rest, times its duration squared over its distance."""
RENEWAL_S = 1.0
"""Time in which an acceleration ends without a newer setpoint."""
OVERSHOOT_M = 0.2
"""Greatest distance of a piece beyond its ends, in addition to the stopping distances there."""
_FIRST = 0.6  # of the duration from rest to rest: a moving vehicle needs less time
_STRETCH = 1.15
_STRETCHES = 12
_SAMPLES = 12

Axes = tuple[float | None, float | None, float | None]


@dataclass(frozen=True, kw_only=True)
class PositionTarget:
    """Target position and velocity. Each axis has at least one of the two; the other may be None.

    p, v, a: NED, SI. ahead: whether v and a are forward, right and down relative to the heading instead. yaw
    (rad), yaw_rate (rad/s): None if not given; without both the present yaw is held.
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
    def is_sample(self) -> bool:
        """Whether the target is a sample of a trajectory: position and velocity of all axes, in motion."""
        return None not in (*self.p, *self.v) and not self.is_stationary

    @property
    def is_stationary(self) -> bool:
        """Whether the target is a fixed position without motion."""
        still = all(not v for v in self.v) and not any(self.a) and not self.yaw_rate
        return still and all(p is not None for p in self.p)


@dataclass(frozen=True, kw_only=True)
class AttitudeTarget:
    """Target thrust with body rate or attitude.

    thrust: collective thrust as a share of the greatest thrust of all rotors. rate: body rate (rad/s, FRD).
    q: attitude q_ned_frd, a unit quaternion, w first; the rate is then added. None: body rate only.
    """

    thrust: float
    rate: Vector
    q: tuple[float, float, float, float] | None = None


Target = PositionTarget | AttitudeTarget


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Bounds of setpoints: room, speed (m/s), acceleration (m/s^2) and yaw rates (rad/s).

    brakes: decelerations of a stop. turn_rate: greatest yaw rate of a turn to a new yaw.
    """

    room: Room
    speed: float
    accel: float
    brakes: Brakes
    yaw_rate: float
    turn_rate: float


def to_ned(target: PositionTarget, yaw: float) -> PositionTarget:
    """Return the target in NED for a vehicle with this yaw."""
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


def climb_only(target: PositionTarget, state: Node) -> PositionTarget:
    """Return a target in NED reduced to its height, for a vehicle that may only climb from its state."""
    return replace(
        target,
        p=(state[0], state[1], target.p[2]),
        v=(None, None, target.v[2]),
        a=(0.0, 0.0, target.a[2]),
    )


def levelled(target: AttitudeTarget, yaw: float) -> AttitudeTarget:
    """Return the target without tilt, for a vehicle close above the floor.

    Its heading, yaw rate and thrust stay. A target without attitude keeps this yaw.
    """
    w, z = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    if target.q is not None and (target.q[0] or target.q[3]):
        w, z = target.q[0], target.q[3]
    length = math.hypot(w, z)
    return replace(target, q=(w / length, 0.0, 0.0, z / length), rate=(0.0, 0.0, target.rate[2]))


def towards(target: PositionTarget, state: Node, yaw: YawState, bounds: Bounds) -> tuple[Track, bool]:
    """Return the track from the reference state (p, v, a, j) to the target, and whether bounds changed it.

    The track continues without end. A velocity stops at the wall of the room, or just above the floor, with
    or without a newer setpoint. `target.ahead` must be False; `to_ned` converts such a target.
    """
    goal, goal_v = _bounded_goal(target, state, bounds)
    shortest_s = SAMPLE_S if target.is_sample else SHORTEST_S
    nodes = _nodes(goal, goal_v, target.a, state, bounds, shortest_s)
    t_us, end = nodes[-1]
    end_us = t_us + ENDLESS_US
    nodes += [(t_us + after_us, node) for after_us, node in _to_wall(end, bounds)[1:]]
    last_us, last = nodes[-1]
    if last_us < end_us:
        nodes.append((end_us, last))
    bounded = goal != target.p or any(
        abs(v - (w or 0.0)) > 1e-6 for v, w in zip(goal_v, target.v, strict=True)
    )
    return track(nodes, _turn(target, yaw, end_us, bounds)), bounded


def _to_wall(state: Node, bounds: Bounds) -> Timeline:
    """Return a flight at this velocity, soon without acceleration, that stops each axis at the wall."""
    if not any(state[3:9]):
        return [(0, state)]
    return merged(*(_axis_to_wall(along(state, (i,)), i, bounds) for i in range(3)))


def _axis_to_wall(state: Node, axis: int, bounds: Bounds) -> Timeline:
    """Return the same along one axis, with 0 for the others.

    An acceleration ends within RENEWAL_S, or in a stop if there is no room for that.
    """
    if state[6 + axis]:
        velocity: Vector = (state[3], state[4], state[5])
        later = _moving(coast(state, velocity, RENEWAL_S), velocity)
        if _room_to_stop(later, axis, bounds) < 0.0 or bounds.room.beyond(later, (axis,)) > 0.0:
            return stopped(state, (axis,), bounds.accel, SIDEWAYS_RAMP_US)
        rest = _axis_to_wall(later, axis, bounds)
        return [(0, state), *((seconds_us(RENEWAL_S) + t_us, node) for t_us, node in rest)]
    v = state[3 + axis]
    if not v:
        return [(0, state)]
    stop = stopped(state, (axis,), bounds.accel, SIDEWAYS_RAMP_US)
    coast_s = max(0.0, _room_to_stop(state, axis, bounds)) / abs(v)  # from here to where the stop begins
    coast_us = 1000 * math.floor(1000.0 * min(coast_s, 1e-6 * ENDLESS_US))
    if not coast_us:
        return stop
    shift = 1e-6 * coast_us * v
    moved = [(coast_us + t_us, _shifted(node, axis, shift)) for t_us, node in stop]
    return [(0, state), *(moved if coast_us < ENDLESS_US else moved[:1])]


def _room_to_stop(state: Node, axis: int, bounds: Bounds) -> float:
    """Return how far before the wall a stop that begins now ends, m; 0 for a state at rest."""
    v = state[3 + axis]
    if not v:
        return 0.0
    end = stopped(state, (axis,), bounds.accel, SIDEWAYS_RAMP_US)[-1][1][axis]
    return bounds.room.high[axis] - end if v > 0.0 else end - bounds.room.low[axis]


def _shifted(node: Node, axis: int, distance: float) -> Node:
    return (*node[:axis], node[axis] + distance, *node[axis + 1 :])


def _nodes(
    goal: Axes, goal_v: Vector, accel: Vector, state: Node, bounds: Bounds, shortest_s: float
) -> list[tuple[int, Node]]:
    """Return nodes from the state to the goal.

    They reach the goal in one piece if possible; else after the acceleration has decayed; else after a stop.
    If all of these fail, the vehicle stays at the stop.
    """
    fixed: list[tuple[int, Node]] = []
    start = [(0, state)]
    for fixed, start in _starts(state, bounds):
        t_us, node = start[-1]
        duration = _initial_duration_s(goal, goal_v, node, bounds, shortest_s)
        for _ in range(_STRETCHES):
            end = _end(goal, goal_v, accel, node, duration, bounds)
            nodes = [*start, (t_us + seconds_us(duration), end)]
            if _within_bounds(nodes, bounds):
                return [*fixed, *nodes]
            duration *= _STRETCH
    t_us, node = start[-1]
    return [*fixed, *start, (t_us + seconds_us(shortest_s), node)]


def _starts(state: Node, bounds: Bounds) -> Iterator[tuple[list[tuple[int, Node]], list[tuple[int, Node]]]]:
    """Yield the fixed first nodes of a path, and the nodes from which it continues to the goal."""
    yield [], [(0, state)]
    yield [], [(0, state), (seconds_us(EASE_S), eased(state, EASE_S))]
    stop = braked(state, bounds.brakes, bounds.room)
    yield stop[:-1], stop[-1:]


def _bounded_goal(target: PositionTarget, state: Node, bounds: Bounds) -> tuple[Axes, Vector]:
    """Return the requested positions and velocities, limited to the room and the greatest speed."""
    goal_v = [v or 0.0 for v in target.v]
    speed = math.hypot(*goal_v)
    if speed > bounds.speed:
        goal_v = [v * bounds.speed / speed for v in goal_v]
    goal: list[float | None] = []
    for i, (p, low, high) in enumerate(zip(target.p, *bounds.room, strict=True)):
        x = None if p is None else min(max(p, low), high)
        goal.append(x)
        here = state[i] if x is None else x
        goal_v[i] = min(max(goal_v[i], -_speed_limit(here - low, bounds)), _speed_limit(high - here, bounds))
    return (goal[0], goal[1], goal[2]), (goal_v[0], goal_v[1], goal_v[2])


def _speed_limit(distance: float, bounds: Bounds) -> float:
    """Return the greatest speed for a stop within a distance, after some flight without a new setpoint."""
    return max(0.0, min(math.sqrt(0.5 * bounds.accel * max(distance, 0.0)), distance))


def _initial_duration_s(
    goal: Axes, velocity: Vector, state: Node, bounds: Bounds, shortest_s: float
) -> float:
    """Return the duration at which the search for the shortest piece within the bounds starts."""
    distance = math.hypot(*(0.0 if x is None else x - state[i] for i, x in enumerate(goal)))
    change = math.hypot(*(velocity[i] - state[3 + i] for i, x in enumerate(goal) if x is None))
    return max(
        shortest_s,
        _FIRST * SEPTIC_PEAK * distance / bounds.speed,
        _FIRST * math.sqrt(SEPTIC_ACCEL * distance / bounds.accel),
        _FIRST * QUINTIC_PEAK * change / bounds.accel,
    )


def _end(goal: Axes, velocity: Vector, accel: Vector, state: Node, length_s: float, bounds: Bounds) -> Node:
    """Return the node at the end of a piece: the goal moved on as the setpoint states, within the bounds."""
    size = math.hypot(*accel)
    scale = min(1.0, bounds.accel / size) if size else 1.0
    a = [scale * x for x in accel]
    v = [w + b * length_s for w, b in zip(velocity, a, strict=True)]
    speed = math.hypot(*v)
    if speed > bounds.speed:
        v = [x * bounds.speed / speed for x in v]
    p = [
        here if x is None else x + (w + 0.5 * b * length_s) * length_s
        for here, x, w, b in zip(_coasted(state, v, length_s, a), goal, velocity, a, strict=True)
    ]
    for i, (low, high) in enumerate(zip(*bounds.room, strict=True)):
        if goal[i] is not None and not low <= p[i] <= high:
            p[i], v[i], a[i] = min(max(p[i], low), high), 0.0, 0.0
            continue
        limited = min(max(v[i], -_speed_limit(p[i] - low, bounds)), _speed_limit(high - p[i], bounds))
        if limited != v[i]:
            v[i], a[i] = limited, 0.0
            if goal[i] is None:
                p[i] = _coasted(state, v, length_s, a)[i]
    return (*p, *v, *a, 0.0, 0.0, 0.0)


def _coasted(state: Node, v: Sequence[float], length_s: float, a: Sequence[float]) -> Vector:
    return coast(state, (v[0], v[1], v[2]), length_s, (a[0], a[1], a[2]))


def _within_bounds(nodes: Sequence[tuple[int, Node]], bounds: Bounds) -> bool:
    """Return whether a path stays within speed, acceleration, room and the permitted overshoot.

    Where a node exceeds a bound, its value is the bound instead.
    """
    state, end = nodes[0][1], nodes[-1][1]
    speed_max = max(bounds.speed, *(math.hypot(*node[3:6]) for _, node in nodes)) * 1.001 + 1e-6
    accel_max = max(bounds.accel, *(math.hypot(*node[6:9]) for _, node in nodes)) * 1.001 + 1e-6
    beyond = bounds.room.beyond(state) + 1e-3
    corridor = Room(*(_corridor_corner(state, end, side, bounds) for side in (-1.0, 1.0)))
    return all(
        math.hypot(*v) <= speed_max
        and math.hypot(*a) <= accel_max
        and bounds.room.beyond(p) <= beyond
        and corridor.beyond(p) <= 0.0
        for p, v, a in samples(nodes, _SAMPLES)
    )


def _corridor_corner(state: Node, end: Node, side: float, bounds: Bounds) -> Vector:
    """Return the corner on this side (-1 or 1) of the box in which a path from `state` to `end` must stay."""
    corner = []
    for i in range(3):
        start_speed = max(0.0, side * (state[3 + i] + 0.5 * EASE_S * state[6 + i]))
        end_speed = max(0.0, -side * end[3 + i])
        start_stop = side * state[i] + start_speed**2 / bounds.accel
        end_stop = side * end[i] + end_speed**2 / bounds.accel
        corner.append(side * (max(start_stop, end_stop) + OVERSHOOT_M))
    return (corner[0], corner[1], corner[2])


def _moving(p: Vector, velocity: Vector) -> Node:
    return (*p, *velocity, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _turn(
    target: PositionTarget, yaw: YawState, end_us: int, bounds: Bounds
) -> list[tuple[int, float, float]]:
    """Return yaw nodes from this yaw and rate to those of the target."""
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
