"""Selection of the missing effects: from whole flights if `run` passes any, otherwise from segments."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, TypeVar

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.data.logs import flights_by_reference
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.decide import is_null_open
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import FlightFit, fit_closed_loop, prior_of
from trimtab.host.trace.flight_fit.fitter import FlightFitter
from trimtab.host.trace.flight_fit.loop import ClosedLoop, closed_loop, order_of
from trimtab.host.trace.flight_fit.repeatability import refit_with_turbulence_whitening, repeatability_of
from trimtab.host.trace.parameters import ParameterSpace, RollOutDiverged
from trimtab.host.trace.residual.unexplained import FlightRepeat
from trimtab.host.trace.search import (
    Fitted,
    Fitter,
    Names,
    OnProgress,
    SearchResult,
    inclusion_probabilities,
    is_supported,
    most_probable,
    null_probability_of,
    screen,
    search,
    sizes,
    smallest_within,
)
from trimtab.host.trace.segment_fit.fit import (
    SegmentFit,
    SegmentFitter,
    at_parameters,
    refit,
    theta_without_effects,
)
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.uncertainty import inflated_flight_covariance, inflated_segment_covariance

Method = Literal["segments", "closed-loop"]
Fit = TypeVar("Fit", bound=Fitted)

_GUESSED_EFFECTS = 3
"""Most effects of a set that segments suggest."""
_GUESS_ITERATIONS = 2
"""Gauss-Newton steps of its fit to segments, from which the fit to whole flights starts."""
_LACKING_SHARE = 0.1
"""Share of what the best such set gains that a smaller one may lack."""


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The selected effects and their probabilities.

    Attributes
    ----------
    selected
        Segment fit of the selected set. With method "closed-loop", its parameters, covariance and log
        evidence come from the flight fit.
    null_fit
        Segment fit without effects.
    method
        Method of selection and estimation: fits to "segments", or to whole flights in "closed-loop".
    inclusion_probability
        Posterior probability of each candidate.
    posterior_weights
        Relative posterior weight of every supported set.
    log_evidence
        Log evidence in nats of every fitted set.
    detectability
        Number of sigma by which each effect of typical size would show in these flights.
    noise_dependent
        Effects because of which whole flights, though there are some, were not fitted.
    repeatability
        Repeatability of the residual of whole flights, with the selected set and without effects; None
        without repeat flights.
    """

    selected: SegmentFit
    null_fit: SegmentFit
    method: Method
    inclusion_probability: Mapping[str, float]
    posterior_weights: Mapping[Names, float]
    log_evidence: Mapping[Names, float]
    detectability: Mapping[str, float]
    noise_dependent: Names = ()
    repeatability: tuple[FlightRepeat | None, FlightRepeat | None] = (None, None)

    @property
    def null_probability(self) -> float:
        """Posterior probability that no effect is missing."""
        return null_probability_of(self.posterior_weights)


def detectability(
    space: ParameterSpace,
    gram: Annotated[np.ndarray, "columns columns"],
    precision: Annotated[np.ndarray, "parameters"],
) -> dict[str, float]:
    """Return by how many sigma each effect of typical size would show.

    The value is sqrt(theta' S' (I - Q) S theta), where theta sets all parameters of the effect to one typical
    size and Q projects on the slopes of all other parameters. If an effect has several candidates, the
    greatest value counts. An effect that acts through another one is detectable only if that one is present,
    since its slope is 0 otherwise.

    gram: of the whitened [residual | slopes S]. precision: of the prior of the other
    parameters, scaled.
    """
    hessian = gram[1:, 1:] + np.diag(precision)
    sigmas: dict[str, float] = {}
    for candidate in space.candidates:
        columns = np.array(space.groups[candidate])
        others = np.setdiff1d(np.arange(len(precision)), columns)
        cross = hessian[np.ix_(others, columns)]
        explained = cross.T @ np.linalg.solve(hessian[np.ix_(others, others)], cross)
        remaining = gram[np.ix_(1 + columns, 1 + columns)] - explained
        name = space.effect(candidate).name
        sigmas[name] = max(sigmas.get(name, 0.0), float(np.sqrt(max(remaining.sum(), 0.0))))
    return sigmas


