"""The scaled parameter space that tracing searches: the candidates' parameters and the adjustments beside
them.

Every parameter is a column z = (value - neutral) / scale. Candidates can be selected; adjustments never are:
they move within their tolerance, or freely where a log declares them unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from host.effects import Effect
from host.trace.evidence import Prior
from host.vehicle import Vehicle

UNKNOWN = (
    "thrust",
    "thrust-curve",
    "motor-lag",
    "mounting-tilt",
    "frame-tilt",
    "inertia",
    "torque",
    "pose-latency",
)
"""What an import profile may declare unknown; it is then estimated as nuisance and not counted as an
effect.
"""

MASS = "mass"
"""Never a candidate: exactly thrust's alias. It moves within its tolerance, so that a gain's interval holds
it.
"""

REPLACES = {
    "thrust": ("thrust-gain", "battery-sag", "motor-lag"),
    "thrust-curve": ("thrust-gain",),
    "motor-lag": ("motor-lag",),
    "mounting-tilt": (),
    "frame-tilt": ("wind",),
    "inertia": (),
    "torque": ("com-offset",),
    "pose-latency": ("mocap-latency",),
}
"""Effects that a declared unknown takes out of the candidates: the nuisance explains the same thing."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """One scaled parameter: whose it is, how it scales, and one sigma of what is not worth naming."""

    owner: str
    key: str
    unit: str
    neutral: float
    scale: float
    tolerance: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not self.scale > 0 or not self.tolerance > 0:
            raise ValueError(f"{self.owner}.{self.key}: scale and tolerance must be positive")


@dataclass(frozen=True, kw_only=True)
class Space:
    """The columns of a trace and who owns them.

    `candidates` may be selected, the other owners are adjustments; of these the logs declare `unknown` ones.
    """

    columns: tuple[Column, ...]
    effects: Mapping[str, Effect]
    candidates: tuple[str, ...]
    unknown: tuple[str, ...]
    local_sigma: tuple[float, ...]

    @property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Column indices by owner."""
        groups: dict[str, tuple[int, ...]] = {}
        for index, column in enumerate(self.columns):
            groups[column.owner] = (*groups.get(column.owner, ()), index)
        return groups

    @property
    def parts(self) -> tuple[str, ...]:
        """Effects that act in the roll-outs: the candidates, and mass, which only thrust over mass shows."""
        return tuple(name for name in self.groups if name in self.effects)

    @property
    def scale(self) -> np.ndarray:
        """Scales (P,)."""
        return np.array([column.scale for column in self.columns])

    @property
    def prior(self) -> Prior:
        """Spike sigmas in scaled units with the groups."""
        spike = np.array([column.tolerance / column.scale for column in self.columns])
        return Prior(groups=self.groups, spike=spike, local=np.array(self.local_sigma))

    def values(self, z: np.ndarray) -> np.ndarray:
        """Physical values of scaled parameters; z is (P,) or (P, lanes)."""
        neutral = np.array([column.neutral for column in self.columns])
        shape = (-1,) + (1,) * (z.ndim - 1)
        return neutral.reshape(shape) + self.scale.reshape(shape) * z

    def clipped(self, z: np.ndarray) -> np.ndarray:
        """z moved inside every parameter's bounds."""
        neutral = np.array([column.neutral for column in self.columns])
        lower = (np.array([column.lower for column in self.columns]) - neutral) / self.scale
        upper = (np.array([column.upper for column in self.columns]) - neutral) / self.scale
        return np.clip(z, lower, upper)

    def theta(self, values: Sequence[Any]) -> dict[str, tuple[Any, ...]]:
        """Parameter values by owner, in the order of each owner's keys."""
        return {owner: tuple(values[i] for i in indices) for owner, indices in self.groups.items()}

    def admissible(self, selected: Iterable[str]) -> bool:
        """Whether every effect of the set finds what it requires in it."""
        chosen = set(selected)
        needs = (self.effects[name].requires_any for name in chosen)
        return all(not any_of or chosen & set(any_of) for any_of in needs)


# Adjustments: key, unit, scale, tolerance, tolerance where declared unknown, bound. Inertia by axis as the
# logarithm of its factor; torque as a constant angular acceleration; frame tilt turns gravity in the world.
_ADJUSTMENTS = {
    "inertia": (
        ("x", "1", 0.1, 0.02, 0.5, 1.2),
        ("y", "1", 0.1, 0.02, 0.5, 1.2),
        ("z", "1", 0.1, 0.04, 0.5, 1.2),
    ),
    "frame-tilt": (("tilt_x", "rad", 0.01, 0.001, 0.02, 0.1), ("tilt_y", "rad", 0.01, 0.001, 0.02, 0.1)),
    "thrust-curve": (("log_gain", "1", 0.1, 1e-6, 0.5, 1.5), ("linear", "1", 0.2, 1e-6, 0.5, 1.0)),
    "motor-lag-unknown": (("extra_s", "s", 0.02, 1e-6, 0.05, 0.15),),
    "pose-latency": (("latency_s", "s", 0.01, 1e-6, 0.02, 0.1),),
}


_ONLY_WHERE_UNKNOWN = ("thrust-curve", "motor-lag-unknown", "pose-latency")


def space(vehicle: Vehicle, effects: Mapping[str, Effect], unknown: Iterable[str] = ()) -> Space:
    """The space for a vehicle, the candidate effects and what the logs declare unknown."""
    unknown = frozenset(unknown)
    strange = unknown - set(UNKNOWN)
    if strange:
        raise ValueError(f"unknown to tracing: {sorted(strange)}; a log may declare {UNKNOWN}")
    replaced = {name for item in unknown for name in REPLACES[item]}
    candidates = tuple(name for name in effects if name not in replaced and name != MASS)
    columns = [
        Column(
            owner=name,
            key=p.key,
            unit=p.unit,
            neutral=p.neutral,
            scale=p.typical,
            tolerance=tolerance_of(vehicle, name, p.key, p.tolerance),
            lower=p.lower,
            upper=p.upper,
        )
        for name in (*candidates, *(name for name in (MASS,) if name in effects))
        for p in effects[name].parameters
    ]
    for owner, rows in _ADJUSTMENTS.items():
        declared = owner.removesuffix("-unknown")
        if owner in _ONLY_WHERE_UNKNOWN and declared not in unknown:
            continue
        for key, unit, scale, known, free, bound in rows:
            sigma = free if declared in unknown else tolerance_of(vehicle, owner, key, known)
            columns.append(
                Column(
                    owner=owner,
                    key=key,
                    unit=unit,
                    neutral=0.0,
                    scale=scale,
                    tolerance=sigma,
                    lower=-bound,
                    upper=bound,
                )
            )
    mounting = 0.1 if "mounting-tilt" in unknown else 0.001
    torque = 0.02 if "torque" in unknown else 0.3
    accelerometer = 0.5 if "mounting-tilt" in unknown else 0.05
    return Space(
        columns=tuple(columns),
        effects=dict(effects),
        candidates=candidates,
        unknown=tuple(owner for owner in _ADJUSTMENTS if owner.removesuffix("-unknown") in unknown),
        local_sigma=(mounting,) * 3 + (torque,) * 3 + (accelerometer,) * 3,
    )


def tolerance_of(vehicle: Vehicle, owner: str, key: str, default: float) -> float:
    """One sigma of "effect.parameter": the vehicle file's where it gives one, else the candidate's
    default.
    """
    return float(vehicle.tolerance(owner, key, default))
