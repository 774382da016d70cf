"""The selection of effects: searched over whole flights where these suffice, over segments otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.data.logs import strata_of
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.decide import is_null_probable
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import FlightFit, FlightFitter, fit_loop, prior_of
from trimtab.host.trace.flight_fit.loop import closed_loop, order_of
from trimtab.host.trace.flight_fit.repeatability import in_turbulence, repeatability_of
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.residual.unexplained import FlightRepeat
from trimtab.host.trace.search import (
    Names,
    Report,
    SearchResult,
    most_parsimonious,
    most_probable,
    null_probability_of,
    search,
    sizes,
)
from trimtab.host.trace.segment_fit.fit import SegmentFit, SegmentFitter, at_parameters, refit, unknowns_only
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.uncertainty import by_segments, inflated_covariance

Method = Literal["segments", "closed-loop"]


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The missing effects and how sure they are.

    selected: the segments under the selected set; null_fit: without any effect. method: what the set and its
    parameters were found by. inclusion_probability: of each candidate. posterior_weights: relative, of every
    set considered. log_evidence: of every fitted set, in nats. detectability: by how many
    sigma each effect of typical size would show in these flights. repeatability: of whole flights, where
    twins were flown, beside what was found and of a model without any effect.
    """

    selected: SegmentFit
    null_fit: SegmentFit
    method: Method
    inclusion_probability: Mapping[str, float]
    posterior_weights: Mapping[Names, float]
    log_evidence: Mapping[Names, float]
    detectability: Mapping[str, float]
    repeatability: tuple[FlightRepeat | None, FlightRepeat | None] = (None, None)

    @property
    def null_probability(self) -> float:
        """Posterior probability that no effect is missing."""
        return null_probability_of(self.posterior_weights)


def detectability(space: ParameterSpace, gram: np.ndarray, precision: np.ndarray) -> dict[str, float]:
    """By how many sigma each effect of typical size would show in flights of this whitened `gram`
    (1 + P, 1 + P) of [residual | slopes], everything else moving under the prior `precision` (P,).

    sqrt(theta' S' (I - P) S theta), of all parameters a typical step away, the strongest where one of several
    is. An effect that acts through another one stands out as far as that one was found.
    """
    whole = gram[1:, 1:] + np.diag(precision)
    found: dict[str, float] = {}
    for candidate in space.candidates:
        mine = np.array(space.groups[candidate])
        rest = np.setdiff1d(np.arange(len(precision)), mine)
        cross = whole[np.ix_(rest, mine)]
        own = gram[np.ix_(1 + mine, 1 + mine)] - cross.T @ np.linalg.solve(whole[np.ix_(rest, rest)], cross)
        name = space.effect(candidate).name
        found[name] = max(found.get(name, 0.0), float(np.sqrt(max(own.sum(), 0.0))))
    return found


def select_effects(
    form: SegmentModel,
    data: Segments,
    flights: Sequence[FlightData],
    twins: Sequence[tuple[int, int]],
    report: Report,
) -> Diagnosis:
    """Select the missing effects from whole `flights` in closed loop, or from segments without any.

    `twins` pair indices of `flights`. The segments show in both cases what the selected set leaves.
    """
    nothing = refit(form, data, (), None, iterations=3)
    report("no effect fitted")
    if not flights:
        found, repeats = search(SegmentFitter(form=form), nothing, report), (None, None)
        covariance = by_segments(form.space, found.selected)
        best, method = replace(found.selected, covariance=covariance), "segments"
        prior = form.space.prior
        gram = evidence.whitened(best.lin, best.process, prior).flight_grams.sum(0)
    else:
        loop = closed_loop(flights, form.vehicle, form.space, nothing.theta_scaled)
        order = order_of(loop)
        fitter = FlightFitter(loop=loop, order=order)
        found = search(fitter, fit_loop(loop, (), nothing.theta_scaled, order), report)
        report("comparing twin flights")
        unread = unknowns_only(form.space, nothing)
        found = without_form_faults(found, fitter, twins)
        kept = in_turbulence(loop, found.selected, order, twins)
        there = tuple(name for name, size in sizes(fitter, kept).items() if size > RULES.present_tolerances)
        if there != kept.effects:  # sizes are told better than the search does
            found = replace(found, selected=fitter.fit(there, found.selected))
            kept = in_turbulence(loop, found.selected, order, twins)
        covariance = inflated_covariance(form.space, kept, strata_of(twins, len(flights)))
        judged = kept if is_judged(found) else fitter.fit(most_probable(found.posterior_weights), kept)
        repeats = (
            repeatability_of(loop, judged.theta_scaled, order, twins),
            repeatability_of(loop, unread, order, twins),
        )
        best = at_parameters(form, nothing, kept.effects, kept.theta_scaled, covariance, kept.log_evidence)
        method = "closed-loop"
        gram, prior = kept.grams.sum(0), prior_of(form.space)
    return Diagnosis(
        selected=best,
        null_fit=nothing,
        method=method,
        inclusion_probability=found.inclusion_probability,
        posterior_weights=found.posterior_weights,
        log_evidence=found.log_evidence,
        detectability=detectability(form.space, gram, prior.precision(best.effects)),
        repeatability=repeats,
    )


def without_form_faults(
    found: SearchResult[FlightFit], fitter: FlightFitter, twins: Sequence[tuple[int, int]]
) -> SearchResult[FlightFit]:
    """Return the search's outcome without effects that take up what the form of a swinging one leaves.

    What a payload on its line leaves of itself is strong and repeats; other effects explain a little of it.
    """
    if not any(fitter.space.effect(name).memory for name in found.selected.effects):
        return found
    left = repeatability_of(fitter.loop, found.selected.theta_scaled, fitter.order, twins)
    names = most_parsimonious(
        found,
        RULES.tie_nats
        if left is None
        else max(RULES.tie_nats, RULES.memory_fault_share * left.log_evidence(RULES)),
    )
    if len(names) >= len(found.selected.effects):
        return found
    return replace(found, selected=fitter.fit(names, found.selected))


def is_judged(found: SearchResult[Any] | Diagnosis) -> bool:
    """Whether abstention is judged by what was kept: not by nothing where that is improbable."""
    return bool(found.selected.effects) or is_null_probable(found.null_probability)