def select_effects(
    segment_model: SegmentModel,
    data: Segments,
    flights: Sequence[FlightData],
    repeat_flights: Sequence[tuple[int, int]],
    on_progress: OnProgress,
) -> Diagnosis:
    """Select the missing effects from whole flights in closed loop, or from segments.

    Parameters
    ----------
    segment_model
        Model of the segments.
    data
        Segments of all flights. They give the unexplained disturbance in either case.
    flights
        Whole flights to search; empty to search the segments.
    repeat_flights
        Pairs of indices of repeat flights.
    on_progress
        Called with a text after each fit.
    """
    null_fit = refit(segment_model, data, (), None, iterations=3)
    on_progress("no effect fitted")
    fitter = SegmentFitter(segment_model=segment_model)
    if not flights:
        return _from_segments(fitter, null_fit, null_fit, on_progress)
    noisy = noise_dependent_effects(fitter, null_fit)
    if noisy:
        start = fitter.fit((), fitter.fit(noisy, null_fit))
        diagnosis = _from_segments(fitter, null_fit, start, on_progress)
        if any(diagnosis.inclusion_probability[name] > RULES.alias_probability for name in noisy):
            return replace(diagnosis, noise_dependent=noisy)
    return _from_flights(segment_model, null_fit, flights, repeat_flights, on_progress)


def noise_dependent_effects(fitter: SegmentFitter, null_fit: SegmentFit) -> Names:
    """Return the effects that segments show and whole flights cannot, since they depend on noise.

    Each gains much at one of its start values, or leaves its tolerance in the fit without effects.
    """
    space, spikes = fitter.space, np.abs(null_fit.theta_scaled) / fitter.prior.spike

    def shown(name: str) -> bool:
        size = max(spikes[i] for i in space.strengths(name))
        gain = fitter.start_gain(name, null_fit)
        return size > RULES.noise_dependent_spikes or gain > RULES.worth_fitting_nats

    return tuple(n for n in space.candidates if space.effect(n).noise_dependent and shown(n))


def _from_segments(
    fitter: SegmentFitter, null_fit: SegmentFit, start: SegmentFit, on_progress: OnProgress
) -> Diagnosis:
    """Select the effects from segments. The search starts at `start`, a fit without effects."""
    segment_model = fitter.segment_model
    space = segment_model.space
    result = without_shares_of_unsupported(search(fitter, start, on_progress), fitter)
    covariance = inflated_segment_covariance(space, result.selected)
    confirmed = with_present_effects(result, fitter, result.selected, covariance)
    if confirmed is not result:
        result = confirmed
        covariance = inflated_segment_covariance(space, result.selected)
    selected = replace(result.selected, covariance=covariance)
    prior = space.prior
    gram = evidence.marginal_grams(selected.lin, selected.process, prior).flight_grams.sum(0)
    return Diagnosis(
        selected=selected,
        null_fit=null_fit,
        method="segments",
        inclusion_probability=result.inclusion_probability,
        posterior_weights=result.posterior_weights,
        log_evidence=result.log_evidence,
        detectability=detectability(space, gram, prior.precision(selected.effects)),
    )


def _from_flights(
    segment_model: SegmentModel,
    null_fit: SegmentFit,
    flights: Sequence[FlightData],
    repeat_flights: Sequence[tuple[int, int]],
    on_progress: OnProgress,
) -> Diagnosis:
    """Select the effects from whole flights.

    Then fit the nuisances and the disturbance of the segments at the parameters of that set.
    """
    whole = segment_model.space
    loop = closed_loop(flights, segment_model.vehicle, whole, null_fit.theta_scaled, jobs=segment_model.jobs)
    space = loop.space
    autoregression_order = order_of(loop)
    fitter = FlightFitter(loop=loop, order=autoregression_order)
    neutral = theta_without_effects(space, null_fit)
    start = best_predicting(loop, (null_fit.theta_scaled, neutral))
    nothing = fit_closed_loop(loop, (), start, autoregression_order)
    guess = None
    if nothing.error_m > RULES.far_error_m:
        guess = guessed_from_segments(SegmentFitter(segment_model=segment_model), null_fit, fitter)
        on_progress("a set that segments suggest fitted")
    result = search(fitter, nothing, on_progress, guess=guess)
    on_progress("comparing repeat flights")
    result = without_artefacts_of_memory(result, fitter, repeat_flights)
    fit = refit_with_turbulence_whitening(loop, result.selected, autoregression_order, repeat_flights)
    references = flights_by_reference(repeat_flights, len(flights))
    covariance = inflated_flight_covariance(space, fit, references)
    # This fit determines sizes more accurately than the search.
    confirmed = with_present_effects(result, fitter, fit, covariance)
    if confirmed is not result:
        result = confirmed
        fit = refit_with_turbulence_whitening(loop, result.selected, autoregression_order, repeat_flights)
        covariance = inflated_flight_covariance(space, fit, references)
    judged = (
        fit if selected_set_is_judged(result) else fitter.fit(most_probable(result.posterior_weights), fit)
    )
    after, before = (
        repeatability_of(loop, theta_scaled, autoregression_order, repeat_flights)
        for theta_scaled in (judged.theta_scaled, neutral)
    )
    del loop, fitter  # they hold much memory
    selected = at_parameters(
        segment_model, null_fit, fit.effects, fit.theta_scaled, covariance, fit.log_evidence
    )
    return Diagnosis(
        selected=selected,
        null_fit=null_fit,
        method="closed-loop",
        inclusion_probability=result.inclusion_probability,
        posterior_weights=result.posterior_weights,
        log_evidence=result.log_evidence,
        detectability=detectability(space, fit.grams.sum(0), prior_of(space).precision(selected.effects)),
        repeatability=(after, before),
    )


