"""Generated routes: figure eights and seeded random waypoints."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from trimtab.host.route.model import Route, YawProfile
from trimtab.host.vehicle.model import Interval, Positive, Vector3
from trimtab.host.vehicle.strict_toml import ConfigurationError, Strict

POINTS_A_TURN = 8
_TRIES = 2000


class FigureEight(Strict):
    """A lemniscate of Gerono in a level plane: north = length/2 sin(s), east = width/2 sin(2 s)."""

    centre_m: Vector3
    length_m: Positive
    width_m: Positive
    turns: Annotated[int, Field(ge=1, le=20)] = 1

    def waypoints(self) -> tuple[Vector3, ...]:
        """Return eight points for each turn; the first and the last are the centre."""
        north, east, down = self.centre_m
        points = []
        for k in range(POINTS_A_TURN * self.turns + 1):
            s = 2.0 * math.pi * (k % POINTS_A_TURN) / POINTS_A_TURN
            points.append(
                (
                    round(north + 0.5 * self.length_m * math.sin(s), 6),
                    round(east + 0.5 * self.width_m * math.sin(2.0 * s), 6),
                    down,
                )
            )
        return tuple(points)


class RandomWaypoints(Strict):
    """Waypoints drawn uniformly from a box, each at least leg_min_m from the previous one."""

    seed: Annotated[int, Field(ge=0)]
    count: Annotated[int, Field(ge=2, le=200)]
    box_m: tuple[Interval, Interval, Interval]
    leg_min_m: Positive
    mean_speed_m_s: Positive

    @model_validator(mode="after")
    def _legs_fit(self) -> Self:
        diagonal = math.dist([low for low, _ in self.box_m], [high for _, high in self.box_m])
        if self.leg_min_m > 0.5 * diagonal:
            raise ValueError(
                f"leg_min_m {self.leg_min_m:g} does not fit the box, give at most {0.5 * diagonal:.2f}"
            )
        return self

    def waypoints(self) -> tuple[Vector3, ...]:
        """Return the drawn points, rounded to millimetres; the same seed gives the same points."""
        rng = np.random.default_rng(self.seed)
        low, high = np.array(self.box_m).T
        points: list[Vector3] = []
        for _ in range(_TRIES * self.count):
            north, east, down = (round(float(value), 3) for value in rng.uniform(low, high))
            if not points or math.dist(points[-1], (north, east, down)) >= self.leg_min_m:
                points.append((north, east, down))
            if len(points) == self.count:
                return tuple(points)
        raise ConfigurationError([f"random.leg_min_m: {self.leg_min_m:g} leaves no room in box_m, lower it"])

    def total_time_s(self, points: Sequence[Vector3]) -> float:
        """Return the time for the straight legs at the mean speed, plus 1 s, rounded to 0.01 s."""
        length = sum(math.dist(a, b) for a, b in itertools.pairwise(points))
        return round(length / self.mean_speed_m_s + 1.0, 2)


def random_route(
    seed: int,
    *,
    count: int = 5,
    box_m: tuple[Interval, Interval, Interval] = ((-3.0, 3.0), (-3.0, 3.0), (-2.6, -1.0)),
    leg_min_m: float = 1.5,
    mean_speed_m_s: float = 2.0,
    total_time_s: float | None = None,
    yaw: YawProfile | None = None,
    name: str | None = None,
) -> Route:
    """Return a route through `count` waypoints drawn from `box_m` (NED); equal arguments give equal routes.

    Five waypoints are those of the paper's data set (section V-A). Raises ValueError on bad arguments.
    """
    drawn = RandomWaypoints(
        seed=seed, count=count, box_m=box_m, leg_min_m=leg_min_m, mean_speed_m_s=mean_speed_m_s
    )
    points = drawn.waypoints()
    return Route(
        name=name or f"random-{seed}",
        waypoints_m=points,
        total_time_s=total_time_s or drawn.total_time_s(points),
        yaw=yaw or YawProfile(),
    )
