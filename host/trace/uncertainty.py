"""Intervals that mean what they say: standard deviations widened by what flights disagree in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Linearisation
from trimtab.host.trace.flight_fit.fit import FlightFit, prior_of
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.segment_fit.fit import SegmentFit


def inflated_covariance(
    space: ParameterSpace, closed: FlightFit, strata: Sequence[Sequence[int]] | None = None
) -> np.ndarray:
    """Covariance (P, P), scaled: the fit's, widened by its jackknife over flights or within `strata`, and by
    RULES.min_widening at least.
    """
    precision = prior_of(space).precision(closed.effects)
    widened = np.maximum(jackknife_by_flight(closed.grams, closed.at, precision, strata), RULES.min_widening)
    return closed.covariance * np.outer(widened, widened)


def by_segments(space: ParameterSpace, fit: SegmentFit) -> np.ndarray:
    """Covariance (P, P), scaled, of an estimate from segments alone.

    Widened by the jackknife over flights, or over quarters of them where there are few, and by what is read
    into segments (`Column.discrepancy`).
    """
    prior = space.prior
    grams = evidence.whitened(_in_pieces(fit.lin), fit.process, prior).flight_grams
    widened = jackknife_by_flight(grams, fit.lin.theta_scaled, prior.precision(fit.effects))
    read_into = np.array([column.discrepancy for column in space.columns])
    return fit.covariance * np.outer(widened, widened) + np.diag(read_into**2)


def _in_pieces(lin: Linearisation) -> Linearisation:
    """Return the linearisation with each flight cut into pieces where there are few flights."""
    if len(lin.local) >= RULES.jackknife_pieces:
        return lin
    quarter = np.empty(len(lin.flight), dtype=int)
    for flight in range(len(lin.local)):
        mine = np.flatnonzero(lin.flight == flight)
        quarter[mine] = np.arange(len(mine)) * RULES.jackknife_pieces // max(len(mine), 1)
    owner, piece = np.unique(lin.flight * RULES.jackknife_pieces + quarter, return_inverse=True)
    return replace(lin, flight=piece, local=lin.local[owner // RULES.jackknife_pieces])


def jackknife_by_flight(
    grams: np.ndarray,
    theta_scaled: np.ndarray,
    precision: np.ndarray,
    strata: Sequence[Sequence[int]] | None = None,
) -> np.ndarray:
    """(P,) factors >= 1 on the standard deviations for what repeats within a flight but not between flights.

    grams (flights, 1 + P, 1 + P) of the whitened [residual | slopes], linearised at theta_scaled (P,); the
    prior's precision (P,). Each parameter's spread over the fits that leave one flight out (Efron's
    jackknife), the others of its stratum counting for it, over its posterior's. Since so few flights tell
    one spread badly, it counts together with a number of flights that spread as the parameters do in the
    median. `strata` part the flights that are alike (default: all are): what differs between strata, such as
    references, is what was flown, not chance.
    """
    total = grams.sum(0)
    parts = [list(part) for part in (strata or [range(len(grams))]) if len(part) > 1]
    freedom = sum(len(part) - 1 for part in parts)
    if not freedom:
        return np.ones(len(theta_scaled))
    _, covariance = evidence.posterior(total, theta_scaled, precision)
    # A parameter's prior does not vary between flights: expected is the data's share of the variance.
    data = grams[[i for part in parts for i in part]].sum(0)
    expected = np.diag(covariance @ data[1:, 1:] @ covariance)
    spread = np.zeros(len(theta_scaled))
    for part in parts:
        own, count = grams[part].sum(0), len(part)
        rest = [total - own + (own - grams[i]) * (count / (count - 1)) for i in part]
        steps = np.stack([evidence.posterior(gram, theta_scaled, precision)[0] for gram in rest])
        spread += (count - 1) / count * ((steps - steps.mean(0)) ** 2).sum(0)
    told = expected > 0.0
    ratio = np.where(told, spread / np.where(told, expected, 1.0), 0.0)
    # Wilson and Hilferty's median of chi-square over its degrees of freedom.
    middle = (1.0 - 2.0 / (9.0 * freedom)) ** 3
    usual = max(1.0, float(np.median(ratio[told])) / middle) if told.any() else 1.0
    variance = (RULES.jackknife_prior_flights * usual + freedom * ratio) / (
        RULES.jackknife_prior_flights + freedom
    )
    return np.sqrt(np.maximum(variance, 1.0))
