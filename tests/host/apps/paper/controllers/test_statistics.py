"""Effects, bootstraps, signed ranks and Holm's correction, against numbers computed by hand."""

from __future__ import annotations

import math

import pytest

from trimtab.host.apps.paper.controllers.statistics import (
    FAILED_M,
    LEAST_COURSES,
    effect,
    error_m,
    holm,
    interval,
)
from trimtab.host.apps.paper.planning.courses import BOX_M


def test_effect_is_the_median_over_courses_of_each_course_s_median():
    found = effect({"a": [0.5, 0.5, 8.0], "b": [0.25], "c": [2.0], "d": [0.25], "e": [2.0]})
    assert found.median == pytest.approx(0.5)
    assert (found.courses, found.better) == (5, 3)
    assert found.ci95 == pytest.approx((0.25, 2.0))
    assert not found.confirmed


def test_effect_of_few_courses_has_no_interval_and_confirms_nothing():
    found = effect({k: [0.5] for k in range(LEAST_COURSES - 1)})
    assert (found.median, found.ci95, found.confirmed) == (pytest.approx(0.5), None, False)
    assert effect({k: [0.5] for k in range(LEAST_COURSES)}).confirmed


def test_effect_p_is_that_of_the_exact_signed_rank_test():
    found = effect({k: [0.9 - 0.01 * k] for k in range(6)})
    assert found.p == pytest.approx(2.0 / 2**6)
    assert found.confirmed


def test_effect_without_a_difference_has_p_one():
    found = effect({k: [1.0] for k in range(5)})
    assert (found.median, found.p, found.better) == (1.0, 1.0, 0)
    assert not found.confirmed


def test_effect_without_courses_has_no_numbers():
    found = effect({"a": []})
    assert (found.median, found.ci95, found.p, found.courses) == (None, None, None, 0)
    assert not found.confirmed


def test_interval_of_equal_values_is_that_value_and_repeats():
    assert interval([0.2] * 5) == (0.2, 0.2)
    values = [0.1, 0.2, 0.4, 0.8, 1.6]
    assert interval(values) == interval(values)


def test_holm_multiplies_the_least_p_by_their_number_and_never_decreases():
    assert holm([0.04, 0.01, None, 0.03]) == pytest.approx([0.06, 0.03, None, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_error_of_a_failed_flight_is_longer_than_the_room():
    assert error_m({"failed": "tilt", "error_mean_m": None}) == FAILED_M
    assert error_m({"failed": None, "error_mean_m": 0.1}) == 0.1
    low, high = zip(*BOX_M, strict=True)
    assert math.dist(low, high) < FAILED_M
