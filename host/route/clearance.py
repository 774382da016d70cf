"""Clearance: a route whose gates are smaller and whose keep-out shapes are larger by a tracking error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.codegen import NUMPY
from trimtab.host.route.gates import Gate
from trimtab.host.route.model import Route
from trimtab.host.route.shapes import Shape, grown

GATE_SHARE_MIN = 0.1
"""Share of a gate's half size that stays open, however large the clearance."""
_TOUCH_M = 1e-3
"""Distance that a grown shape keeps from a waypoint that the path must meet."""
_GATE_S, _STEP_S = 1.0, 0.001
"""How far from its planned time a gate's passing is looked for, and in which steps."""


def has_obstacles(route: Route) -> bool:
    """Return whether the route has gates or keep-out shapes."""
    return bool(route.gates or route.keep_out)


def with_clearance(route: Route, clearance_m: float) -> Route:
    """Return the route for a vehicle that may be `clearance_m` from its reference.

    A path through the returned route keeps `clearance_m` from the edges of gates and from keep-out shapes. A
    gate that is too small keeps its middle. A shape next to a waypoint that the path must meet grows only up
    to that waypoint.
    """
    gates = None if route.gates is None else tuple(_smaller(gate, clearance_m) for gate in route.gates)
    shapes = tuple(grown(shape, _room_m(route, shape, clearance_m)) for shape in route.keep_out)
    return route.model_copy(update={"gates": gates, "keep_out": shapes})


@dataclass(frozen=True, kw_only=True)
class Passed:
    """How a flight passed a gate or keep-out shape: the least distance inside or outside it, m, and when.

    obstacle: "gates[0]" or "keep_out[0]", as in the route file. Negative beyond a gate's edge or in a shape.
    """

    obstacle: str
    distance_m: float
    t_s: float


def flown_clearance(
    route: Route,
    waypoint_times_s: Sequence[float],
    t_s: Annotated[np.ndarray, "poses"],
    p_ned: Annotated[np.ndarray, "poses 3"],
) -> list[Passed]:
    """Return how a flight passed each gate and keep-out shape; times from the start of the reference.

    A gate is passed where the path is nearest to it within a second of the planned time. One that the poses
    do not reach is left out.
    """
    passed = []
    for number, gate in enumerate(route.gates or ()):
        centre, due_s = route.waypoints_m[gate.waypoint], waypoint_times_s[gate.waypoint]
        near = np.arange(max(due_s - _GATE_S, t_s[0]), min(due_s + _GATE_S, t_s[-1]), _STEP_S)
        path = np.column_stack([np.interp(near, t_s, axis) for axis in p_ned.T])
        inside = [gate.inside_m(p, centre) for p in path]
        if due_s <= t_s[-1] and inside:
            k = int(np.argmax(inside))
            passed.append(Passed(obstacle=f"gates[{number}]", distance_m=inside[k], t_s=float(near[k])))
    for number, shape in enumerate(route.keep_out):
        distance = np.asarray(shape.signed_distance(NUMPY, list(p_ned.T)))
        k = int(distance.argmin())
        passed.append(
            Passed(obstacle=f"keep_out[{number}]", distance_m=float(distance[k]), t_s=float(t_s[k]))
        )
    return passed


def room(route: Route) -> tuple[float, str]:
    """Return the largest clearance that the route allows, m, and what limits it: a gate or a shape.

    Without gates and keep-out shapes it is infinite.
    """
    found = [(math.inf, route.name)]
    for number, gate in enumerate(route.gates or ()):
        half_m = min(size for size in (gate.radius_m, *_halves(gate)) if size is not None)
        found.append(((1.0 - GATE_SHARE_MIN) * half_m, f"gates[{number}]"))
    gated = {gate.waypoint for gate in route.gates or ()}
    for number, shape in enumerate(route.keep_out):
        for k, point in enumerate(route.waypoints_m):
            if k not in gated:
                distance_m = shape.signed_distance(FLOAT, point) - _TOUCH_M
                found.append((distance_m, f"waypoints_m[{k}] beside keep_out[{number}] ({shape.kind})"))
    return min(found)


def _halves(gate: Gate) -> tuple[float | None, float | None]:
    """Return half the width and half the height, None for a sphere."""
    wide, high = gate.width_m, gate.height_m
    return (None if wide is None else 0.5 * wide, None if high is None else 0.5 * high)


def _smaller(gate: Gate, by_m: float) -> Gate:
    sizes = {"radius_m": 1.0, "width_m": 2.0, "height_m": 2.0}
    given = {name: (getattr(gate, name), sides) for name, sides in sizes.items()}
    return gate.model_copy(
        update={
            name: max(size - sides * by_m, GATE_SHARE_MIN * size)
            for name, (size, sides) in given.items()
            if size is not None
        }
    )


def _room_m(route: Route, shape: Shape, clearance_m: float) -> float:
    """Return how far a shape may grow: at most up to the nearest waypoint."""
    gated = {gate.waypoint for gate in route.gates or ()}
    fixed = [point for k, point in enumerate(route.waypoints_m) if k not in gated]
    nearest = min(shape.signed_distance(FLOAT, point) for point in fixed)
    return max(0.0, min(clearance_m, nearest - _TOUCH_M))
