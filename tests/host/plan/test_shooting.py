"""How the intervals of a shooting problem lie on the legs."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.plan import plan
from trimtab.host.plan.planner import make_job
from trimtab.host.plan.rounds import first_round
from trimtab.host.plan.shooting import NODES_MAX, Grid, coarser, make_grid, on_grid
from trimtab.host.route import Route
from trimtab.host.vehicle import load_vehicle


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
    assert coarser(make_grid(np.ones(10), 80, times_fixed=False)) is None
    assert coarser(make_grid(np.ones(51), 204, times_fixed=False)) is None  # four a leg are the least


def test_solution_on_a_finer_grid_is_the_same_path_without_gaps() -> None:
    points = ((0.0, 0.0, -1.0), (2.0, 1.0, -1.5), (4.0, 0.0, -1.0))
    route = Route(name="bend", waypoints_m=points, total_time_s=4.0)
    job = make_job(route, load_vehicle("research"), kind="min-control")
    engine, problem, solution = first_round(job, nodes=40)
    old = make_grid(job.durations(), 40, times_fixed=False)
    new = Grid(counts=2 * old.counts, h0_s=old.h0_s / 2.0, times_fixed=False)
    x, u = on_grid(engine, problem, solution, old, new)
    np.testing.assert_allclose(x[:, ::2], solution.x, atol=1e-9)
    np.testing.assert_array_equal(u, solution.u.repeat(2, axis=1))
    fine = engine.over(new.h0_s[new.leg_of], problem.parameters.repeat(2, axis=1))
    fine.set(x[:, :-1].T, u.T, solution.h[new.leg_of])
    fine.values()
    assert np.abs(fine.x_next.dense(len(x))[:, :, 0].T - x[:, 1:]).max() < 1e-3


def test_solution_on_another_grid_keeps_waypoints() -> None:
    points = ((0.0, 0.0, -1.0), (2.0, 1.0, -1.5), (4.0, 0.0, -1.0))
    route = Route(name="bend", waypoints_m=points, total_time_s=4.0)
    job = make_job(route, load_vehicle("research"), kind="min-control")
    engine, problem, solution = first_round(job, nodes=40)
    old = make_grid(job.durations(), 40, times_fixed=False)
    new = Grid(counts=3 * old.counts - 1, h0_s=np.ones(2), times_fixed=False)
    x, _ = on_grid(engine, problem, solution, old, new)
    np.testing.assert_allclose(x[:, new.waypoints], solution.x[:, old.waypoints], atol=1e-9)


def test_route_of_more_legs_than_intervals_are_enough_for_is_refused() -> None:
    points = tuple((0.02 * k, 0.3 * (k % 2), -1.0) for k in range(402))
    route = Route(name="zigzag", waypoints_m=points, total_time_s=400.0)
    with pytest.raises(UsageError, match="401 legs: at 4 intervals a leg 1600 are enough for 400"):
        plan(route, load_vehicle("research"), kind="min-control")
