"""A heading that the solver chooses: the models that allow it, and its yaw nodes in a reference."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from trimtab.firmware_model.law.reference import cubic_at, cubic_coefficients
from trimtab.firmware_model.law.rotations import euler_rates
from trimtab.host.base.errors import UsageError
from trimtab.host.codegen import NUMPY
from trimtab.host.models.airframe import RATE, THETA, P, Part, V
from trimtab.host.models.dynamics import rigid_body
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.shooting.problem import Solution
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import YawNode

SPACING_US = 50_000
"""Least distance of yaw nodes; for closer ones float32 spoils the yaw acceleration."""
_TURN = 1.0
_STATE = (0.3, -0.2, -1.4, 1.3, -0.8, 0.4, 0.15, -0.25, 0.2, 0.4, -0.3, 0.6)
"""A state of flight and a heading to turn it by, which show effects that are fixed to the world."""
_SAME = 1e-9


def check_turnable(dynamics: Dynamics, source: str) -> None:
    """Raise UsageError for a model that is not the same for every heading.

    Effects that only moved within their tolerance may be fixed to the world. source: names the route.
    """
    model = dynamics.model
    rule = f"{source}: yaw.free: needs a model that is the same for every heading"
    if model.network is not None and model.network.layout.frame != "body":
        raise UsageError(
            f"{rule}, its network is in the world's frame; learn one in the body's (trimtab learn --frame "
            "body) or give the heading"
        )
    parts = [part for part in model.parts if part[0].name not in model.adjusted]
    if not _turn(dynamics.vehicle, parts):
        names = [
            effect.name
            for k, (effect, _) in enumerate(parts)
            if _turn(dynamics.vehicle, parts[:k] + parts[k + 1 :])
        ]
        fixed = " with ".join(names or [effect.name for effect, _ in parts])
        raise UsageError(f"{rule}, {fixed} is fixed to the world; give the heading")


def _turn(vehicle: Vehicle, parts: Sequence[Part]) -> bool:
    """Return whether effects turn with the vehicle: compare its accelerations at a state and at it turned."""
    cos, sin = np.cos(_TURN), np.sin(_TURN)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    x = np.array([*_STATE, *np.linspace(0.2, 0.35, 4) * vehicle.thrust_max_n])
    turned = x.copy()
    turned[P], turned[V], turned[THETA.stop - 1] = turn @ x[P], turn @ x[V], x[THETA.stop - 1] + _TURN
    here, there = (np.array(rigid_body(NUMPY, vehicle, parts, list(at)), dtype=float) for at in (x, turned))
    same = np.allclose(turn @ here[V], there[V], rtol=0.0, atol=_SAME)
    return bool(same and np.allclose(here[RATE], there[RATE], rtol=0.0, atol=_SAME))


def yaw_nodes(solution: Solution) -> tuple[YawNode, ...]:
    """Return the heading of a solution at its nodes, or at nodes that are at least 50 ms apart.

    Between nodes the thrusts change linearly, and the heading is close enough to a cubic for cubic pieces.
    """
    times = np.rint(solution.t_s * 1e6).astype(np.int64)
    rates = np.asarray(euler_rates(NUMPY, list(solution.x[THETA]), list(solution.x[RATE]))[2])
    last = len(times) - 1
    chosen = [0]
    for k in range(1, last):
        if times[k] - times[chosen[-1]] >= SPACING_US and times[last] - times[k] >= SPACING_US:
            chosen.append(k)
    yaw = solution.x[THETA.stop - 1]
    inner = [YawNode(int(times[k]), float(yaw[k]), float(rates[k])) for k in chosen[1:]]
    return (
        YawNode(0, float(yaw[0]), 0.0),
        *inner,
        YawNode(int(times[last]), float(yaw[last]), 0.0),
    )


def fastest_turn(yaws: Sequence[YawNode]) -> tuple[float, float]:
    """Return the greatest absolute yaw rate along yaw nodes, rad/s, and its time, us."""
    rates = [(0.0, 0.0)]
    for (t0, *before), (t1, *after) in pairwise(yaws):
        length_s = (t1 - t0) * 1e-6
        coefficients = cubic_coefficients(length_s, *before, *after)
        _, _, c2, c3 = coefficients
        extreme = -c2 / (3.0 * c3) if c3 else 0.0
        for s in (0.0, length_s, min(max(extreme, 0.0), length_s)):
            rates.append((abs(cubic_at(coefficients, s)[1]), t0 + s * 1e6))
    return max(rates)
