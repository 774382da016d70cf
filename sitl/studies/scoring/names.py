"""How names are compared: what counts as the same effect, and which was named first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from trimtab.host.effects import Effect


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Effects of which flights show ratios only.

    Attributes
    ----------
    name
        What flights do show of the two that fit exactly alike.
    over, under
        Those two: the ratio is of the first one's first parameter to the second one's.
    relative
        Effects that flights show relative to one of the two.
    """

    name: str
    over: Effect
    under: Effect
    relative: frozenset[str]

    @property
    def alike(self) -> frozenset[str]:
        """Names of the two that fit exactly alike."""
        return frozenset({self.over.name, self.under.name})

    @property
    def effects(self) -> frozenset[str]:
        """Names of all of them: no flight tells any two apart."""
        return self.alike | self.relative


def ratios(effects: Mapping[str, Effect]) -> list[Ratio]:
    """Return the ratios that flights show in place of what the effects themselves are."""
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


def collapsed(names: Iterable[str], truth: Iterable[str], effects: Mapping[str, Effect]) -> frozenset[str]:
    """`names` with everything that fits exactly alike under one name.

    Mass and thrust gain are told apart by no flight. Thrust, mass and inertia together show two ratios only:
    where mass or thrust gain is true, an inertia beside its alias says the same thing again.
    """
    found, true = set(names), set(truth)
    for ratio in ratios(effects):
        if found & ratio.alike:
            found -= ratio.effects if true & ratio.alike else ratio.alike
            found.add(ratio.name)
    return frozenset(found)


def ordered(effects: Iterable[Mapping[str, Any]]) -> list[str]:
    """Names of a verdict's effects, the surest first: by probability, then by size in standard deviations."""

    def sureness(effect: Mapping[str, Any]) -> tuple[float, float]:
        size = sum(
            _score(p["value"], p["sd"], effect["neutral"].get(k, 0.0))
            for k, p in effect["parameters"].items()
        )
        return effect["probability"], size

    return [effect["name"] for effect in sorted(effects, key=sureness, reverse=True)]


def _score(value: float, sd: float, neutral: float) -> float:
    """Squared distance from neutral in standard deviations."""
    return ((value - neutral) / sd) ** 2 if sd > 0.0 else math.inf
