"""Comparison of names: which effects count as the same, and which was named first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from trimtab.host.effects import Effect


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Effects of which flights show only ratios.

    Attributes
    ----------
    name
        Name of the ratio of the two exact aliases.
    over, under
        The exact aliases: the ratio is that of their first parameters.
    relative
        Effects that flights show only relative to one of the two.
    """

    name: str
    over: Effect
    under: Effect
    relative: frozenset[str]

    @property
    def alike(self) -> frozenset[str]:
        """Names of the two exact aliases."""
        return frozenset({self.over.name, self.under.name})

    @property
    def effects(self) -> frozenset[str]:
        """Names of all effects of the ratio, which flights cannot distinguish."""
        return self.alike | self.relative


def ratios(effects: Mapping[str, Effect]) -> list[Ratio]:
    """Return the ratios that flights show instead of the effects themselves."""
    return [
        Ratio(
            name=alias.ratio.replace(" ", "-"),
            over=effect,
            under=effects[alias.effect],
            relative=frozenset(
                other.name
                for other in effects.values()
                if other.observed_relative_to in (effect.name, alias.effect)
            ),
        )
        for effect in effects.values()
        for alias in effect.exact_aliases
        if alias.ratio is not None
    ]


def collapsed(
    names: Iterable[str],
    truth: Iterable[str],
    effects: Mapping[str, Effect],
    brought: frozenset[str] = frozenset(),
) -> frozenset[str]:
    """Return `names` with exact aliases under one name, and without those that the truth brings with it.

    No flight distinguishes mass from thrust gain. Thrust, mass and inertia together show only two ratios: if
    mass or thrust gain is true, an inertia beside the alias is the same statement again.
    """
    merged, true = set(names), set(truth)
    for ratio in ratios(effects):
        if merged & ratio.alike:
            merged -= ratio.effects if true & ratio.alike else ratio.alike
            merged.add(ratio.name)
    return frozenset(merged) - (brought - true)


def effect_of(name: str) -> str:
    """Return the effect of a candidate, which may be only one of its parameters, such as one rotor."""
    return name.partition(".")[0]


def with_scored_names(
    answer: Mapping[str, Any], drawn: Mapping[str, Mapping[str, float]], effects: Mapping[str, Effect]
) -> dict[str, Any]:
    """Return an answer with the names of named and possible effects by which they are scored.

    A candidate counts as its effect, and the candidates of one effect once, with the greatest probability. If
    only one parameter of an effect acts, such as the loss of one rotor, and the answer states another one
    than was drawn, its name is that of the candidate, which is not there. drawn: values of the world's
    effects.
    """

    def scored(name: str, keys: Iterable[str]) -> str:
        effect = effects[effect_of(name)]
        if not effect.one_of or effect.name not in drawn:
            return effect.name
        neutral = dict(zip(effect.keys, effect.neutral, strict=True))
        there = any(drawn[effect.name].get(key, neutral[key]) != neutral[key] for key in keys)
        return effect.name if there else f"{effect.name}.{min(keys)}"

    possible: dict[str, float] = {}
    for each in answer.get("possible", ()):
        name = scored(each["name"], [each["name"].partition(".")[2]] if "." in each["name"] else ())
        possible[name] = max(each["probability"], possible.get(name, 0.0))
    return {
        **answer,
        "effects": [
            {**each, "name": scored(each["name"], each["parameters"])} for each in answer.get("effects", ())
        ],
        "possible": [{"name": name, "probability": p} for name, p in possible.items()],
    }


def ordered(effects: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the names of a verdict's effects by probability, then by size in standard deviations."""

    def sureness(effect: Mapping[str, Any]) -> tuple[float, float]:
        size = sum(
            _score(p["value"], p["sd"], effect["neutral"].get(k, 0.0))
            for k, p in effect["parameters"].items()
        )
        return effect["probability"], size

    return [effect["name"] for effect in sorted(effects, key=sureness, reverse=True)]


def _score(value: float, sd: float, neutral: float) -> float:
    """Return the squared distance from neutral in standard deviations."""
    return ((value - neutral) / sd) ** 2 if sd > 0.0 else math.inf
