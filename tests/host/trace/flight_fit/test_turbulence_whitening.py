"""Whitening of the weighted fit: by differences of repeat flights, else by the whole residual."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import pytest

from tests.host.trace.builders import build_closed_fit
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit import repeatability as module
from trimtab.host.trace.flight_fit.fit import FlightFit
from trimtab.host.trace.flight_fit.loop import ClosedLoop
from trimtab.host.trace.flight_fit.recording import FLIGHT_BIN_S
from trimtab.host.trace.flight_fit.repeatability import refit_with_turbulence_whitening, turbulence
from trimtab.host.trace.flight_fit.whitening import CHANNELS, Whitening
from trimtab.host.trace.parameters import RollOutDiverged

LONG = 200
REPEAT_FLIGHTS = [(0, 1)]
FIT = build_closed_fit(
    ("drag",),
    log_evidence=12.0,
    theta_scaled=(1.0, 2.0),
    covariance=np.diag([4.0, 9.0]),
    grams=np.full((2, 3, 3), 6.0),
)
AGAIN = np.array([1.5, 2.5]), np.diag([0.25, 0.5]), np.full((2, 3, 3), 7.0), np.array([1.4, 2.4])
"""Result of the replaced weighted fit: theta_scaled, covariance, Grams and their point."""


class ResidualsOnly:
    """Stand-in for a loop with known residuals: noise of each flight, and physics common to all."""

    def __init__(self, bins: Sequence[int] = (LONG, LONG), physics: float = 0.0) -> None:
        rng = np.random.default_rng(5)
        noise = [rng.standard_normal((LONG, CHANNELS)) for _ in bins]
        shared = physics * rng.standard_normal((LONG, CHANNELS))
        self.flight_residuals = [(each + shared)[:count] for each, count in zip(noise, bins, strict=True)]
        self.known = [np.ones(count, dtype=bool) for count in bins]

    def residuals(self, theta_scaled: np.ndarray) -> list[np.ndarray]:
        return [each[None] for each in self.flight_residuals]


def loop_of(bins: Sequence[int] = (LONG, LONG), physics: float = 0.0) -> ClosedLoop:
    return cast(ClosedLoop, ResidualsOnly(bins, physics))


@pytest.fixture
def whitenings(monkeypatch: pytest.MonkeyPatch) -> list[Whitening]:
    """Replace the weighted fit by AGAIN; return the whitenings of its calls."""
    used: list[Whitening] = []

    def fit_with_whitening(
        loop: ClosedLoop, white: Whitening, effects: Sequence[str], theta_scaled: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        assert tuple(effects) == FIT.effects
        np.testing.assert_array_equal(theta_scaled, FIT.theta_scaled)
        used.append(white)
        return AGAIN

    monkeypatch.setattr(module, "fit_with_whitening", fit_with_whitening)
    return used


def is_kept(fit: FlightFit) -> bool:
    """Return whether the fit is FIT, whose search of order 1 was tempered already."""
    np.testing.assert_array_equal(fit.theta_scaled, FIT.theta_scaled)
    assert (fit.effects, fit.log_evidence) == (FIT.effects, FIT.log_evidence)
    return bool(np.allclose(fit.covariance, FIT.covariance) and np.allclose(fit.grams, FIT.grams))


@pytest.mark.parametrize(
    ("bins", "repeat_flights", "compared"),
    [
        pytest.param((LONG, LONG), [], False, id="no-repeats"),
        pytest.param((LONG, LONG), REPEAT_FLIGHTS, True, id="repeat_flights"),
        pytest.param(
            (round(RULES.repeat_min_s / FLIGHT_BIN_S) - 1, LONG),
            REPEAT_FLIGHTS,
            False,
            id="one-just-too-short",
        ),
        pytest.param(
            (round(RULES.repeat_min_s / FLIGHT_BIN_S), LONG), REPEAT_FLIGHTS, True, id="one-just-long-enough"
        ),
        pytest.param((LONG, LONG, 10), [(0, 1), (0, 2)], True, id="one-pair-of-two-long-enough"),
    ],
)
def test_in_turbulence_refits_if_repeat_flights_are_long_enough(
    bins: tuple[int, ...], repeat_flights: list[tuple[int, int]], compared: bool, whitenings: list[Whitening]
) -> None:
    refitted = refit_with_turbulence_whitening(loop_of(bins), FIT, 1, repeat_flights)
    assert len(whitenings) == compared
    if not compared:
        assert is_kept(refitted)
        assert refitted.whitening is FIT.whitening
        return
    theta_scaled, covariance, grams, at = AGAIN
    np.testing.assert_array_equal(refitted.theta_scaled, theta_scaled)
    np.testing.assert_array_equal(refitted.at, at)
    np.testing.assert_array_equal(refitted.covariance, covariance)
    np.testing.assert_array_equal(refitted.grams, grams)
    assert refitted.whitening is whitenings[0]
    assert (refitted.effects, refitted.log_evidence) == (FIT.effects, FIT.log_evidence)


def test_in_turbulence_keeps_the_fit_if_the_model_diverges(monkeypatch: pytest.MonkeyPatch) -> None:
    def diverges(*_: object) -> None:
        raise RollOutDiverged("the model with slung-payload diverges on these flights")

    monkeypatch.setattr(module, "fit_with_whitening", diverges)
    assert refit_with_turbulence_whitening(loop_of(), FIT, 1, REPEAT_FLIGHTS) is FIT


def test_in_turbulence_counts_only_bins_known_in_both_repeat_flights(whitenings: list[Whitening]) -> None:
    loop = ResidualsOnly()
    loop.known[0][: LONG // 2] = False
    loop.known[1][LONG // 2 :] = False
    assert is_kept(refit_with_turbulence_whitening(cast(ClosedLoop, loop), FIT, 1, REPEAT_FLIGHTS))
    assert whitenings == []


def test_in_turbulence_whitens_by_differences_of_repeat_flights(whitenings: list[Whitening]) -> None:
    for physics in (0.0, 5.0):
        refit_with_turbulence_whitening(loop_of(physics=physics), FIT, 1, REPEAT_FLIGHTS)
    calm, moved = whitenings
    np.testing.assert_allclose(moved.coefficients, calm.coefficients, atol=1e-9)
    np.testing.assert_allclose(moved.innovation, calm.innovation, atol=1e-9)
    # Differences of two noises of unit variance have a standard deviation of sqrt(2), which is divided out.
    assert np.diag(calm.innovation).mean() == pytest.approx(1.0, abs=0.2)


def test_turbulence_limits_the_order_by_the_amount_of_data() -> None:
    white = turbulence(loop_of(), FIT.theta_scaled, 4, REPEAT_FLIGHTS)
    assert white is not None
    assert white.order == 1
    assert turbulence(loop_of(), FIT.theta_scaled, 1, []) is None
