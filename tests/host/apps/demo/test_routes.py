"""Routes drawn from a host seed."""

from __future__ import annotations

import itertools
import math

import pytest

from trimtab.host.apps.demo.routes import Space, draw_routes
from trimtab.host.route import check_route
from trimtab.host.vehicle import load_vehicle


@pytest.mark.parametrize("name", ["research", "nano"])
def test_routes_of_any_seed_do_not_contradict_the_vehicle(name: str) -> None:
    vehicle = load_vehicle(name)
    for seed in range(50):
        drawn = draw_routes(seed, vehicle.limits)
        for route in (*drawn.learning, *drawn.held_out):
            check_route(route, vehicle)


def test_routes_of_one_seed_are_the_same_and_of_another_are_not() -> None:
    limits = load_vehicle("research").limits
    assert draw_routes(7, limits) == draw_routes(7, limits)
    assert draw_routes(7, limits) != draw_routes(8, limits)


def test_routes_held_out_are_none_of_those_used() -> None:
    drawn = draw_routes(3, load_vehicle("research").limits)
    used = {route.waypoints_m for route in drawn.learning}
    assert not used & {route.waypoints_m for route in drawn.held_out}
    assert len({route.name for route in (*drawn.learning, *drawn.held_out)}) == 6


def test_routes_to_learn_from_hold_what_tells_effects_apart() -> None:
    limits = load_vehicle("research").limits
    for seed in range(20):
        drawn = draw_routes(seed, limits).learning
        speeds = [route.length_m / route.duration_s for route in drawn]
        assert max(speeds) > 1.4 * min(speeds)
        turns = [math.fsum(abs(b - a) for a, b in itertools.pairwise(r.yaw.yaw_deg)) for r in drawn]
        assert sum(turn >= 360.0 for turn in turns) == 2
        assert sum(turn == 0.0 for turn in turns) == 2
        climbs = [max(p[2] for p in r.waypoints_m) - min(p[2] for p in r.waypoints_m) for r in drawn]
        assert max(climbs) > 1.0


def test_space_of_a_small_fence_is_small() -> None:
    nano, research = (Space.of(load_vehicle(name).limits) for name in ("nano", "research"))
    assert nano.reach_m < 3.0 <= research.reach_m
    assert nano.pace_m_s <= 0.4 * 3.0
    assert nano.bottom_m < nano.middle_m < nano.top_m < 2.5
