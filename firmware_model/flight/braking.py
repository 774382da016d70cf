"""Braking: trajectories from a moving state to rest within a box.

Positions are in m, NED. A node is p, v, a, j, three values each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from trimtab.firmware_model.law.reference import septic, septic_at, septic_coefficients

Vector = tuple[float, float, float]
Node = tuple[float, ...]
"""p, v, a, j in NED, three values each."""

QUINTIC_PEAK = 15.0 / 8.0
"""Peak over mean acceleration of a velocity that follows a quintic."""
EASE_S = 0.4
"""Time in which a stop removes the initial acceleration before it removes the speed."""
STOP_MIN_S = 0.8
DURATION_FACTORS = (1.0, 0.85, 0.7, 0.6, 0.5)
"""Factors of the duration of a stop, tried in this order until the stop stays in the room."""
ZERO: Vector = (0.0, 0.0, 0.0)
_SIDEWAYS, _DOWN = (0, 1), (2,)
_SAMPLES = 8  # of a piece


class Room(NamedTuple):
    """Box in which a reference must stay, by two corners in NED."""

    low: Vector
    high: Vector

    def beyond(self, p: Sequence[float], axes: Sequence[int] = (0, 1, 2)) -> float:
        """Return the greatest distance (m) of a position from the box along these axes; 0 inside."""
        return max(0.0, *(max(p[i] - self.high[i], self.low[i] - p[i]) for i in axes))


def braked(state: Node, deceleration: float, room: Room, still: float = 1e-9) -> list[tuple[int, Node]]:
    """Return the nodes of a stop from `state`; only `state` if speed and acceleration are within `still`.

    The horizontal stop follows a straight line. The vertical stop has its own duration. A stop that would
    leave the room exceeds `deceleration`, up to twice. If that is not enough, it leaves the room by the least
    possible distance.
    """
    if math.hypot(*state[3:6]) <= still and math.hypot(*state[6:9]) <= still:
        return [(0, state)]
    sideways, down = (_within(_along(state, axes), deceleration, room, axes) for axes in (_SIDEWAYS, _DOWN))
    times = sorted({t_us for t_us, _ in (*sideways, *down)})
    return [(t_us, tuple(map(sum, zip(_at(sideways, t_us), _at(down, t_us), strict=True)))) for t_us in times]


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
    v = [state[3 + i] + dt_s * state[6 + i] / 2.0 + dt_s**2 * state[9 + i] / 12.0 for i in range(3)]
    velocity: Vector = (v[0], v[1], v[2])
    return (*coast(state, velocity, dt_s), *velocity, *ZERO, *ZERO)


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


def _along(state: Node, axes: Sequence[int]) -> Node:
    """Return the state along these axes, with 0 for the others."""
    return tuple(x if k % 3 in axes else 0.0 for k, x in enumerate(state))


def _within(state: Node, deceleration: float, room: Room, axes: Sequence[int]) -> list[tuple[int, Node]]:
    """Return the gentlest stop that leaves the room along these axes no further than its start."""
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
    """Yield stops from the state, gentle ones first."""
    start = [(0, state)]
    duration = _stop_s(state, deceleration)
    if any(state[6:12]):
        direct = [*start, _stopped(0, state, duration)]
        if _peak_acceleration(direct) <= 1.01 * max(deceleration, math.hypot(*state[6:9])):
            yield direct
        start.append((seconds_us(EASE_S), eased(state, EASE_S)))
    t_us, node = start[-1]
    for share in DURATION_FACTORS:
        yield [*start, _stopped(t_us, node, share * _stop_s(node, deceleration))]
    for share in DURATION_FACTORS:
        yield [(0, state), _stopped(0, state, share * duration)]


def _stop_s(node: Node, deceleration: float) -> float:
    """Return the duration (s) of a stop within `deceleration` that starts without acceleration."""
    return max(STOP_MIN_S, QUINTIC_PEAK * math.hypot(*node[3:6]) / deceleration)


def _stopped(t_us: int, node: Node, dt_s: float) -> tuple[int, Node]:
    """Return time and node of rest, `dt_s` after the node at `t_us`."""
    dt_us = seconds_us(dt_s)
    return t_us + dt_us, node_at_rest(coast(node, ZERO, dt_us * 1e-6))


def _peak_acceleration(nodes: Sequence[tuple[int, Node]]) -> float:
    """Return the greatest acceleration along the nodes."""
    return max(math.hypot(*a) for _, _, a in samples(nodes, _SAMPLES))


def _at(nodes: Sequence[tuple[int, Node]], t_us: int) -> Node:
    """Return p, v, a, j at a time along the nodes, or the last node after its time."""
    for (t0, node0), (t1, node1) in pairwise(nodes):
        if t_us < t1:
            p, v, a, j, _ = septic(duration_s(t0, t1), 1e-6 * (t_us - t0), node0, node1)
            return (*p, *v, *a, *j)
    return nodes[-1][1]
