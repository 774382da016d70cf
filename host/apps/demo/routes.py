"""Routes of a demo, drawn from the host's seed: four to learn from and two held out.

Each set needs a range of speeds (to separate linear from quadratic drag), climbs, and turning headings (to
separate wind from effects fixed to the body). Shape, pace and heading are therefore given, and other
properties are drawn.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trimtab.host.route import Route, YawProfile, load_route, random_route
from trimtab.host.route.generators import FigureEight
from trimtab.host.vehicle import Limits

Point = tuple[float, float, float]

_REACH_M = 4.0
_BOTTOM_M, _TOP_M = 1.0, 3.2
_PACE_MAX_M_S = 3.2
_EDGE = 0.85  # share of the fence that is used, so that curves between waypoints stay inside
_SETTLE_S = 1.2  # to start and to stop


@dataclass(frozen=True, kw_only=True)
class Space:
    """Space and speed of a demo: reach to each side, heights (up positive), greatest mean speed."""

    reach_m: float
    bottom_m: float
    top_m: float
    pace_m_s: float

    @classmethod
    def of(cls, limits: Limits) -> Space:
        """Return the space within a vehicle's limits."""
        (north0, north1), (east0, east1), (down0, _) = limits.geofence_m
        reach = min(_REACH_M, _EDGE * min(-north0, north1, -east0, east1))
        top = min(_TOP_M, -_EDGE * down0)
        return cls(
            reach_m=reach,
            bottom_m=min(_BOTTOM_M, 0.5 * top),
            top_m=top,
            pace_m_s=min(_PACE_MAX_M_S, 0.4 * limits.speed_max_m_s),
        )

    @property
    def middle_m(self) -> float:
        """Height halfway."""
        return 0.5 * (self.bottom_m + self.top_m)


@dataclass(frozen=True, kw_only=True)
class DemoRoutes:
    """Routes flown twice to learn from, and routes held out."""

    learning: tuple[Route, ...]
    held_out: tuple[Route, ...]


def draw_routes(seed: int, limits: Limits) -> DemoRoutes:
    """Return the six routes of a host seed for a vehicle's limits, always the same for the same arguments."""
    space = Space.of(limits)
    rng = np.random.default_rng([seed, 0])
    return DemoRoutes(
        learning=(
            _eight("eight", rng, space, pace=0.8, turns=2, yaw="fixed"),
            _pretzel("pretzel", rng, space, pace=0.75, yaw="round"),
            _scatter("sprint", rng, space, pace=1.0, count=6, yaw="fixed"),
            _scatter("tour", rng, space, pace=0.55, count=6, yaw="back and forth"),
        ),
        held_out=(
            _scatter("check-scatter", rng, space, pace=0.9, count=6, yaw="round"),
            _eight("check-eight", rng, space, pace=0.7, turns=1, yaw="back and forth"),
        ),
    )


Turning = Literal["fixed", "round", "back and forth"]


def _eight(
    name: str, rng: np.random.Generator, space: Space, *, pace: float, turns: int, yaw: Turning
) -> Route:
    """Return a figure eight of drawn size and direction, inclined."""
    length, width = space.reach_m * rng.uniform(1.4, 1.8), space.reach_m * rng.uniform(0.8, 1.2)
    lift = rng.uniform(0.5, 1.0) * 0.5 * (space.top_m - space.bottom_m)
    level = FigureEight(centre_m=(0.0, 0.0, 0.0), length_m=length, width_m=width, turns=turns).waypoints()
    inclined = [(n, e, -space.middle_m - 2.0 * lift * n / length) for n, e, _ in level]
    return _route(name, _turned(inclined, rng.uniform(-math.pi, math.pi)), rng, space, pace, yaw)


def _pretzel(name: str, rng: np.random.Generator, space: Space, *, pace: float, yaw: Turning) -> Route:
    """Return the shipped pretzel, scaled to the space and turned."""
    shape = np.array(load_route("pretzel").waypoints_m)
    heights = -shape[:, 2]
    share = (heights - heights.min()) / np.ptp(heights)
    scale = space.reach_m / float(np.abs(shape[:, :2]).max()) * rng.uniform(0.8, 0.95)
    points = [
        (scale * n, scale * e, -(space.bottom_m + s * (space.top_m - space.bottom_m)))
        for (n, e, _), s in zip(shape.tolist(), share.tolist(), strict=True)
    ]
    return _route(name, _turned(points, rng.uniform(-math.pi, math.pi)), rng, space, pace, yaw)


def _scatter(
    name: str, rng: np.random.Generator, space: Space, *, pace: float, count: int, yaw: Turning
) -> Route:
    """Return a route through random waypoints."""
    side = (-space.reach_m, space.reach_m)
    drawn = random_route(
        int(rng.integers(2**31)),
        count=count,
        box_m=(side, side, (-space.top_m, -space.bottom_m)),
        leg_min_m=0.7 * space.reach_m,
    )
    return _route(name, drawn.waypoints_m, rng, space, pace, yaw)


def _route(
    name: str,
    points: tuple[Point, ...],
    rng: np.random.Generator,
    space: Space,
    pace: float,
    turning: Turning,
) -> Route:
    """Return the route through the points at a share of the space's pace, along the straight lines."""
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(points))
    total = round(length / (pace * space.pace_m_s) + _SETTLE_S, 2)
    return Route(name=name, waypoints_m=points, total_time_s=total, yaw=_heading(turning, total, rng))


def _heading(turning: Turning, total_s: float, rng: np.random.Generator) -> YawProfile:
    """Return a heading that is fixed, turns once, or turns half and back; direction and start are drawn."""
    first, sign = round(float(rng.uniform(-180.0, 180.0)), 1), float(rng.choice((-1.0, 1.0)))
    if turning == "fixed":
        return YawProfile(yaw_deg=(first,), times_s=(0.0,))
    if turning == "round":
        return YawProfile(yaw_deg=(first, first + sign * 360.0), times_s=(0.0, total_s))
    middle = round(0.5 * total_s, 3)
    return YawProfile(yaw_deg=(first, first + sign * 180.0, first), times_s=(0.0, middle, total_s))


def _turned(points: list[Point], angle: float) -> tuple[Point, ...]:
    """Return the points rotated about the vertical, rounded to the millimetre."""
    c, s = math.cos(angle), math.sin(angle)
    return tuple((round(c * n - s * e, 3), round(s * n + c * e, 3), round(d, 3)) for n, e, d in points)