def best_predicting(
    loop: ClosedLoop, points: Sequence[Annotated[np.ndarray, "parameters"]]
) -> Annotated[np.ndarray, "parameters"]:
    """Return the point, scaled, from which whole flights are predicted with the least position error.

    The segments' estimate without effects is a good start if little is missing. A strong effect can bias it
    so much that a search from there stays among wrong sets.
    """

    def squares(index: int, residual: np.ndarray) -> np.ndarray:
        return np.square(residual[:, loop.known[index], :3]).sum((1, 2))

    errors = np.sum(loop.with_residuals(np.column_stack(points), squares), axis=0)
    return points[int(np.argmin(np.where(np.isfinite(errors), errors, np.inf)))]


def guessed_from_segments(
    segments: SegmentFitter, null_fit: SegmentFit, fitter: FlightFitter
) -> FlightFit | None:
    """Return a fit to whole flights of the smallest set that explains most of what segments show.

    If flights end far from their prediction, the linearisation there says little about them. That of segments
    holds, since each begins at the measured state. Returns None if the model cannot be rolled out there.
    """
    scores = screen(segments.space, segments.saturated_scorer(null_fit), _GUESSED_EFFECTS)
    names = smallest_within(scores, _LACKING_SHARE * (max(scores.values()) - scores[()]))
    shown = tuple(name for name in names if name in fitter.space.candidates)
    try:
        fit = refit(segments.segment_model, null_fit.data, names, null_fit, iterations=_GUESS_ITERATIONS)
        return fit_closed_loop(fitter.loop, shown, fit.theta_scaled, fitter.order)
    except RollOutDiverged:
        return None


def with_present_effects(
    result: SearchResult[Fit],
    fitter: Fitter[Fit],
    fit: Fit,
    covariance: Annotated[np.ndarray, "parameters parameters"],
) -> SearchResult[Fit]:
    """Return the result without the effects of `fit` that are not present; `result` itself if all are.

    fit: of the selected set. covariance: see `present_effects`.
    """
    present = present_effects(fitter, fit, covariance)
    if present == fit.effects:
        return result
    result = without_contradicted(result, set(fit.effects) - set(present))
    return replace(result, selected=fitter.fit(present, result.selected))


def present_effects(
    fitter: Fitter[Fit], fit: Fit, covariance: Annotated[np.ndarray, "parameters parameters"]
) -> Names:
    """Return the effects of a fit that exceed their tolerance and chance.

    covariance: of the parameters, scaled, as it is reported. The distance of the strengths from neutral must
    exceed RULES.present_sigma in its terms.
    """
    space, spikes = fitter.space, sizes(fitter, fit)
    present = []
    for name in fit.effects:
        strengths = space.strengths(name)
        size = fit.theta_scaled[strengths]
        sigma = np.sqrt(size @ np.linalg.solve(covariance[np.ix_(strengths, strengths)], size))
        if spikes[name] > RULES.present_spikes and sigma > RULES.present_sigma:
            present.append(name)
    return tuple(name for name in present if space.carried(name, present))


