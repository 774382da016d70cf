"""Exact aliases: pairs of effects that fit every flight equally well, and their ratio.

Flights may determine the ratio of the parameters of the two effects, but not the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from trimtab.host.effects import Effect, ExactAlias
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.parameters import ParameterSpace


@dataclass(frozen=True, kw_only=True)
class ObservedAlias:
    """An exact alias, with a finding on what the flights show of the pair: their ratio, if observable."""

    alias: ExactAlias
    finding: Finding


def exact_aliases(
    space: ParameterSpace,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    covariance: Annotated[np.ndarray, "parameters parameters"],
    name: str,
) -> dict[str, ObservedAlias]:
    """Return the exact aliases of the effect `name`, by the name of the other effect.

    Effects that the space does not hold, or whose value was measured, are left out.

    Parameters
    ----------
    space
        Parameter space.
    theta_scaled, covariance
        Estimate and its covariance, scaled.
    name
        Name of the effect.
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
    """Return whether the first parameter of an effect counts as measured.

    It does if its tolerance is below `Parameter.measured_below`.
    """
    bound = space.effects[name].parameters[0].measured_below
    return bound is not None and space.columns[space.owners[name][0]].tolerance < bound


def _ratio(
    space: ParameterSpace,
    theta_scaled: np.ndarray,
    covariance: np.ndarray,
    numerator: Effect,
    denominator: Effect,
) -> tuple[float, float]:
    """Return the ratio of the first parameters of two effects, each over neutral, and its standard deviation.

    The standard deviation is to first order.
    """
    pair = [space.owners[numerator.name][0], space.owners[denominator.name][0]]
    neutral = np.array([numerator.neutral[0], denominator.neutral[0]])
    scale = space.scale[pair] / neutral
    a, b = space.values(theta_scaled)[pair] / neutral
    physical = covariance[np.ix_(pair, pair)] * np.outer(scale, scale)
    slope = np.array([1.0 / b, -a / b**2])
    return float(a / b), float(np.sqrt(slope @ physical @ slope))
