"""Points of the tuning: their flights, settings and scores, and that the controller files hold what won."""

from __future__ import annotations

import math

import pytest

from trimtab.host.apps.paper.tuning.points import flight_spread, log_error, planned, score
from trimtab.host.apps.paper.tuning.table import (
    COURSES,
    FULL,
    PACES,
    WORLD,
    WORLD_SEEDS,
    legs,
    settings_at,
)
from trimtab.host.control.files import list_controllers, load_controller
from trimtab.host.control.settings import DfbcSettings, MpcSettings
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
BY_NAME = {search.name: search for search in FULL}


def start(name: str) -> dict[str, float]:
    return {each.name: 1.0 for each in BY_NAME[name].parameters}


def test_legs_fly_every_course_at_every_pace_and_every_world_twice() -> None:
    flown = legs()
    assert {(leg.course, leg.pace) for leg in flown} == {(c, p) for c in COURSES for p in PACES}
    assert sorted(leg.world_seed for leg in flown) == sorted(2 * WORLD_SEEDS)
    assert all(len({leg.world_seed for leg in flown if leg.course == course}) == 2 for course in COURSES)


def test_pace_stretches_the_time_of_a_course() -> None:
    slow, fast = (planned(leg, VEHICLE).duration_s for leg in legs() if leg.course == "random:11")
    assert slow == pytest.approx(fast / PACES[0], rel=1e-3)


def test_settings_at_a_factor_change_that_setting_only() -> None:
    search = BY_NAME["mpc"]
    base = settings_at("mpc-l1", search.of("mpc-l1"), start("mpc"))
    moved = settings_at("mpc-l1", search.of("mpc-l1"), {**start("mpc"), "velocity": 2.0})
    assert isinstance(base, MpcSettings)
    assert isinstance(moved, MpcSettings)
    assert moved.weights.velocity_s2_m2 == (10.0, 10.0, 10.0)
    weights = moved.weights.model_copy(update={"velocity_s2_m2": base.weights.velocity_s2_m2})
    assert moved.model_copy(update={"weights": weights}) == base


def test_gains_of_the_flatness_based_controller_start_at_those_of_the_vehicle() -> None:
    search = BY_NAME["dfbc"]
    at_start = settings_at("dfbc", search.of("dfbc"), start("dfbc"))
    assert isinstance(at_start, DfbcSettings)
    assert at_start.gain_factors.position_p == 1.0
    assert at_start.observer_bandwidth_1_s == 0.0
    moved = settings_at("dfbc-do", search.of("dfbc-do"), {**start("dfbc"), "observer": 1.5})
    assert isinstance(moved, DfbcSettings)
    assert moved.observer_bandwidth_1_s == 4.5


def test_gains_move_by_thirty_per_cent_at_most() -> None:
    for each in BY_NAME["dfbc"].parameters:
        if each.table == "gains":
            assert 0.7 <= min(each.factors) < 1.0 < max(each.factors) <= 1.3


def test_score_is_the_mean_log_error_and_needs_every_flight() -> None:
    assert log_error([0.01, 0.04]) == pytest.approx(math.log(0.02))
    assert log_error([0.01, None]) is None


def test_point_at_which_one_flight_gets_much_worse_is_not_chosen() -> None:
    start = [0.02, 0.02, 0.02]
    assert score([0.01, 0.01, 0.022], start, 0.05) == pytest.approx(log_error([0.01, 0.01, 0.022]))
    assert score([0.01, 0.01, 0.024], start, 0.05) == math.inf
    assert score([0.01, None, 0.02], start, 0.05) == math.inf


def test_spread_is_that_of_one_flight() -> None:
    pairs = [([1.0, 1.0], [math.exp(0.2), math.exp(-0.2)])]
    assert flight_spread(pairs) == pytest.approx(0.2 / math.sqrt(2.0))
    assert flight_spread([([1.0, None], [1.0, 3.0])]) == 0.0
    with pytest.raises(ValueError, match="no pair"):
        flight_spread([([None], [1.0])])


@pytest.mark.parametrize("name", list_controllers())
def test_controller_file_says_what_the_study_flew(name: str) -> None:
    tuned = load_controller(name).tuned
    assert tuned is not None
    assert tuned.vehicle == VEHICLE.name
    assert (tuned.courses, tuned.paces) == (COURSES, PACES)
    assert (tuned.world, tuned.world_seeds) == (WORLD, WORLD_SEEDS)
    assert tuned.command == "trimtab study controller-tuning --seed 1"


@pytest.mark.parametrize(("name", "search"), [(name, s) for s in FULL for name in s.files])
def test_controller_file_holds_values_that_the_study_tried(name: str, search) -> None:
    data = load_controller(name).model_dump()
    for each in search.of(name):
        value = (data[each.table] if each.table else data)[each.key]
        value = value if isinstance(value, tuple) else (value,)
        assert value in [each.value(factor) for factor in each.factors]


def test_variants_with_a_model_share_the_tuned_settings() -> None:
    observers = [load_controller(name) for name in ("dfbc-do", "dfbc-neural-do")]
    plain = [load_controller(name) for name in ("dfbc", "dfbc-neural")]
    for first, second in (observers, plain):
        assert isinstance(first, DfbcSettings)
        assert second == first.model_copy(update={"feedforward": True})
    assert isinstance(observers[0], DfbcSettings)
    assert isinstance(plain[0], DfbcSettings)
    assert observers[0].gain_factors == plain[0].gain_factors
