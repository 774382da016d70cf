"""Consistency of each node of a reference with its neighbours.

On a smooth path the polynomial of degree 7 through the states of two nodes passes close to the node between
them. A node with one wrong number still yields a path that is continuous in position, velocity, acceleration
and jerk, but it deviates from that polynomial.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeAlias

from trimtab.firmware_model.law.ops import FLOAT, Ops, Scalar, Vector
from trimtab.firmware_model.law.reference import septic

SMOOTH_M_S2 = 0.25
"""Bound of the deviation in acceleration if nodes are at most SMOOTH_S apart.

It is twice the greatest deviation of planned references at 0.1 s, and half of the error to be detected.
"""
SMOOTH_S = 0.12
"""Spacing of nodes beyond which the bound grows with the square of the spacing."""
SHARES = (0.25, 0.5, 1.0, 6.0)
"""Bounds of position, velocity, acceleration and jerk, as factors of the bound in acceleration times the
spacing to the power 2, 1, 0 and -1. With these, a wrong number has a greater effect at its own node than at
its neighbours.
"""
QUANTITIES = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2"), ("jerk", "m/s^3"))

JUMPS = (
    ("position", 1e-3, "m"),
    ("velocity", 5e-3, "m/s"),
    ("acceleration", 5e-2, "m/s^2"),
    ("jerk", 1.0, "m/s^3"),
    ("yaw", 2e-3, "rad"),
    ("yaw rate", 1e-2, "rad/s"),
)
"""Greatest jumps at a swap from one reference to another: far above the rounding of float32, and too small to
affect a controller.
"""


class Misfit(NamedTuple):
    """Deviation of a node from its neighbours' polynomial. quantity: index into QUANTITIES."""

    node: int
    quantity: int
    value: float
    bound: float


class Neighbours(NamedTuple):
    """A node between its neighbours: their distance in time, the node's time after the first, the states."""

    dt_s: Scalar
    s_s: Scalar
    state0: Vector
    state: Vector
    state1: Vector


Deviations: TypeAlias = Callable[[Sequence[Neighbours]], Iterable[Sequence[float]]]
"""Returns the deviations of many nodes, as of `deviations`."""


def jumps(before: Sequence[float], after: Sequence[float]) -> tuple[float, ...]:
    """Return the differences of two states (p, v, a, j, yaw, yaw rate) in the order of JUMPS.

    Yaw is compared modulo 2 pi.
    """
    distances = [math.dist(before[k : k + 3], after[k : k + 3]) for k in (0, 3, 6, 9)]
    turn = math.remainder(after[12] - before[12], 2.0 * math.pi)
    return (*distances, abs(turn), abs(after[13] - before[13]))


def jump_text(values: Sequence[float]) -> tuple[str, float, float] | None:
    """Return text, value and bound of the first of these `jumps` beyond its bound; None if all are within."""
    for value, (quantity, bound, unit) in zip(values, JUMPS, strict=True):
        if not value <= bound:
            return f"{quantity} jumps by {value:.3g} at the swap, above {bound:.3g} {unit}", value, bound
    return None


def deviations(ops: Ops, neighbours: Neighbours) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Return a node's greatest deviations over the axes, in the order of QUANTITIES.

    They are those from the polynomial through its neighbours.
    """
    dt_s, s_s, state0, state, state1 = neighbours
    position, velocity, acceleration, jerk, _ = septic(dt_s, s_s, state0, state1)

    def greatest(first: int, expected: Vector) -> Scalar:
        x, y, z = (abs(state[first + axis] - expected[axis]) for axis in range(3))
        return ops.maximum(ops.maximum(x, y), z)

    return greatest(0, position), greatest(3, velocity), greatest(6, acceleration), greatest(9, jerk)


def deviations_one_by_one(nodes: Sequence[Neighbours]) -> Iterable[Sequence[float]]:
    """Return the `deviations` of each node, in floats."""
    return (deviations(FLOAT, neighbours) for neighbours in nodes)


def worst_misfit(
    nodes: Sequence[tuple[int, Sequence[float]]], evaluate: Deviations = deviations_one_by_one
) -> Misfit | None:
    """Return the misfit that is greatest relative to its bound, or None if there are only two nodes.

    nodes: (t_us, p, v, a, j). The first and the last node have only one neighbour and are not compared; an
    error there shows at the adjacent node.
    """
    worst: Misfit | None = None
    spacings_s = [0.5e-6 * (after[0] - before[0]) for before, after in zip(nodes, nodes[2:], strict=False)]
    inner = [
        Neighbours(2.0 * spacing_s, (t_us - t0_us) * 1e-6, state0, state, state1)
        for spacing_s, (t0_us, state0), (t_us, state), (_, state1) in zip(
            spacings_s, nodes, nodes[1:], nodes[2:], strict=False
        )
    ]
    for k, (spacing_s, values) in enumerate(zip(spacings_s, evaluate(inner), strict=True), start=1):
        bound = SMOOTH_M_S2 * max(1.0, spacing_s / SMOOTH_S) ** 2 * spacing_s * spacing_s
        for quantity, (deviation, share) in enumerate(zip(values, SHARES, strict=True)):
            if worst is None or deviation * worst.bound > worst.value * share * bound:
                worst = Misfit(k, quantity, deviation, share * bound)
            bound /= spacing_s
    return worst
