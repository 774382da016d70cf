"""Search for the set of missing effects.

The search adds, swaps and drops effects. It screens sets in a linearisation, then fits the promising ones. It
selects the smallest set whose log evidence is close to the greatest. A `Fitter` fits the sets: to
command-driven segments (`host.trace.segment_fit.fit`) or to whole flights in closed loop
(`host.trace.flight_fit.fitter`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Annotated, Generic, Protocol, TypeVar

import numpy as np

from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.parameters import ParameterSpace

BEAM = 25
"""Number of sets that the screening extends at each depth."""

Names = tuple[str, ...]
Score = Callable[[Sequence[Names]], Sequence[float]]
OnProgress = Callable[[str], None]


class Fitted(Protocol):
    """A fitted set of effects: its log evidence, nats, and scaled parameters theta_scaled."""

    @property
    def effects(self) -> Names: ...
    @property
    def log_evidence(self) -> float: ...
    @property
    def theta_scaled(self) -> Annotated[np.ndarray, "parameters"]: ...


F = TypeVar("F", bound=Fitted)


class Fitter(Protocol[F]):
    """Fitter of sets of effects, which also scores other sets in the linearisation of a fit."""

    @property
    def space(self) -> ParameterSpace: ...
    @property
    def prior(self) -> Prior: ...
    def fit(self, effects: Sequence[str], start: F) -> F:
        """Return the set `effects` fitted from `start`."""
        ...

    def scorer(self, fit: F) -> Score:
        """Return a function that scores sets by their log evidence in the linearisation of `fit`.

        Up to a constant, its score of `fit.effects` is `fit.log_evidence`.
        """
        ...

    def screening_scorers(self, fit: F) -> list[Score]:
        """Return functions that score sets in the linearisation of `fit` to propose sets to fit."""
        ...

    def underrated_extensions(self, fit: F) -> list[Names]:
        """Return extensions by one effect that must be fitted although the linearisation underrates them."""
        ...


@dataclass(frozen=True, kw_only=True)
class SearchResult(Generic[F]):
    """Result of a search.

    selected: fit of the selected set. inclusion_probability: posterior probability of each candidate.
    posterior_weights: relative posterior probability of each supported set. log_evidence: of every fitted
    set, in nats. absent: effects that were dropped from the selected set after the search.
    """

    selected: F
    inclusion_probability: Mapping[str, float]
    posterior_weights: Mapping[Names, float]
    log_evidence: Mapping[Names, float]
    absent: frozenset[str] = frozenset()

    @property
    def null_probability(self) -> float:
        """Posterior probability that no effect is missing."""
        return null_probability_of(self.posterior_weights)


def smallest_within(scores: Mapping[Names, float], nats: float) -> Names:
    """Return the smallest set whose score is within `nats` of the greatest; of equal ones, the best."""
    top = max(scores.values())
    close = [names for names, score in scores.items() if score >= top - nats]
    return min(close, key=lambda names: (len(names), -scores[names], names))


def most_probable(weights: Mapping[Names, float]) -> Names:
    """Return the set of the greatest posterior weight."""
    return max(weights, key=lambda names: (weights[names], names))


def null_probability_of(weights: Mapping[Names, float]) -> float:
    """Return the share of the empty set in the posterior `weights`."""
    return weights.get((), 0.0) / sum(weights.values())


@dataclass
class _Tried(Generic[F]):
    """The sets that a search has fitted, each with the best of its fits.

    starts: by set, the start of its latest fit. nearby: by set, the fit about which `near` was computed, and
    what it returned.
    """

    fitter: Fitter[F]
    on_progress: OnProgress
    fits: dict[Names, F]
    starts: dict[Names, F] = field(default_factory=dict)
    nearby: dict[Names, tuple[F, Score, dict[Names, float]]] = field(default_factory=dict)

    def fit(self, names: Names, start: F) -> None:
        """Fit a set, unless its latest fit had the same start."""
        if self.starts.get(names) is start:
            return
        self.starts[names] = start
        fit = self.fitter.fit(names, start)
        self.on_progress(f"{', '.join(names) or 'no effect'} fitted")
        if names not in self.fits or fit.log_evidence > self.fits[names].log_evidence:
            self.fits[names] = fit

    def select(self) -> tuple[F, dict[Names, float]]:
        """Return the selected fit, and the scores of all sets near it.

        Scores are log evidences: of the fitted sets, and in the linearisation of the selected fit of others.
        Fitted but unsupported sets have no score.
        """
        supported = {names: fit for names, fit in self.fits.items() if is_supported(self.fitter, fit)}
        evidence = {names: fit.log_evidence for names, fit in supported.items()}
        selected = supported[smallest_within(evidence, RULES.tie_nats)]
        scores = self.near(selected)[1] | evidence
        return selected, {n: value for n, value in scores.items() if n in supported or n not in self.fits}

    def near(self, selected: F) -> tuple[Score, dict[Names, float]]:
        """Return the score in the linearisation of the selected fit, and the scores of sets near its set."""
        about = self.nearby.get(selected.effects)
        if about is None or about[0] is not selected:
            depth = min(RULES.max_effects, len(selected.effects) + 1)
            score = _score_about(self.fitter, selected)
            about = selected, score, screen(self.fitter.space, score, depth)
            self.nearby[selected.effects] = about
        return about[1:]


def search(
    fitter: Fitter[F],
    null_fit: F,
    on_progress: OnProgress = lambda _: None,
    *,
    guess: F | None = None,
) -> SearchResult[F]:
    """Search for the missing effects and select the smallest set that the evidence does not reject.

    null_fit: fit without effects. guess: another fit; the search starts at the better of the two.
    """
    space = fitter.space
    tried = _Tried(fitter, on_progress, {(): null_fit})
    fits = tried.fits
    current = null_fit
    if guess is not None and guess.log_evidence > null_fit.log_evidence:
        fits[guess.effects] = current = guess
    for _ in range(2 * RULES.max_effects):
        trials: list[Names] = []
        for score in fitter.screening_scorers(current):
            depth = min(RULES.max_effects, len(current.effects) + 2)
            trials += _proposals(screen(space, score, depth), current.effects)
        trials += fitter.underrated_extensions(current)
        for names in dict.fromkeys(trials):
            if names not in fits:
                tried.fit(names, current)
        best = max(fits.values(), key=lambda fit: (fit.log_evidence, fit.effects))
        if best.effects == current.effects:
            break
        current = best
    selected, scores = tried.select()
    # Fit what the linearisation underrates, and any set that scores far better in it than the selected fit.
    for _ in range(RULES.max_effects):
        for names in _underrated_sets(space, selected, scores, tried.near(selected)[0]):
            tried.fit(names, selected)
        selected, scores = tried.select()
        promising = most_probable(scores)
        if promising in fits or scores[selected.effects] > scores[promising] - RULES.tie_nats:
            break
        tried.fit(promising, selected)
        selected, scores = tried.select()
    # Drop all sets with an effect that some fit contradicts and that occurs in no supported fit.
    contradicted = {names: contradicted_effects(fitter, fit) for names, fit in fits.items()}
    supported = {name for names, absent in contradicted.items() if not absent for name in names}
    unsupported = frozenset().union(*contradicted.values()) - supported
    scores = {names: score for names, score in scores.items() if not unsupported & set(names)}
    top = max(scores.values())
    weights = {names: float(np.exp(score - top)) for names, score in scores.items()}
    names = without_dispensable(selected.effects, weights)
    if names != selected.effects:
        selected = fits[names] if names in fits else fitter.fit(names, selected)
    return SearchResult(
        selected=selected,
        inclusion_probability=inclusion_probabilities(weights, space.candidates),
        posterior_weights=weights,
        log_evidence={names: fit.log_evidence for names, fit in fits.items()},
    )


def inclusion_probabilities(weights: Mapping[Names, float], candidates: Sequence[str]) -> dict[str, float]:
    """Return the posterior probability of each candidate: the share of the sets that contain it.

    weights: relative posterior probability of sets.
    """
    total = sum(weights.values())
    return {
        name: sum(weight for names, weight in weights.items() if name in names) / total for name in candidates
    }


def _score_about(fitter: Fitter[F], fit: F) -> Score:
    """Return the scorer of a fit, with scores that can be compared with log evidences."""
    score = fitter.scorer(fit)
    shift = fit.log_evidence - score([fit.effects])[0]
    return lambda sets: [value + shift for value in score(sets)]


def _underrated_sets(
    space: ParameterSpace, selected: Fitted, scores: Mapping[Names, float], score: Score
) -> list[Names]:
    """Return sets to fit from the selected fit: those that the screening or an earlier fit may underrate.

    These are the selected set without one of its effects, and sets in which an effect stands in place of its
    aliases. The linearisation underrates these: it holds near the selected fit, where the alias is absent. It
    also does not contain the form of an effect that is absent (`ParameterSpace.forms`). An earlier fit of a
    smaller set may have ended in another minimum. scores: of the sets near the selected one, and of the empty
    set. score: that in the linearisation of the selected fit.
    """
    of_form = max(RULES.worth_fitting_nats, RULES.form_share * (selected.log_evidence - scores[()]))
    margins = {
        tuple(other for other in selected.effects if other != name): of_form for name in selected.effects
    }
    for name in space.candidates:
        if name in selected.effects:
            continue
        replaced = [other for other in selected.effects if space.are_aliases(name, other)]
        for group in {(other,) for other in replaced} | {tuple(replaced)} - {()}:
            names = tuple(sorted({*selected.effects, name} - set(group)))
            margins[names] = of_form if space.forms[name] else RULES.worth_fitting_nats
    trials = sorted({names for names in margins if space.admissible(names)})
    if not trials:
        return []
    found = zip(trials, score(trials), strict=True)
    return [names for names, value in found if value > selected.log_evidence - margins[names]]


def without_dispensable(selected: Names, weights: Mapping[Names, float]) -> Names:
    """Return the selected set without the effects that the rest of the set can do without.

    An effect is dispensable if subsets of the selected set that lack it hold more than
    RULES.alias_probability of the posterior: the data does not show that it is there. The least probable
    effect is tested first. weights: relative posterior probability of sets.
    """
    total = sum(weights.values())
    while selected:
        shares = {
            name: sum(w for names, w in weights.items() if set(names) <= set(selected) - {name}) / total
            for name in selected
        }
        name = max(shares, key=lambda name: (shares[name], name))
        if shares[name] <= RULES.alias_probability:
            break
        selected = tuple(other for other in selected if other != name)
    return selected


def screen(space: ParameterSpace, score: Score, depth: int) -> dict[Names, float]:
    """Return the score of each admissible set of up to `depth` effects that a beam search visits."""
    scores: dict[Names, float] = {(): score([()])[0]}
    frontier: list[Names] = [()]
    for _ in range(depth):
        grown = {tuple(sorted((*names, *extra))) for names in frontier for extra in _extensions(space, names)}
        fresh = sorted(names for names in grown if len(names) <= depth and names not in scores)
        if not fresh:
            break
        scores.update(zip(fresh, score(fresh), strict=True))
        frontier = sorted(fresh, key=lambda names: (-scores[names], names))[:BEAM]
    return scores


def _extensions(space: ParameterSpace, names: Names) -> list[Names]:
    """Return the effects to add in one step: one effect, or one together with an effect that it requires."""
    free = [name for name in space.candidates if name not in names]
    alone = {name for name in free if space.admissible((*names, name))}
    single: list[Names] = [(name,) for name in free if name in alone]
    pairs = [pair for pair in combinations(free, 2) if not set(pair) <= alone]
    return single + [pair for pair in pairs if space.admissible((*names, *pair))]


def _proposals(scores: dict[Names, float], current: Names) -> list[Names]:
    """Return the best set, the best extension and swap of `current`, and good sets with one effect fewer."""
    order = sorted(scores, key=lambda names: (-scores[names], names))
    now, size = set(current), len(current)
    more = [n for n in order if len(n) > size and now <= set(n)][:1]
    least = scores[order[0]] - RULES.swap_share * (scores[order[0]] - scores[()])
    swapped = [n for n in order if len(n) == size and len(set(n) & now) == size - 1][:1] if now else []
    swapped = [n for n in swapped if scores[n] >= least]
    min_score = scores[order[0]] - RULES.worth_fitting_nats
    fewer = [n for n in order if len(n) == size - 1 and set(n) <= now and scores[n] > min_score]
    return [*order[:1], *more, *swapped, *fewer]


def is_supported(fitter: Fitter[F], fit: F) -> bool:
    """Return whether the data supports the set: it contradicts none of its effects."""
    return not contradicted_effects(fitter, fit)


def contradicted_effects(fitter: Fitter[F], fit: F) -> frozenset[str]:
    """Return the effects of the set that the data contradicts.

    An effect must exceed its spike and be off its bounds: an effect at a bound explains something else. If
    it acts through another effect, that one must be large enough. Wind that acts through a negligible drag
    gives about 0.01 m/s^2, no more than slow turbulence, so wind and turbulence could not be distinguished.
    """
    space, at_bound = fitter.space, fitter.space.at_bound(fit.theta_scaled)
    size = sizes(fitter, fit)
    carriers = {name for name in fit.effects if size[name] > RULES.carrier_spikes}
    return frozenset(
        name
        for name in fit.effects
        if size[name] <= RULES.present_spikes
        or any(at_bound[i] for i in space.groups[name])
        or not space.carried(name, carriers)
    )


def sizes(fitter: Fitter[F], fit: F) -> dict[str, float]:
    """Return the size of each effect of the set: the greatest of its strength parameters.

    Sizes are in units of the spike, which combines tolerance and discrepancy.
    """
    spikes = np.abs(fit.theta_scaled) / fitter.prior.spike
    return {name: max(spikes[i] for i in fitter.space.strengths(name)) for name in fit.effects}
