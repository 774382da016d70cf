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


def test_only_what_differs_between_flights_widens() -> None:
    rng = np.random.default_rng(3)
    shifts = np.zeros((8, 4))
    shifts[:, 1] = 0.6 * rng.standard_normal(8)
    grams = drifting(rng, shifts)
    factors = uncertainty.widening_by_flight(grams, np.zeros(4), np.full(4, 1e-4))
    assert factors[[0, 2, 3]].max() < 1.6
    assert factors[1] > 4.0
    alone = uncertainty.widening_by_flight(grams[:1], np.zeros(4), np.ones(4))
    np.testing.assert_array_equal(alone, np.ones(4))


def test_differences_between_strata_do_not_widen() -> None:
    rng = np.random.default_rng(4)
    shifts = np.zeros((8, 4))
    shifts[:, 1] = np.repeat(0.6 * rng.standard_normal(4), 2)
    grams, pairs = drifting(rng, shifts), [[0, 1], [2, 3], [4, 5], [6, 7]]
    assert uncertainty.widening_by_flight(grams, np.zeros(4), np.full(4, 1e-4))[1] > 4.0
    assert uncertainty.widening_by_flight(grams, np.zeros(4), np.full(4, 1e-4), pairs).max() < 1.6


def test_median_disagreement_is_pooled_into_every_parameter() -> None:
    rng = np.random.default_rng(5)
    grams = drifting(rng, 0.6 * rng.standard_normal((8, 4)))
    assert uncertainty.widening_by_flight(grams, np.zeros(4), np.full(4, 1e-4)).min() > 3.0


def test_flight_that_holds_most_of_the_information_does_not_widen_by_itself() -> None:
    rng, precision = np.random.default_rng(10), np.full(4, 1e-4)
    # Only the first flight tells parameters 0 and 1 apart.
    factors = []
    for _ in range(200):
        grams = []
        for flight in range(4):
            slopes = rng.standard_normal((400, 4))
            if flight:
                slopes[:, 0] *= 0.03
                slopes[:, 1] = slopes[:, 0] + 0.01 * slopes[:, 1]
            A = np.column_stack([rng.standard_normal(400), slopes])
            grams.append(A.T @ A)
        factors.append(uncertainty.widening_by_flight(np.stack(grams), np.zeros(4), precision))
    assert np.mean(factors, axis=0).max() < 1.25


def test_rule_for_a_single_parameter_is_the_ratio_of_spread_and_prediction() -> None:
    hessians, gradients = np.array([4.0, 1.0, 2.0]), np.array([3.0, -2.0, 1.0])
    grams = np.array([[[9.0, g], [g, h]] for g, h in zip(gradients, hessians, strict=True)])
    variance = 1.0 / (hessians.sum() + 0.5)
    centred = gradients - hessians * gradients.sum() * variance
    centred -= centred.mean()
    centre = np.eye(3) - 1.0 / 3.0
    predicted = centre @ (np.diag(hessians) - np.outer(hessians, hessians) * variance) @ centre
    freedom = np.trace(predicted) ** 2 / np.square(predicted).sum()
    ratio = np.square(centred).sum() / np.trace(predicted)
    median = max(1.0, ratio / (1.0 - 2.0 / (9.0 * freedom)) ** 3)
    prior = RULES.widening_prior_flights
    expected = np.sqrt(max(1.0, (prior * median + freedom * ratio) / (prior + freedom)))
    factors = uncertainty.widening_by_flight(grams, np.zeros(1), np.full(1, 0.5))
    np.testing.assert_allclose(factors, [expected])


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
        strata = uncertainty.widening_by_flight(grams, np.zeros(4), precision, references)
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
    between = uncertainty.widening_by_flight(grams.reshape(4, 2, 5, 5).sum(1), np.zeros(4), np.full(4, 1e-4))
    assert RULES.min_widening < factors.min()
    assert factors.max() < 0.7 * between.max()


def test_least_widening_falls_with_the_number_of_flights() -> None:
    rng = np.random.default_rng(9)
    for flights, least in (
        (1, RULES.min_widening),
        (8, RULES.min_widening),
        (80, np.sqrt(0.9 + 0.1 * RULES.min_widening**2)),
    ):
        grams = drifting(rng, np.zeros((flights, 4)))
        factors = uncertainty.widening_of_mix(
            grams, np.zeros(4), np.full(4, 1e-4), [[i] for i in range(flights)]
        )
        np.testing.assert_allclose(factors.min(), least)
