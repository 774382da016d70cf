"""How well each node of a reference fits its neighbours.

Nodes of one smooth path tell of each other: the polynomial of degree 7 through the states of both neighbours
passes close by the node between them. A node with one wrong number still makes a path that is continuous in
position, velocity, acceleration and jerk, but stands beside that polynomial.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from trimtab.firmware_model.law.reference import septic

SMOOTH_M_S2 = 0.25
"""Distance in acceleration that is let pass where nodes stand at most SMOOTH_S apart.

Twice the most that planned references show at 0.1 s, half of the error that must not pass.
"""
SMOOTH_S = 0.12
"""Beyond this spacing the bound grows with its square: what the path does in between counts ever more."""
SHARES = (0.25, 0.5, 1.0, 6.0)
"""Bounds of position, velocity, acceleration and jerk, as shares of the acceleration's times the spacing to
the power 2, 1, 0 and -1. Chosen so that a wrong number counts more at its own node than at its neighbours.
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
"""Greatest differences where one reference goes on with another: far above what float32 rounds away, below
what a controller notices.
"""


class Misfit(NamedTuple):
    """How far a node's `quantity` (index into QUANTITIES) is from what its neighbours say, in its unit."""

    node: int
    quantity: int
    value: float
    bound: float


def jumps(before: Sequence[float], after: Sequence[float]) -> tuple[float, ...]:
    """Return what two states (p, v, a, j, yaw, yaw rate) differ by, in the order of JUMPS, but for whole
    turns.
    """
    moves = [math.dist(before[k : k + 3], after[k : k + 3]) for k in (0, 3, 6, 9)]
    turn = math.remainder(after[12] - before[12], 2.0 * math.pi)
    return (*moves, abs(turn), abs(after[13] - before[13]))


def jump_text(found: Sequence[float]) -> tuple[str, float, float] | None:
    """Return the first of these `jumps` beyond its bound, for people, with value and bound; None where all
    pass.
    """
    for value, (quantity, bound, unit) in zip(found, JUMPS, strict=True):
        if not value <= bound:
            return f"{quantity} jumps by {value:.3g} at the swap, above {bound:.3g} {unit}", value, bound
    return None


def worst_misfit(nodes: Sequence[tuple[int, Sequence[float]]]) -> Misfit | None:
    """Return the worst misfit against its bound among the nodes (t_us, p, v, a, j), or None where two are
    all.

    The ends have one neighbour each and are not compared: what they hold shows at the node beside them.
    """
    worst: Misfit | None = None
    for k in range(1, len(nodes) - 1):
        (t0_us, state0), (t_us, state), (t1_us, state1) = nodes[k - 1 : k + 2]
        spacing_s = 0.5e-6 * (t1_us - t0_us)
        expected = septic(2.0 * spacing_s, (t_us - t0_us) * 1e-6, state0, state1)
        bound = SMOOTH_M_S2 * max(1.0, spacing_s / SMOOTH_S) ** 2 * spacing_s * spacing_s
        for quantity, share in enumerate(SHARES):
            wanted = expected[quantity]
            off = max(abs(state[3 * quantity + axis] - wanted[axis]) for axis in range(3))
            if worst is None or off * worst.bound > worst.value * share * bound:
                worst = Misfit(k, quantity, off, share * bound)
            bound /= spacing_s
    return worst
