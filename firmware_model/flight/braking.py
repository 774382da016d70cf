"""Braking: trajectories from a moving state to rest within a box.

Positions are in m, NED. A node is p, v, a, j, three values each. A stop consists of three pieces: a ramp of
the acceleration from that of the state to the deceleration, a constant deceleration, and a ramp to zero. On a
ramp the acceleration is a cubic Hermite polynomial, so every piece is a polynomial of degree 5 at most and
the septic between its nodes reproduces it exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.reference import septic, septic_at, septic_coefficients

Vector = tuple[float, float, float]
Node = tuple[float, ...]
"""p, v, a, j in NED, three values each."""
Timeline = list[tuple[int, Node]]
"""Nodes with their times in us."""

QUINTIC_PEAK = 15.0 / 8.0
"""Peak over mean acceleration of a velocity that follows a quintic."""
EASE_S = 0.4
"""Time in which a path to a setpoint removes the initial acceleration, where it has to."""
SIDEWAYS_RAMP_US = 300_000
"""Ramp of the acceleration of a horizontal stop, in which the vehicle tilts."""
VERTICAL_RAMP_US = 150_000
"""The same of a vertical stop, for which the thrust alone changes."""
HARDER = (1.0, 1.2, 1.45, 1.75, 2.1, 2.5, 3.0, 4.0, 6.0)
"""Factors of the gentle deceleration, tried in this order until the stop stays in the room."""
ZERO: Vector = (0.0, 0.0, 0.0)
_LEAST_LIFT = 0.1 * GRAVITY
_SIDEWAYS, _DOWN = (0, 1), (2,)
_SAMPLES = 8  # of a piece


class Room(NamedTuple):
    """Box in which a reference must stay, by two corners in NED."""

    low: Vector
    high: Vector

    def beyond(self, p: Sequence[float], axes: Sequence[int] = (0, 1, 2)) -> float:
        """Return the greatest distance (m) of a position from the box along these axes; 0 inside."""
        return max(0.0, *(max(p[i] - self.high[i], self.low[i] - p[i]) for i in axes))


class Brakes(NamedTuple):
    """Decelerations of a stop, m/s^2.

    gentle: where there is room. sideways, rising, sinking: greatest of a horizontal motion, of a climb and of
    a descent. tilt: greatest ratio of horizontal to vertical specific force.
    """

    gentle: float
    sideways: float
    rising: float
    sinking: float
    tilt: float

    def sideways_beside(self, rising: float) -> float:
        """Return the greatest horizontal deceleration while a climb is slowed down by `rising`."""
        return min(self.sideways, self.tilt * max(_LEAST_LIFT, GRAVITY - rising))

    def steps(self, hardest: float) -> list[float]:
        """Return the decelerations that a stop tries, in increasing order."""
        return sorted({min(factor * self.gentle, hardest) for factor in HARDER} | {hardest})

    def climb(self, rising: float, room: float) -> float:
        """Return the deceleration of a climb at this speed that stops within `room`, m; else the greatest."""
        steps = self.steps(self.rising)
        ramp_s = 1e-6 * VERTICAL_RAMP_US
        return next(
            (each for each in steps if rising * (0.5 * rising / each + 0.5 * ramp_s) <= room), steps[-1]
        )


def braked(state: Node, brakes: Brakes, room: Room, still: float = 1e-9) -> Timeline:
    """Return the nodes of a stop from `state`; only `state` if speed and acceleration are within `still`.

    The horizontal stop follows a straight line once its deceleration is reached. The vertical stop has its
    own duration. A stop that would leave the room is harder than gentle, up to the greatest deceleration. If
    that is not enough, it leaves the room by the least possible distance.
    """
    if math.hypot(*state[3:6]) <= still and math.hypot(*state[6:9]) <= still:
        return [(0, state)]
    rising = state[5] < 0.0
    hardest = brakes.rising if rising else brakes.sinking
    vertical, down = _gentlest(
        state,
        _DOWN,
        brakes.steps(hardest),
        lambda each: stopped(state, _DOWN, each, VERTICAL_RAMP_US),
        room,
    )
    beside = brakes.sideways_beside(vertical if rising else 0.0)
    _, sideways = _gentlest(
        state,
        _SIDEWAYS,
        brakes.steps(brakes.sideways),
        lambda each: _sideways(state, each, beside, down[-1][0]),
        room,
    )
    return merged(sideways, down)


def stopped(state: Node, axes: Sequence[int], deceleration: float, ramp_us: int) -> Timeline:
    """Return the nodes of a stop along these axes within `deceleration`, with 0 for the other axes."""
    start = along(state, axes)
    if not any(start[3:]):
        return [(0, start)]
    ramp_s = 1e-6 * ramp_us
    left = [start[3 + i] + ramp_s * (start[6 + i] / 2.0 + ramp_s * start[9 + i] / 12.0) for i in range(3)]
    speed = math.hypot(*left)  # that remains after a ramp to no acceleration
    hold_us = max(0, seconds_us(speed / deceleration) - ramp_us)
    deceleration = speed / (1e-6 * hold_us + ramp_s)
    a = [-deceleration * v / speed if speed else 0.0 for v in left]
    times, nodes = [0], [start]
    for duration_us, goal in ((ramp_us, a), (hold_us, a), (ramp_us, ZERO)):
        if duration_us:
            times.append(times[-1] + duration_us)
            nodes.append(_ramped(nodes[-1], goal, 1e-6 * duration_us))
    nodes[-1] = node_at_rest(position_of(nodes[-1]))
    return list(zip(times, nodes, strict=True))


def merged(*timelines: Timeline) -> Timeline:
    """Return the sum of timelines, each of which rests at 0 along the axes of the others."""
    times = sorted({t_us for timeline in timelines for t_us, _ in timeline})
    return [
        (t_us, tuple(map(sum, zip(*(_at(timeline, t_us) for timeline in timelines), strict=True))))
        for t_us in times
    ]


def samples(nodes: Sequence[tuple[int, Node]], count: int) -> Iterator[tuple[Vector, Vector, Vector]]:
    """Yield position, velocity and acceleration at `count` samples of each piece between the nodes."""
    for (t0, node0), (t1, node1) in pairwise(nodes):
        dt_s = duration_s(t0, t1)
        coefficients = septic_coefficients(dt_s, node0, node1)
        for k in range(1, count + 1):
            p, v, a, _, _ = septic_at(coefficients, dt_s * k / count)
            yield p, v, a


def coast(state: Node, velocity: Vector, dt_s: float, acceleration: Vector = ZERO) -> Vector:
    """Return the position after `dt_s` if the velocity follows a quintic from the state's to `velocity`.

    It is the integral of the quintic Hermite polynomial from v, a, j of the state to `velocity`,
    `acceleration`, 0.
    """
    x, y, z = (
        state[i]
        + dt_s * (state[3 + i] + velocity[i]) / 2.0
        + dt_s**2 * (state[6 + i] - acceleration[i]) / 10.0
        + dt_s**3 * state[9 + i] / 120.0
        for i in range(3)
    )
    return (x, y, z)


def eased(state: Node, dt_s: float) -> Node:
    """Return the node after `dt_s`, in which acceleration and jerk decay to 0."""
    return _ramped(state, ZERO, dt_s)


def along(state: Node, axes: Sequence[int]) -> Node:
    """Return the state along these axes, with 0 for the others."""
    return tuple(x if k % 3 in axes else 0.0 for k, x in enumerate(state))


def seconds_us(seconds: float) -> int:
    """Return microseconds, rounded up to whole milliseconds so that phases start and end on a tick."""
    return 1000 * math.ceil(1000.0 * seconds - 1e-9)


def duration_s(start_us: int, end_us: int) -> float:
    """Return the duration of a piece in s. Raises ValueError unless it is positive."""
    if end_us <= start_us:
        raise ValueError("pieces must start in increasing order and before the end")
    return (end_us - start_us) * 1e-6


def position_of(node: Node) -> Vector:
    """Return the position of a node."""
    return (node[0], node[1], node[2])


def node_at_rest(p: Vector) -> Node:
    """Return the node at rest at `p`."""
    return (*p, *ZERO, *ZERO, *ZERO)


def _gentlest(
    state: Node,
    axes: Sequence[int],
    decelerations: Sequence[float],
    stop: Callable[[float], Timeline],
    room: Room,
) -> tuple[float, Timeline]:
    """Return the first deceleration whose stop leaves the room no further than its start, and the stop.

    If there is none, return the one that leaves the room along these axes by the least distance.
    """
    allowed = room.beyond(state, axes) + 1e-6
    chosen, best, least = 0.0, [(0, along(state, axes))], math.inf
    for deceleration in decelerations:
        nodes = stop(deceleration)
        beyond = max((room.beyond(p, axes) for p, _, _ in samples(nodes, _SAMPLES)), default=0.0)
        if beyond < least:
            chosen, best, least = deceleration, nodes, beyond
        if beyond <= allowed:
            break
    return chosen, best


def _sideways(state: Node, deceleration: float, beside: float, until_us: int) -> Timeline:
    """Return the nodes of a horizontal stop by `deceleration`, but by `beside` at most until `until_us`."""
    if until_us <= SIDEWAYS_RAMP_US:  # it ends before the deceleration is reached
        beside = deceleration
    limited = stopped(state, _SIDEWAYS, min(deceleration, beside), SIDEWAYS_RAMP_US)
    if deceleration <= beside or len(limited) < 4 or limited[2][0] <= until_us:
        return limited
    node = _at(limited, until_us)
    rest = stopped(node, _SIDEWAYS, deceleration, SIDEWAYS_RAMP_US)
    return [*limited[:2], *((until_us + t_us, each) for t_us, each in rest)]


def _ramped(node: Node, acceleration: Sequence[float], dt_s: float) -> Node:
    """Return the node after a cubic ramp of the acceleration, which ends without jerk."""
    p = [
        node[i]
        + dt_s
        * (node[3 + i] + dt_s * (0.35 * node[6 + i] + 0.15 * acceleration[i] + 0.05 * dt_s * node[9 + i]))
        for i in range(3)
    ]
    v = [
        node[3 + i] + dt_s * ((node[6 + i] + acceleration[i]) / 2.0 + dt_s * node[9 + i] / 12.0)
        for i in range(3)
    ]
    return (*p, *v, *acceleration, *ZERO)


def _at(nodes: Timeline, t_us: int) -> Node:
    """Return p, v, a, j at a time along the nodes, or the last node after its time."""
    for (t0, node0), (t1, node1) in pairwise(nodes):
        if t_us < t1:
            p, v, a, j, _ = septic(duration_s(t0, t1), 1e-6 * (t_us - t0), node0, node1)
            return (*p, *v, *a, *j)
    return nodes[-1][1]
