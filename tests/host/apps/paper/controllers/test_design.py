"""The balanced design: what every world, speed, course and set has."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

from trimtab.host.apps.paper.controllers.design import COURSES, SPEEDS, cells
from trimtab.host.apps.paper.controllers.table import BASELINE_TRAJECTORIES, CONTROLLERS, SETS, TRAJECTORIES

WORLD = [cell for course in range(COURSES) for cell in cells(course)]


def test_set_flies_once_at_each_speed_and_on_three_courses_of_a_world():
    assert Counter((cell.flown, cell.speed) for cell in WORLD) == {
        (s, speed): 1 for s in SETS for speed in SPEEDS
    }
    courses = {flown: {cell.course for cell in WORLD if cell.flown == flown} for flown in SETS}
    assert {len(found) for found in courses.values()} == {3}


def test_pair_of_sets_shares_two_courses():
    by_course = [{cell.flown for cell in cells(course)} for course in range(COURSES)]
    shared = [sum({a, b} <= found for found in by_course) for a, b in combinations(SETS, 2)]
    assert shared == [2] * 6


def test_controller_flies_every_trajectory_equally_often_with_each_of_its_regressors():
    flights = Counter(
        (controller.name, cell.flown.regressor, kind)
        for cell in WORLD
        for controller in cell.flown.controllers
        for kind in TRAJECTORIES
    )
    assert set(flights.values()) == {3}
    assert set(flights) == {
        (c.name, r, kind) for c in CONTROLLERS for r in c.regressors for kind in TRAJECTORIES
    }


def test_baseline_flies_each_of_its_trajectories_once_in_every_cell():
    for cell in WORLD:
        in_set = "dfbc" in {controller.name for controller in cell.flown.controllers}
        flown = [*(TRAJECTORIES if in_set else ()), *cell.anchors]
        assert len(flown) == len(set(flown))
        assert set(BASELINE_TRAJECTORIES) <= set(flown)


def test_design_has_twenty_courses_and_three_hundred_flights_in_five_worlds():
    flights = sum(len(cell.flown.controllers) * len(TRAJECTORIES) + len(cell.anchors) for cell in WORLD)
    assert 5 * COURSES >= 20
    assert 5 * flights >= 300
