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
from trimtab.host.trace.flight_fit.repeatability import in_turbulence, repeat
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.residual.unexplained import FlightRepeat
from trimtab.host.trace.search import Names, Report, SearchResult, likeliest, none_of, search, sizes, smallest
from trimtab.host.trace.segment_fit.fit import SegmentFit, SegmentFitter, at_parameters, refit, unknowns_only
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.uncertainty import by_segments, honest_covariance

Method = Literal["segments", "closed-loop"]


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The missing effects and how sure they are.

    best: the segments under the kept set, nothing: without any effect. method: what the set and its
    parameters were found by. inclusion: each candidate's posterior probability. weights: the relative
    posterior weight of every set considered. sets: the evidence of every fitted one. stands_out: by how many
    sigma each effect of typical size would show in these flights. repeats: of whole flights, where twins were
    flown, beside what was found and of a model without any effect.
    """

    best: SegmentFit
    nothing: SegmentFit
    method: Method
    inclusion: Mapping[str, float]
    weights: Mapping[Names, float]
    sets: Mapping[Names, float]
    stands_out: Mapping[str, float]
    repeats: tuple[FlightRepeat | None, FlightRepeat | None] = (None, None)

    @property
    def none(self) -> float:
        """Posterior probability that no effect is missing."""
        return none_of(self.weights)


def stands_out(space: ParameterSpace, gram: np.ndarray, precision: np.ndarray) -> dict[str, float]:
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
        covariance = by_segments(form.space, found.best)
        best, method = replace(found.best, covariance=covariance), "segments"
        prior = form.space.prior
        gram = evidence.whitened(best.lin, best.process, prior).flight_grams.sum(0)
    else:
        loop = closed_loop(flights, form.vehicle, form.space, nothing.z)
        order = order_of(loop)
        fitter = FlightFitter(loop=loop, order=order)
        found = search(fitter, fit_loop(loop, (), nothing.z, order), report)
        report("comparing twin flights")
        unread = unknowns_only(form.space, nothing)
        found = without_form_faults(found, fitter, twins)
        kept = in_turbulence(loop, found.best, order, twins)
        there = tuple(name for name, size in sizes(fitter, kept).items() if size > RULES.present_tolerances)
        if there != kept.effects:  # sizes are told better than the search does
            found = replace(found, best=fitter.fit(there, found.best))
            kept = in_turbulence(loop, found.best, order, twins)
        covariance = honest_covariance(form.space, kept, strata_of(twins, len(flights)))
        judged = kept if is_judged(found) else fitter.fit(likeliest(found.weights), kept)
        repeats = repeat(loop, judged.z, order, twins), repeat(loop, unread, order, twins)
        best = at_parameters(form, nothing, kept.effects, kept.z, covariance, kept.log_evidence)
        method = "closed-loop"
        gram, prior = kept.grams.sum(0), prior_of(form.space)
    return Diagnosis(
        best=best,
        nothing=nothing,
        method=method,
        inclusion=found.inclusion,
        weights=found.weights,
        sets=found.sets,
        stands_out=stands_out(form.space, gram, prior.precision(best.effects)),
        repeats=repeats,
    )


def without_form_faults(
    found: SearchResult[FlightFit], fitter: FlightFitter, twins: Sequence[tuple[int, int]]
) -> SearchResult[FlightFit]:
    """The search's outcome without effects that take up what the form of a swinging one leaves.

    What a payload on its line leaves of itself is strong and repeats; other effects explain a little of it.
    """
    if not any(fitter.space.effect(name).memory for name in found.best.effects):
        return found
    left = repeat(fitter.loop, found.best.z, fitter.order, twins)
    names = smallest(
        found,
        RULES.tie_nats
        if left is None
        else max(RULES.tie_nats, RULES.memory_fault_share * left.log_evidence(RULES)),
    )
    if len(names) >= len(found.best.effects):
        return found
    return replace(found, best=fitter.fit(names, found.best))


def is_judged(found: SearchResult[Any] | Diagnosis) -> bool:
    """Whether abstention is judged by what was kept: not by nothing where that is improbable."""
    return bool(found.best.effects) or is_null_probable(found.none)
