"""What the data does not exclude: aliases of the selected effects, further effects, the pair to separate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trimtab.host.trace.decision.rules import Rules
from trimtab.host.trace.parameters import ParameterSpace

Names = tuple[str, ...]
Aliases = Mapping[str, Mapping[str, float]]
"""For each selected effect: the effects that could replace it, with their probabilities."""


def aliases_of(
    selected: Sequence[str], posterior_weights: Mapping[Names, float], space: ParameterSpace, rules: Rules
) -> dict[str, dict[str, float]]:
    """Return, for each selected effect, its probable aliases, most probable first.

    posterior_weights: relative, of every supported set.
    """
    return {name: _substitutes(name, selected, posterior_weights, space, rules) for name in selected}


def _substitutes(
    name: str,
    selected: Sequence[str],
    posterior_weights: Mapping[Names, float],
    space: ParameterSpace,
    rules: Rules,
) -> dict[str, float]:
    """Return the unselected candidates that may stand in place of `name`, with their probabilities.

    It is the posterior probability of the sets that contain the candidate but not `name`. Those above
    RULES.alias_probability are returned, and further ones until the sets with `name` or one of them hold
    all but RULES.alias_probability of the posterior.
    """
    total = sum(posterior_weights.values())
    without = {names: w / total for names, w in posterior_weights.items() if name not in names}
    shares = {
        other: sum(share for names, share in without.items() if other in names)
        for other in space.candidates
        if other not in selected
    }
    probabilities: dict[str, float] = {}
    for other, share in sorted(shares.items(), key=lambda item: -item[1]):
        left = sum(w for names, w in without.items() if not set(names) & set(probabilities))
        if share <= rules.alias_probability and left <= rules.alias_probability:
            break
        if share > 0.0:
            probabilities[other] = share
    return probabilities


def with_undetectable(
    aliases: Aliases, space: ParameterSpace, detectability: Mapping[str, float], rules: Rules
) -> dict[str, dict[str, float]]:
    """Return `aliases` together with the known aliases that the data would not show at typical size.

    The data cannot contradict these, so each gets RULES.open_probability. detectability: sigma by which each
    effect of typical size would show.
    """
    undetectable = [
        name
        for name, sigma in detectability.items()
        if sigma < rules.detectable_sigma and name not in aliases
    ]
    extended: dict[str, dict[str, float]] = {}
    for name, others in aliases.items():
        known = [other for other in undetectable if space.are_aliases(name, other)]
        open_ones = {other: rules.open_probability for other in known if not space.effects[other].one_of}
        extended[name] = {**open_ones, **others}
    return extended


def with_each_other(aliases: Aliases, space: ParameterSpace, rules: Rules) -> dict[str, dict[str, float]]:
    """Return `aliases` together with the known aliases among the selected effects themselves.

    Used if there are no whole flights or no repeat flights. No effect's equation is exact, so a
    stated alias may have been selected only because it explains the error of another selected effect's
    equation. An effect that acts through another one is no alias of it.
    """
    extended = {name: dict(others) for name, others in aliases.items()}
    for name in aliases:
        effect = space.effect(name)
        for other in aliases:
            second = space.effect(other)
            coupled = second.name in effect.requires_any or effect.name in second.requires_any
            if not coupled and space.are_aliases(name, other):
                extended[name][other] = rules.open_probability
    return extended


def possible_beside(
    selected: Sequence[str], aliases: Aliases, inclusion_probability: Mapping[str, float], rules: Rules
) -> dict[str, float]:
    """Return the effects that may be present in addition to the selected ones, most probable first."""
    substitutes = {other for others in aliases.values() for other in others}
    possible = {
        name: probability
        for name, probability in inclusion_probability.items()
        if name not in selected and name not in substitutes and probability > rules.alias_probability
    }
    return dict(sorted(possible.items(), key=lambda item: -item[1]))


def pair_to_separate(
    aliases: Aliases, inclusion_probability: Mapping[str, float], rules: Rules
) -> tuple[str, str] | None:
    """Return the selected effect and its most probable alias, which the next flight should separate.

    If nothing was selected, return the two most probable candidates. None if there is no such pair.
    """
    pairs = [
        (probability, name, other)
        for name, others in aliases.items()
        for other, probability in others.items()
    ]
    if pairs:
        return max(pairs)[1:]
    probable = sorted(
        ((p, name) for name, p in inclusion_probability.items() if p > rules.alias_probability), reverse=True
    )
    return (probable[0][1], probable[1][1]) if not aliases and len(probable) > 1 else None
