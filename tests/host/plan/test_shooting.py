"""How the intervals of a shooting problem lie on the legs."""

from __future__ import annotations

import numpy as np
import pytest

from host.errors import UsageError
from host.plan import plan
from host.plan.problem import Solution, SolveStatus
from host.plan.shooting import NODES_MAX, Grid, coarser, make_grid, on_grid
from host.route import Route
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


def test_grid_of_a_long_route_has_the_most_intervals() -> None:
    assert make_grid(np.full(100, 5.0), None, times_fixed=False).counts.sum() <= NODES_MAX


def test_coarser_grid_has_half_the_intervals_until_there_are_few() -> None:
    fine = make_grid(np.array([5.0, 2.0, 3.0]), 401, times_fixed=False)
    half = coarser(fine)
    assert half is not None
    np.testing.assert_array_equal(half.counts, (fine.counts + 1) // 2)
    assert half.times_s[-1] == pytest.approx(10.0)
    assert coarser(half) is not None
    assert coarser(make_grid(np.ones(10), 150, times_fixed=False)) is None
    assert coarser(make_grid(np.ones(51), 204, times_fixed=False)) is None  # four a leg are the least


def test_solution_on_another_grid_keeps_waypoints_and_inputs() -> None:
    fine = make_grid(np.array([1.0, 3.0]), 80, times_fixed=False)
    half = Grid(counts=fine.counts // 2, h0_s=2.0 * fine.h0_s, times_fixed=False)
    x = np.linspace(0.0, 1.0, 41)[None, :] ** 2
    solution = Solution(
        status=SolveStatus.SOLVED, x=x, u=np.arange(40.0)[None, :], h=np.ones(2), t_s=half.times_s,
        cost=0.0, iterations=0, solve_s=0.0, multipliers=None, violation=0.0, solver="ipopt",
    )  # fmt: skip
    at, u = on_grid(solution, half, fine)
    np.testing.assert_allclose(at[:, fine.waypoints], x[:, half.waypoints])
    np.testing.assert_array_equal(u[0], np.repeat(np.arange(40.0), 2))


def test_route_of_more_legs_than_intervals_are_enough_for_is_refused() -> None:
    points = tuple((0.02 * k, 0.3 * (k % 2), -1.0) for k in range(402))
    route = Route(name="zigzag", waypoints_m=points, total_time_s=400.0)
    with pytest.raises(UsageError, match="401 legs: at 4 intervals a leg 1600 are enough for 400"):
        plan(route, load_vehicle("research"), kind="min-control")
