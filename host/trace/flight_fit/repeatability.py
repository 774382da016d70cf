"""Repeatability of the residuals of whole flights in closed loop.

Repeat flights share only the vehicle, its surroundings and the reference. Their difference contains only
turbulence and noise, so an autoregression fitted to the difference whitens the residuals without any
knowledge of the physics. The part of the whitened residuals that repeat flights have in common is physics
that the model lacks. Segments are less sensitive: every gust causes a loop response of the same shape, so
responses to different gusts partly correlate between short segments, which looks like a model error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import FlightFit, fit_with_whitening
from trimtab.host.trace.flight_fit.loop import ClosedLoop
from trimtab.host.trace.flight_fit.recording import FLIGHT_BIN_S
from trimtab.host.trace.flight_fit.whitening import (
    CHANNELS,
    Whitening,
    affordable,
    autoregression,
    regressors,
    usable_bins,
    whitened,
)
from trimtab.host.trace.parameters import RollOutDiverged
from trimtab.host.trace.residual.unexplained import FlightRepeat

_SHIFT_STEP = 5
"""Step in bins between the time shifts that estimate the variance under chance."""


def repeatability_of(
    loop: ClosedLoop,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    order: int,
    repeat_flights: Sequence[tuple[int, int]],
) -> FlightRepeat | None:
    """Return how much of the residual repeats between repeat flights; None without repeat flights.

    Parameters
    ----------
    loop
        Closed-loop model with the recordings of the flights.
    theta_scaled
        Scaled parameters at which the residual is computed.
    order
        Greatest order of the autoregression that whitens the residual.
    repeat_flights
        Pairs of indices into the loop's recordings.
    """
    pairs = _pairs(loop, theta_scaled, repeat_flights)
    white = _turbulence(pairs, order)
    if white is None:
        return None
    common, variance, count, position = 0.0, 0.0, 0, 0.0
    for first, second, known in pairs:
        usable = usable_bins(known, white.span)
        x, y = whitened(white, np.stack([first, second]), known).reshape(2, len(usable), -1)
        shifts = range(
            round(RULES.repeat_shift_s / FLIGHT_BIN_S),
            len(usable) - round(RULES.repeat_shift_s / FLIGHT_BIN_S),
            _SHIFT_STEP,
        )
        by_chance = [float((x * np.roll(y, shift, axis=0)).sum()) for shift in shifts]
        common += float((x * y).sum())
        variance += max(float(x.size), float(np.var(by_chance)))
        count += x.size
        position += float((first[known, :3] * second[known, :3]).sum()) / int(known.sum())
    # The autoregression is fitted to the difference, so it fits the difference better than the sum. The power
    # of the sum exceeds that of the difference even if nothing repeats. The excess is the power that the
    # coefficients and the innovation covariance absorbed.
    rows, coefficients = count / CHANNELS, CHANNELS * white.order
    common -= 0.5 * count * (2 * coefficients + CHANNELS + 1) / (rows - coefficients - CHANNELS - 1)
    return FlightRepeat(
        share=common / count,
        z_score=common / float(np.sqrt(variance)),
        position_m=float(np.sqrt(max(position / len(pairs), 0.0))),
        size=count,
    )


def turbulence(
    loop: ClosedLoop,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    order: int,
    repeat_flights: Sequence[tuple[int, int]],
) -> Whitening | None:
    """Return the whitening of turbulence and noise, fitted to differences of repeat flights.

    theta_scaled: scaled parameters at which the residuals are computed. order: greatest order of the
    autoregression. repeat_flights: pairs of indices into the loop's recordings. Returns None without repeat
    flights.
    """
    return _turbulence(_pairs(loop, theta_scaled, repeat_flights), order)


def refit_with_turbulence_whitening(
    loop: ClosedLoop, fit: FlightFit, order: int, repeat_flights: Sequence[tuple[int, int]]
) -> FlightFit:
    """Return `fit` refitted with the whitening of turbulence.

    Returns `fit` itself without repeat flights, or if the refit leads to where the model diverges.

    The search whitens by the whole residual of a set, so a residual that no effect explains counts as noise
    and cannot lead to the selection of an effect. To estimate the size of an effect, only chance should count
    as noise: the refit weights the data by turbulence and noise, not by what the library cannot explain.

    order: greatest order of the autoregression. repeat_flights: pairs of indices into the loop's recordings.
    """
    white = turbulence(loop, fit.theta_scaled, order, repeat_flights)
    if white is None:
        return fit
    try:
        theta_scaled, covariance, grams, at = fit_with_whitening(loop, white, fit.effects, fit.theta_scaled)
    except RollOutDiverged:
        return fit
    return replace(fit, theta_scaled=theta_scaled, at=at, covariance=covariance, whitening=white, grams=grams)


_Pair = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Residuals (bins, 12) of two repeat flights, and which of the bins (bins,) are known in both."""


def _pairs(
    loop: ClosedLoop, theta_scaled: np.ndarray, repeat_flights: Sequence[tuple[int, int]]
) -> list[_Pair]:
    """Return the pairs of repeat flights that are long enough to be compared."""
    residuals = [lanes[0] for lanes in loop.residuals(theta_scaled[:, None])] if repeat_flights else []
    pairs = []
    for a, b in repeat_flights:
        bins = min(len(residuals[a]), len(residuals[b]))
        known = loop.known[a][:bins] & loop.known[b][:bins]
        if known.sum() * FLIGHT_BIN_S >= RULES.repeat_min_s:
            pairs.append((residuals[a][:bins], residuals[b][:bins], known))
    return pairs


def _turbulence(pairs: Sequence[_Pair], order: int) -> Whitening | None:
    """Return the whitening fitted to the differences of `pairs`; None without pairs."""
    if not pairs:
        return None
    order = min(order, affordable([known for *_, known in pairs]))
    return autoregression(
        regressors((first - second) / np.sqrt(2.0), known, order) for first, second, known in pairs
    )
