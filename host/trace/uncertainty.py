"""Inflated covariances: standard deviations widened by the disagreement of flights and of references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import FlightFit, prior_of
from trimtab.host.trace.linearisation import Linearisation
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.segment_fit.fit import SegmentFit


def inflated_flight_covariance(
    space: ParameterSpace, closed: FlightFit, references: Sequence[Sequence[int]]
) -> Annotated[np.ndarray, "parameters parameters"]:
    """Return the covariance, scaled, of a flight fit, widened by `widening_of_mix`.

    closed: the fit. references: indices of the flights of each reference.
    """
    precision = prior_of(space).precision(closed.effects)
    widened = widening_of_mix(closed.grams, closed.at, precision, references)
    return closed.covariance * np.outer(widened, widened)


def widening_of_mix(
    grams: Annotated[np.ndarray, "flights columns columns"],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    precision: Annotated[np.ndarray, "parameters"],
    references: Sequence[Sequence[int]],
) -> Annotated[np.ndarray, "parameters"]:
    """Return factors that widen standard deviations to the scatter between sets of flights of one mix.

    The forms of the effects are not exact, so each reference has its own best parameters. This error repeats
    when a reference is flown again, and it falls with the number of references, not with that of flights.

    Two widenings are combined. The one over the flights of each reference measures chance. The one over
    pairs of repeat flights also measures the differences between references: the usual two flights of a
    reference count as one draw from the mix. A reference that is flown more often is a larger part of the
    mix, so each pair of its flights counts as a draw. Few references say little about others. The excess of
    the second widening therefore counts by n / (n + RULES.widening_prior_flights), where n is the number of
    pairs less one.

    The factors are at least RULES.min_widening. Beyond RULES.min_widening_flights flights, its excess over 1
    (of the variance) falls in inverse proportion to the number of flights.

    Parameters
    ----------
    grams, theta_scaled, precision
        See `widening_by_flight`.
    references
        Indices of the flights of each reference.
    """
    repeated = [flights for flights in references if len(flights) > 1]
    single = [flights[0] for flights in references if len(flights) == 1]
    pairs = [list(flights[i : i + 2]) for flights in references for i in range(0, len(flights), 2)]
    fewness = min(1.0, RULES.min_widening_flights / len(grams))
    least = 1.0 + (RULES.min_widening**2 - 1.0) * fewness
    within = np.maximum(widening_by_flight(grams, theta_scaled, precision, [*repeated, single]) ** 2, least)
    by_pair = np.stack([grams[pair].sum(0) for pair in pairs])
    between = widening_by_flight(by_pair, theta_scaled, precision) ** 2
    share = (len(pairs) - 1) / (len(pairs) - 1 + RULES.widening_prior_flights)
    return np.sqrt(within + share * np.maximum(between - within, 0.0))


def inflated_segment_covariance(
    space: ParameterSpace, fit: SegmentFit
) -> Annotated[np.ndarray, "parameters parameters"]:
    """Return the covariance, scaled, of a segment fit, widened by disagreement and discrepancy.

    It is widened by the disagreement of flights, or of RULES.widening_pieces parts of each flight if there
    are fewer flights than that. `Column.discrepancy` is added in squares.
    """
    prior = space.prior
    grams = evidence.marginal_grams(_in_pieces(fit.lin), fit.process, prior).flight_grams
    widened = widening_by_flight(grams, fit.lin.theta_scaled, prior.precision(fit.effects))
    discrepancy = np.array([column.discrepancy for column in space.columns])
    return fit.covariance * np.outer(widened, widened) + np.diag(discrepancy**2)


def _in_pieces(lin: Linearisation) -> Linearisation:
    """Return the linearisation with each of its pieces as a flight."""
    pieces = np.arange(len(lin.piece_flight))
    return replace(lin, piece_flight=pieces, nuisances=lin.nuisances[lin.piece_flight])


def widening_by_flight(
    grams: Annotated[np.ndarray, "flights columns columns"],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    precision: Annotated[np.ndarray, "parameters"],
    strata: Sequence[Sequence[int]] | None = None,
) -> Annotated[np.ndarray, "parameters"]:
    """Return factors, at least 1, that widen standard deviations by the disagreement between flights.

    Errors that repeat within a flight but not between flights do not average out as the posterior assumes.
    They show in the influence of each flight on the estimate: the covariance times the gradient of the log
    likelihood of that flight. The widening is the spread of the influences over the spread that the posterior
    predicts for them (Liang and Zeger 1986). The prediction allows for the pull of each flight on the fit
    (Bell and McCaffrey 2002), so one flight that holds most of the information does not widen by itself.

    A few flights determine a spread badly. The spread of each parameter is therefore pooled with
    RULES.widening_prior_flights flights that have the median spread of all parameters, and it weighs as its
    effective degrees of freedom (Satterthwaite 1946).

    Parameters
    ----------
    grams
        Grams of the whitened [residual | slopes].
    theta_scaled
        Scaled parameters of the linearisation.
    precision
        Prior precision, scaled.
    strata
        Groups of indices of flights that are alike; all flights if None. Differences between strata, such as
        other references, do not count.
    """
    parts = [list(part) for part in (strata or [range(len(grams))]) if len(part) > 1]
    if not parts:
        return np.ones(len(theta_scaled))
    step, covariance = evidence.posterior(grams.sum(0), theta_scaled, precision)
    rows = [i for part in parts for i in part]
    stratum = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    centre = np.eye(len(rows)) - (stratum[:, None] == stratum) / np.bincount(stratum)[stratum]
    hessians, gradients = grams[rows, 1:, 1:], grams[rows, 1:, 0]
    influences = centre @ ((gradients - hessians @ step) @ covariance)
    reach = hessians @ covariance
    spread, expected = np.square(influences).sum(0), np.zeros(len(theta_scaled))
    freedom = np.zeros(len(theta_scaled))
    for j in range(len(theta_scaled)):
        pull = reach[:, :, j]
        predicted = np.diag(pull @ covariance[j]) - pull @ covariance @ pull.T
        predicted = centre @ predicted @ centre
        expected[j] = np.trace(predicted)
        if expected[j] > 0.0:
            freedom[j] = expected[j] ** 2 / np.square(predicted).sum()
    informed = freedom > 0.0
    ratio = np.where(informed, spread / np.where(informed, expected, 1.0), 0.0)
    # Median of chi-square over its degrees of freedom, by Wilson and Hilferty.
    chi2_median = (1.0 - 2.0 / (9.0 * np.where(informed, freedom, 1.0))) ** 3
    typical = max(1.0, float(np.median((ratio / chi2_median)[informed]))) if informed.any() else 1.0
    variance = (RULES.widening_prior_flights * typical + freedom * ratio) / (
        RULES.widening_prior_flights + freedom
    )
    return np.sqrt(np.maximum(variance, 1.0))
