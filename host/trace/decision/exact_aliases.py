"""Effects that fit every flight exactly alike: what flights show of two such, and what tells them apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trimtab.host.effects import Effect, ExactAlias
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.parameters import ParameterSpace


@dataclass(frozen=True, kw_only=True)
class ObservedAlias:
    """An exact alias with what these flights show of the pair: their ratio, where that is observable."""

    alias: ExactAlias
    finding: Finding


def exact_aliases(
    space: ParameterSpace, theta_scaled: np.ndarray, covariance: np.ndarray, name: str
) -> dict[str, ObservedAlias]:
    """Return what no flight tells from the effect `name`, by the other effect's name.

    An effect that the space does not hold, or whose value was measured, is left out.

    Parameters
    ----------
    z : (P,)
        Scaled parameters where the effects were fitted.
    covariance : (P, P)
        Their covariance.
    """
    observed: dict[str, ObservedAlias] = {}
    for effect in space.effects.values():
        for alias in effect.exact_aliases:
            pair = effect.name, alias.effect
            if name not in pair or not set(pair) <= set(space.owners):
                continue
            other = alias.effect if name == effect.name else effect.name
            if _is_measured(space, other):
                continue
            finding = Finding(code=Code.EXACT_ALIAS, subject=(name, other))
            if alias.ratio is not None:
                ratio, sd = _ratio(space, theta_scaled, covariance, effect, space.effects[alias.effect])
                finding = replace(finding, value=ratio, details={"sd": sd})
            observed[other] = ObservedAlias(alias=alias, finding=finding)
    return observed


def _is_measured(space: ParameterSpace, name: str) -> bool:
    """Whether the first parameter of an effect was measured, by its tolerance."""
    least = space.effects[name].parameters[0].measured_below
    return least is not None and space.columns[space.owners[name][0]].tolerance < least


def _ratio(
    space: ParameterSpace, theta_scaled: np.ndarray, covariance: np.ndarray, over: Effect, under: Effect
) -> tuple[float, float]:
    """Return the ratio of two effects' first parameters, each over neutral, and its sd to first order."""
    pair = [space.owners[over.name][0], space.owners[under.name][0]]
    neutral = np.array([over.neutral[0], under.neutral[0]])
    scale = space.scale[pair] / neutral
    a, b = space.values(theta_scaled)[pair] / neutral
    physical = covariance[np.ix_(pair, pair)] * np.outer(scale, scale)
    slope = np.array([1.0 / b, -a / b**2])
    return float(a / b), float(np.sqrt(slope @ physical @ slope))
