"""How names are compared: what counts as the same effect, which family it is of, which was named first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from trimtab.sitl.studies.worlds import SAME_RATIO

RATIO = "thrust-over-mass"
"""What a flight shows of mass and thrust gain."""

_WEIGHT = frozenset({"mass", "thrust-gain"})

FAMILIES = {
    "linear-drag": "aerodynamic",
    "quadratic-drag": "aerodynamic",
    "wind": "aerodynamic",
    "translational-lift": "aerodynamic",
    "thrust-inflow": "aerodynamic",
    "ground-effect": "aerodynamic",
    "motor-lag": "timing",
    "actuation-delay": "timing",
    "mocap-latency": "timing",
    "com-offset": "torque",
    "rotor-loss": "torque",
    "inertia": "torque",
    "gyroscopic": "torque",
    "torque-bias": "torque",
}
"""Family of each effect for coverage; one that is not listed acts as a force."""


def family(name: str) -> str:
    """The family of an effect: aerodynamic, timing, torque or force."""
    return FAMILIES.get(name, "force")


def collapsed(names: Iterable[str], truth: Iterable[str]) -> frozenset[str]:
    """`names` with everything that fits exactly alike under one name.

    Mass and thrust gain are told apart by no flight. Thrust, mass and inertia together show two ratios only:
    where mass or thrust gain is true, an inertia beside its alias says the same thing again.
    """
    found = set(names)
    if not found & _WEIGHT:
        return frozenset(found)
    found -= _WEIGHT
    if set(truth) & _WEIGHT:
        found -= SAME_RATIO
    return frozenset({RATIO, *found})


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