def without_contradicted(result: SearchResult[Fit], absent: Collection[str]) -> SearchResult[Fit]:
    """Return the result with at most RULES.open_probability for effects that were found `absent`.

    The sets with such an effect share that probability, those without any of them the rest. The probabilities
    of all other effects follow.
    """
    weights = dict(result.posterior_weights)
    contradicted = {names for names in weights if not set(absent).isdisjoint(names)}
    with_one = sum(weight for names, weight in weights.items() if names in contradicted)
    without = sum(weights.values()) - with_one
    odds = RULES.open_probability / (1.0 - RULES.open_probability)
    if 0.0 < odds * without < with_one:
        factor = odds * without / with_one
        weights = {n: w * factor if n in contradicted else w for n, w in weights.items()}
    probability = inclusion_probabilities(weights, tuple(result.inclusion_probability))
    return _without(replace(result, inclusion_probability=probability, posterior_weights=weights), absent)


def _without(result: SearchResult[Fit], absent: Collection[str]) -> SearchResult[Fit]:
    """Return the result in which `absent` effects, too, have at most RULES.open_probability."""
    all_absent = result.absent.union(absent)
    probability = {
        name: min(p, RULES.open_probability) if name in all_absent else p
        for name, p in result.inclusion_probability.items()
    }
    return replace(result, inclusion_probability=probability, absent=all_absent)


def without_shares_of_unsupported(
    result: SearchResult[SegmentFit], fitter: Fitter[SegmentFit]
) -> SearchResult[SegmentFit]:
    """Drop effects that may explain only a part of what a better but unsupported set explains.

    Such a set has an effect at its bounds or within its tolerance, so its cause is not in the library. What
    that cause does resembles the signals of other effects in part: with a correlation c, an effect that is
    absent gains the share c^2 of the nats (`RULES.unsupported_share`). Effects are dropped one by one, the
    least first. A dropped effect keeps a probability of at most RULES.open_probability.
    """
    better = max(result.log_evidence.values()) - result.selected.log_evidence
    if better < RULES.tie_nats:
        return result
    return _without_least(result, fitter, RULES.unsupported_share * better)


def without_artefacts_of_memory(
    result: SearchResult[FlightFit], fitter: FlightFitter, repeat_flights: Sequence[tuple[int, int]]
) -> SearchResult[FlightFit]:
    """Drop effects that explain only the error of an effect with states of its own, such as a slung payload.

    The equations of a slung payload (an effect with `memory`) are not exact. Their residual is strong and
    repeats between flights, and other effects explain a little of it: at most a share of this residual, and
    at most a share of what the payload explains. They are dropped one by one, the least first. A dropped
    effect keeps a probability of at most RULES.open_probability.

    repeat_flights: pairs of indices of repeat flights.
    """
    selected = result.selected
    swinging = {name for name in selected.effects if fitter.space.effect(name).memory}
    if not swinging:
        return result
    residual = repeatability_of(fitter.loop, selected.theta_scaled, fitter.order, repeat_flights)
    tie_nats, share = RULES.tie_nats, RULES.least_gain_beside_memory / selected.whitening.temper
    if residual is not None:
        without = max(nats for names, nats in result.log_evidence.items() if swinging.isdisjoint(names))
        of_form = RULES.memory_form_share * max(selected.log_evidence - without, 0.0)
        tie_nats = max(tie_nats, min(share * residual.attainable_nats(RULES), tie_nats + of_form))
    return _without_least(result, fitter, tie_nats, keep=swinging)


def _without_least(
    result: SearchResult[Fit], fitter: Fitter[Fit], nats: float, keep: Collection[str] = ()
) -> SearchResult[Fit]:
    """Drop effects one by one, the least first, until the set is `nats` below the selected one."""
    selected = fit = result.selected
    while beside := [name for name in fit.effects if name not in keep]:
        smaller = [fitter.fit([other for other in fit.effects if other != name], fit) for name in beside]
        supported = [each for each in smaller if is_supported(fitter, each)]
        best = max(supported, key=lambda each: (each.log_evidence, each.effects), default=None)
        if best is None or best.log_evidence < selected.log_evidence - nats:
            break
        fit = best
    if fit is selected:
        return result
    return _without(replace(result, selected=fit), set(selected.effects) - set(fit.effects))


def selected_set_is_judged(result: SearchResult[Any] | Diagnosis) -> bool:
    """Return whether the residual of the selected set is the one to judge.

    If the empty set is selected although it is improbable, the residual of the most probable set is judged
    instead.
    """
    return bool(result.selected.effects) or is_null_open(result.null_probability)
