"""The search for the set of missing effects: forward steps, swaps and drops, each screened in a
linearisation, then fitted; the smallest set that explains the flights is kept.

What fits a set is a `Fitter`: command-driven segments (`host.trace.segment_fit.fit`) or whole flights over
the closed loop (`host.trace.flight_fit.fit`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Generic, Protocol, TypeVar

import numpy as np

from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.parameters import ParameterSpace

BEAM = 25
"""Sets that the screening extends at each depth."""

Names = tuple[str, ...]
Report = Callable[[str], None]


class Fitted(Protocol):
    """One set of effects fitted: its evidence in nats and scaled parameters theta_scaled (P,)."""

    @property
    def effects(self) -> Names: ...
    @property
    def log_evidence(self) -> float: ...
    @property
    def theta_scaled(self) -> np.ndarray: ...


F = TypeVar("F", bound=Fitted)


class Fitter(Protocol[F]):
    """Fits sets of effects, and judges others in the linearisation of a fit."""

    @property
    def space(self) -> ParameterSpace: ...
    @property
    def prior(self) -> Prior: ...
    def fit(self, effects: Sequence[str], start: F) -> F:
        """Return the set `effects` fitted from `start`."""
        ...

    def scorers(self, fit: F) -> list[Callable[[Names], float]]:
        """Log evidence of any set in `fit`'s linearisation, one way or several; the last as in the fit."""
        ...

    def beyond(self, fit: F) -> list[Names]:
        """Return sets with one effect more that `fit`'s linearisation does not show for what they are."""
        ...


@dataclass(frozen=True, kw_only=True)
class SearchResult(Generic[F]):
    """What the search ends with.

    `best` is the kept set, `inclusion` each candidate's posterior probability, `weights` the relative
    posterior weight of every set considered, `sets` the evidence of every fitted one.
    """

    selected: F
    inclusion_probability: Mapping[str, float]
    posterior_weights: Mapping[Names, float]
    log_evidence: Mapping[Names, float]

    @property
    def null_probability(self) -> float:
        """Posterior probability that no effect is missing."""
        return null_probability_of(self.posterior_weights)


def most_parsimonious(found: SearchResult[F], within: float) -> Names:
    """Return the smallest of the sets that may be kept whose evidence is `within` so many nats of the
    greatest.
    """
    may = {names: value for names, value in found.log_evidence.items() if names in found.posterior_weights}
    top = max(may.values())
    close = [names for names, value in may.items() if value >= top - within]
    return min(close, key=lambda names: (len(names), -may[names], names))


def most_probable(weights: Mapping[Names, float]) -> Names:
    """Return the set of greatest weight."""
    return max(weights, key=lambda names: (weights[names], names))


def null_probability_of(weights: Mapping[Names, float]) -> float:
    """Share of the empty set in posterior `weights`."""
    return weights.get((), 0.0) / sum(weights.values())


def search(fitter: Fitter[F], nothing: F, report: Report = lambda _: None) -> SearchResult[F]:
    """Return the missing effects, searched from the fit of `nothing`: as many as the evidence supports."""
    space = fitter.space
    fits: dict[Names, F] = {(): nothing}
    current = nothing
    for _ in range(2 * RULES.max_effects):
        trials: list[Names] = []
        for score in fitter.scorers(current):
            depth = min(RULES.max_effects, len(current.effects) + 2)
            trials += _proposals(screen(space, score, depth), current.effects)
        trials += fitter.beyond(current)
        for names in dict.fromkeys(trials):
            if names not in fits:
                fits[names] = fitter.fit(names, current)
                report(f"{', '.join(names) or 'no effect'} fitted")
        best = max(fits.values(), key=lambda fit: (fit.log_evidence, fit.effects))
        if best.effects == current.effects:
            break
        current = best
    kept, scores = _judged(fitter, fits)
    # What the kept fit's linearisation gives far more than that fit is fitted too, until nothing is left.
    for _ in range(RULES.max_effects):
        promised = most_probable(scores)
        if promised in fits or scores[kept.effects] > scores[promised] - RULES.tie_nats:
            break
        fits[promised] = fitter.fit(promised, kept)
        report(f"{', '.join(promised)} fitted")
        kept, scores = _judged(fitter, fits)
    # What was within its tolerance or at its bounds in all fits that had it is in no other set either.
    kept_in = {name for names, fit in fits.items() if _is_supported(fitter, fit) for name in names}
    gone = {name for names in fits for name in names} - kept_in
    scores = {names: score for names, score in scores.items() if not gone & set(names)}
    top = max(scores.values())
    weights = {names: float(np.exp(score - top)) for names, score in scores.items()}
    total = sum(weights.values())
    return SearchResult(
        selected=kept,
        inclusion_probability={
            name: sum(w for names, w in weights.items() if name in names) / total for name in space.candidates
        },
        posterior_weights=weights,
        log_evidence={names: fit.log_evidence for names, fit in fits.items()},
    )


