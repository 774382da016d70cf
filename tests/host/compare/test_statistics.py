"""Intervals: against scipy's own tests, by their coverage of a known truth, and with infinite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from trimtab.host.compare.statistics import median_of, paired_difference, trend, unpaired_difference

DRAWS = 4000
COVERED = pytest.approx(0.95, abs=0.0138)
"""Four standard deviations of a share of 95 % of DRAWS."""


def test_paired_interval_is_that_of_the_t_test() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(0.1, 0.03, 7), rng.normal(0.05, 0.01, 7)
    expected = stats.ttest_rel(b, a).confidence_interval(0.95)
    found = paired_difference(list(b - a))
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert found.mean == pytest.approx(float((b - a).mean()))
    assert found.median == pytest.approx(float(np.median(b - a)))
    assert found.count == 7
    assert found.excludes_zero == (expected.high < 0.0)


def test_unpaired_interval_is_that_of_welchs_test() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(0.1, 0.03, 4), rng.normal(0.12, 0.005, 9)
    expected = stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.95)
    found = unpaired_difference(list(a), list(b))
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert found.count == 13


def test_trend_is_that_of_a_regression() -> None:
    rng = np.random.default_rng(3)
    t = np.array([0.0, 0.4, 0.4, 2.0, 7.0])
    y = 0.3 * t + rng.normal(0.0, 0.1, 5)
    line = stats.linregress(t, y)
    slope, sd = float(line[0]), float(line[4])  # type: ignore[arg-type]
    found = trend(list(t), list(y))
    assert found.slope == pytest.approx(slope)
    assert found.high - found.slope == pytest.approx(float(stats.t.ppf(0.975, 3)) * sd)
    assert found.slope - found.low == pytest.approx(found.high - found.slope)


@pytest.mark.parametrize("count", [2, 5, 12])
def test_paired_interval_covers_the_truth_as_often_as_it_says(count: int) -> None:
    rng = np.random.default_rng(count)
    covered = 0
    for _ in range(DRAWS):
        found = paired_difference(list(rng.normal(-0.02, 0.01, count)))
        assert found.low is not None
        assert found.high is not None
        covered += found.low <= -0.02 <= found.high
    assert covered / DRAWS == COVERED


def test_unpaired_interval_covers_the_truth_with_unequal_spreads() -> None:
    rng = np.random.default_rng(4)
    covered = 0
    for _ in range(DRAWS):
        found = unpaired_difference(list(rng.normal(0.1, 0.03, 6)), list(rng.normal(0.13, 0.01, 9)))
        assert found.low is not None
        assert found.high is not None
        covered += found.low <= 0.03 <= found.high
    assert covered / DRAWS == COVERED


def test_trend_interval_covers_the_truth() -> None:
    rng = np.random.default_rng(5)
    t = np.array([0.0, 1.0, 1.5, 6.0])
    covered = 0
    for _ in range(DRAWS):
        found = trend(list(t), list(0.002 * t + rng.normal(0.01, 0.003, 4)))
        covered += found.low <= 0.002 <= found.high
    assert covered / DRAWS == COVERED


def test_one_pair_has_a_mean_and_no_interval() -> None:
    found = paired_difference([0.25])
    assert (found.mean, found.low, found.high, found.median) == (0.25, None, None, 0.25)
    assert not found.excludes_zero
    found = unpaired_difference([0.1], [0.2, 0.3])
    assert (found.mean, found.low, found.high) == (pytest.approx(0.15), None, None)


def test_equal_figures_have_an_interval_of_no_width() -> None:
    found = unpaired_difference([0.5, 0.5], [0.75, 0.75, 0.75])
    assert (found.mean, found.low, found.high) == (0.25, 0.25, 0.25)
    found = paired_difference([0.25, 0.25])
    assert (found.low, found.high) == (0.25, 0.25)


def test_infinite_difference_leaves_the_median_alone() -> None:
    found = paired_difference([-0.03, -0.02, math.inf])
    assert (found.count, found.mean, found.low, found.high, found.median) == (3, None, None, None, -0.02)
    assert paired_difference([math.inf, math.inf, -0.02]).median is None
    assert paired_difference([-math.inf, math.inf]).median is None
    assert paired_difference([]).to_dict() == {
        "count": 0,
        "mean": None,
        "low": None,
        "high": None,
        "median": None,
    }


def test_median_of_nothing_or_of_infinities_is_none() -> None:
    assert median_of([]) is None
    assert median_of([1.0, math.inf]) is None
    assert median_of([1.0, 2.0, math.inf]) == 2.0
