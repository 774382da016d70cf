"""Factors that widen standard deviations by the disagreement of flights and of references."""

from __future__ import annotations

import numpy as np

from trimtab.host.trace import evidence, uncertainty
from trimtab.host.trace.decision.rules import RULES


def drifting(rng: np.random.Generator, shifts: np.ndarray) -> np.ndarray:
    """Return Grams (flights, 5, 5) of 400 measurements; `shifts` (flights, 4) are parameter errors."""
    grams = []
    for shift in shifts:
        slopes = rng.standard_normal((400, 4))
        A = np.column_stack([rng.standard_normal(400) + slopes @ shift, slopes])
        grams.append(A.T @ A)
    return np.stack(grams)


def test_jackknife_widens_only_what_differs_between_flights() -> None:
    rng = np.random.default_rng(3)
    shifts = np.zeros((8, 4))
    shifts[:, 1] = 0.6 * rng.standard_normal(8)
    grams = drifting(rng, shifts)
    factors = uncertainty.jackknife_by_flight(grams, np.zeros(4), np.full(4, 1e-4))
    assert factors[[0, 2, 3]].max() < 1.6
    assert factors[1] > 4.0
    alone = uncertainty.jackknife_by_flight(grams[:1], np.zeros(4), np.ones(4))
    np.testing.assert_array_equal(alone, np.ones(4))


def test_jackknife_ignores_differences_between_strata() -> None:
    rng = np.random.default_rng(4)
    shifts = np.zeros((8, 4))
    shifts[:, 1] = np.repeat(0.6 * rng.standard_normal(4), 2)
    grams, pairs = drifting(rng, shifts), [[0, 1], [2, 3], [4, 5], [6, 7]]
    assert uncertainty.jackknife_by_flight(grams, np.zeros(4), np.full(4, 1e-4))[1] > 4.0
    assert uncertainty.jackknife_by_flight(grams, np.zeros(4), np.full(4, 1e-4), pairs).max() < 1.6


def test_jackknife_pools_the_median_spread_into_every_parameter() -> None:
    rng = np.random.default_rng(5)
    grams = drifting(rng, 0.6 * rng.standard_normal((8, 4)))
    assert uncertainty.jackknife_by_flight(grams, np.zeros(4), np.full(4, 1e-4)).min() > 3.0


def flights_of_mix(rng: np.random.Generator, references: int, repeats: int) -> np.ndarray:
    """Return Grams (flights, 5, 5) of one mix: each reference has its own error of 0.2 in all parameters."""
    shifts = np.repeat(0.2 * rng.standard_normal((references, 4)), repeats, axis=0)
    return drifting(rng, shifts)


def test_intervals_of_many_references_cover_the_value_that_sets_scatter_about() -> None:
    rng = np.random.default_rng(6)
    population, precision = flights_of_mix(rng, 300, 2).reshape(300, 2, 5, 5), np.full(4, 1e-4)
    references = [[2 * i, 2 * i + 1] for i in range(40)]
    estimates, half_widths, strata_only = [], [], []
    for _ in range(50):
        grams = population[rng.integers(300, size=40)].reshape(80, 5, 5)
        estimate, covariance = evidence.posterior(grams.sum(0), np.zeros(4), precision)
        half = 1.96 * np.sqrt(np.diag(covariance))
        estimates.append(estimate)
        half_widths.append(half * uncertainty.widening_of_mix(grams, np.zeros(4), precision, references))
        strata = uncertainty.jackknife_by_flight(grams, np.zeros(4), precision, references)
        strata_only.append(half * np.maximum(strata, RULES.min_widening))
    distance = np.abs(estimates - np.mean(estimates, axis=0))
    assert 0.90 <= (distance <= half_widths).mean() <= 0.98
    assert (distance <= strata_only).mean() < 0.75


def test_reference_flown_often_widens_as_if_each_pair_of_its_flights_were_another_reference() -> None:
    grams = flights_of_mix(np.random.default_rng(7), 10, 20)
    flights, pairs = np.arange(200).reshape(10, 20).tolist(), np.arange(200).reshape(100, 2).tolist()
    by_reference, by_pair = (
        uncertainty.widening_of_mix(grams, np.zeros(4), np.full(4, 1e-4), groups)
        for groups in (flights, pairs)
    )
    np.testing.assert_allclose(by_reference, by_pair, rtol=0.2)


def test_few_references_widen_little() -> None:
    grams, pairs = flights_of_mix(np.random.default_rng(8), 4, 2), [[0, 1], [2, 3], [4, 5], [6, 7]]
    factors = uncertainty.widening_of_mix(grams, np.zeros(4), np.full(4, 1e-4), pairs)
    between = uncertainty.jackknife_by_flight(grams.reshape(4, 2, 5, 5).sum(1), np.zeros(4), np.full(4, 1e-4))
    assert RULES.min_widening < factors.min()
    assert factors.max() < 0.7 * between.max()


def test_least_widening_falls_with_the_number_of_flights() -> None:
    rng = np.random.default_rng(9)
    for flights, least in ((1, RULES.min_widening), (8, RULES.min_widening), (80, np.sqrt(1.1))):
        grams = drifting(rng, np.zeros((flights, 4)))
        factors = uncertainty.widening_of_mix(
            grams, np.zeros(4), np.full(4, 1e-4), [[i] for i in range(flights)]
        )
        np.testing.assert_allclose(factors.min(), least)