def _judged(fitter: Fitter[F], fits: Mapping[Names, F]) -> tuple[F, dict[Names, float]]:
    """Return the set that is kept of the fitted ones, and the scores."""
    borne = {names: fit for names, fit in fits.items() if _is_supported(fitter, fit)}
    kept = _most_parsimonious(borne)
    return kept, _scores(fitter, kept, borne, frozenset(fits) - frozenset(borne))


def screen(space: ParameterSpace, score: Callable[[Names], float], depth: int) -> dict[Names, float]:
    """Return the score of every admissible set up to `depth` effects that a beam search visits."""
    scores: dict[Names, float] = {(): score(())}
    frontier: list[Names] = [()]
    for _ in range(depth):
        fresh: dict[Names, float] = {}
        for names in frontier:
            for extra in _extensions(space, names):
                grown = tuple(sorted((*names, *extra)))
                if len(grown) <= depth and grown not in scores and grown not in fresh:
                    fresh[grown] = score(grown)
        scores.update(fresh)
        frontier = sorted(fresh, key=lambda names: (-fresh[names], names))[:BEAM]
    return scores


def _extensions(space: ParameterSpace, names: Names) -> list[Names]:
    """Return what may be added in one step: an effect, or an effect together with one that it requires."""
    free = [name for name in space.candidates if name not in names]
    alone = {name for name in free if space.admissible((*names, name))}
    out: list[Names] = [(name,) for name in free if name in alone]
    pairs = [pair for pair in combinations(free, 2) if not set(pair) <= alone]
    return out + [pair for pair in pairs if space.admissible((*names, *pair))]


def _proposals(scores: dict[Names, float], current: Names) -> list[Names]:
    """Return the best set overall, the best with one more, the best with one swapped, and every set with one
    fewer that may still be it.
    """
    order = sorted(scores, key=lambda names: (-scores[names], names))
    have = set(current)
    more = [n for n in order if len(n) > len(have) and have <= set(n)][:1]
    swapped = (
        [n for n in order if len(n) == len(have) and len(set(n) & have) == len(have) - 1][:1] if have else []
    )
    least = scores[order[0]] - RULES.worth_fitting_nats
    fewer = [n for n in order if len(n) == len(have) - 1 and set(n) <= have and scores[n] > least]
    return [*order[:1], *more, *swapped, *fewer]


def _is_supported(fitter: Fitter[F], fit: F) -> bool:
    """Return whether every effect of the set is present, and what it acts through large enough to carry it.

    One that is within its tolerance is not there; one that only its bounds hold explains something else. Wind
    on a drag within tolerance is a force of some 0.01 m/s^2, as the slow part of turbulence is.
    """
    space = fitter.space
    if any(space.bounded(fit.theta_scaled)[i] for name in fit.effects for i in space.groups[name]):
        return False
    size = sizes(fitter, fit)
    found = {name for name in fit.effects if size[name] > RULES.carrier_tolerances}
    needs = (space.effect(name).requires_any for name in fit.effects)
    return all(share > RULES.present_tolerances for share in size.values()) and all(
        not any_of or found & set(any_of) for any_of in needs
    )


def sizes(fitter: Fitter[F], fit: F) -> dict[str, float]:
    """How many tolerances each effect of the set is from not being there, by its greatest strength."""
    space = fitter.space
    strengths = {name: [i for i in space.groups[name] if space.columns[i].strength] for name in fit.effects}
    return {
        name: max(abs(fit.theta_scaled[i]) / fitter.prior.spike[i] for i in own)
        for name, own in strengths.items()
    }


def _most_parsimonious(fits: Mapping[Names, F]) -> F:
    """Return the smallest set within RULES.tie_nats of the greatest evidence; of several, the most
    probable.
    """
    top = max(fit.log_evidence for fit in fits.values())
    close = [fit for fit in fits.values() if fit.log_evidence > top - RULES.tie_nats]
    return min(close, key=lambda fit: (len(fit.effects), -fit.log_evidence, fit.effects))


def _scores(
    fitter: Fitter[F], kept: F, fits: Mapping[Names, F], left_out: frozenset[Names]
) -> dict[Names, float]:
    """Log evidence of the fitted sets and, as linearised, of the kept fit's neighbours."""
    depth = min(RULES.max_effects, len(kept.effects) + 1)
    score = fitter.scorers(kept)[-1]
    shift = kept.log_evidence - score(kept.effects)
    scores = {names: value + shift for names, value in screen(fitter.space, score, depth).items()}
    scores.update({names: fit.log_evidence for names, fit in fits.items()})
    return {names: value for names, value in scores.items() if names not in left_out}
