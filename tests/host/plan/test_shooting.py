"""How the intervals of a shooting problem lie on the legs."""

from __future__ import annotations

import numpy as np
import pytest

from host.errors import UsageError
from host.plan import plan
from host.plan.shooting import NODES_MAX, make_grid
from host.plan.snap import optimise_durations
from host.route import Route, load_route
from host.vehicle import load_vehicle


def test_grid_rounds_each_leg_s_share() -> None:
    grid = make_grid(np.array([1.0, 2.0, 3.04]), None, times_fixed=False)
    assert list(grid.counts) == [14, 29, 44]  # of ceil(6.04 / 0.07) = 87 intervals
    assert grid.times_s[-1] == pytest.approx(6.04)


@pytest.mark.parametrize("durations", [[3.0, *[0.01] * 49], [1.0] * 23])
def test_grid_never_has_more_intervals_than_the_most(durations: list[float]) -> None:
    grid = make_grid(np.array(durations), NODES_MAX, times_fixed=False)
    assert grid.counts.sum() <= NODES_MAX
    assert grid.counts.min() >= 4


def test_shipped_route_takes_no_more_intervals_than_the_most() -> None:
    route = load_route("figure-eight")
    durations = optimise_durations(np.array(route.waypoints_m), route.duration_s)
    assert make_grid(durations, None, times_fixed=False).counts.sum() == NODES_MAX


def test_route_of_more_legs_than_intervals_are_enough_for_is_refused() -> None:
    points = tuple((0.02 * k, 0.3 * (k % 2), -1.0) for k in range(52))
    route = Route(name="zigzag", waypoints_m=points, total_time_s=40.0)
    with pytest.raises(UsageError, match="51 legs: at 4 intervals a leg 200 are enough for 50"):
        plan(route, load_vehicle("research"), kind="min-control")
