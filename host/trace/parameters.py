"""The scaled parameter space that tracing searches: the candidates' parameters and the adjustments beside
them.

Every parameter is a column z = (value - neutral) / scale. Candidates can be selected; adjustments never are:
they move within their tolerance, or freely where a log declares them unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.errors import UsageError
from trimtab.host.trace.evidence import Prior
from trimtab.host.vehicle import Vehicle

MASS = "mass"
"""Never a candidate: exactly thrust's alias. It moves within its tolerance, so that a gain's interval holds
it.
"""

_THRUST = ("thrust-gain", "battery-sag", "ground-effect", "rotor-loss")
_TURNING = ("com-offset", "torque-bias", "rotor-loss", "gyroscopic", "inertia")
_COMMANDS = ("motor-lag", "actuation-delay")

REPLACES: Mapping[str, tuple[str, ...]] = {
    "thrust": (*_THRUST, *_COMMANDS, "thrust-inflow", "translational-lift"),
    "thrust-curve": ("thrust-gain",),
    "motor-lag": _COMMANDS,
    "mounting-tilt": (),
    "frame-tilt": ("wind", "frame-tilt"),
    "inertia": ("inertia", "gyroscopic"),
    "torque": (*_TURNING, "actuation-delay"),
    "pose-latency": ("mocap-latency",),
}
"""Effects that a declared unknown takes out of the candidates: a nuisance explains the same thing."""

UNKNOWN = tuple(REPLACES)
"""What an import profile may declare unknown; it is then estimated as nuisance and not counted as an
effect.
"""

DISCREPANCY: Mapping[str, float] = {
    "motor-lag": 0.25,
    "actuation-delay": 0.4,
    "mocap-latency": 0.1,
    "inertia": 0.2,
    "slung-payload.ratio": 0.15,
    "slung-payload.length_m": 1.0,
}
"""One sigma, in typical sizes, of what segments read into an effect that is not there, 0.05 for the others:
rotors are no first-order lag, and what the loop does about noise within a step looks like a wrong one. A
payload pulls against slow changes of speed as a scale error of a hundredth of the attitude or the thrust
does, and the line of one too light to name may have any length."""

_FREE = {
    "motor-lag": ("motor-lag", (0.05,)),
    "frame-tilt": ("frame-tilt", (0.02, 0.02)),
    "inertia": ("inertia", (0.5, 0.5, 0.5)),
    "pose-latency": ("mocap-latency", (0.02,)),
}
"""Unknowns that are an effect of the library left free: its name, and one sigma of each parameter."""

_EITHER_SIGN = frozenset({"mocap-latency"})
"""Effects that, left free, take either sign: two clocks that were brought together afterwards."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """One scaled parameter: whose it is, how it scales, and one sigma of what is not worth naming.

    `discrepancy`: one sigma, in scales, of what the library's form of things may be off by here. `strength`:
    whether the effect is there where this one alone is off neutral.
    """

    owner: str
    key: str
    unit: str
    neutral: float
    scale: float
    tolerance: float
    lower: float
    upper: float
    discrepancy: float = 0.0
    strength: bool = True

    def __post_init__(self) -> None:
        if not self.scale > 0 or not self.tolerance > 0:
            raise ValueError(f"{self.owner}.{self.key}: scale and tolerance must be positive")


@dataclass(frozen=True, kw_only=True)
class Space:
    """The columns of a trace and who owns them.

    `candidates` may be selected, the other owners are adjustments; of these the logs declare `unknown` ones.
    A candidate is an effect's name, or "effect.key" where one parameter of several leaves neutral.
    """

    columns: tuple[Column, ...]
    effects: Mapping[str, Effect]
    candidates: tuple[str, ...]
    unknown: tuple[str, ...]
    local_sigma: tuple[float, ...]

    @cached_property
    def owners(self) -> dict[str, tuple[int, ...]]:
        """Column indices by owner: an effect or another adjustment."""
        found: dict[str, tuple[int, ...]] = {}
        for index, column in enumerate(self.columns):
            found[column.owner] = (*found.get(column.owner, ()), index)
        return found

    @cached_property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Column indices by candidate or adjustment."""
        found: dict[str, tuple[int, ...]] = {}
        for owner, indices in self.owners.items():
            keys = [self.columns[i].key for i in indices]
            split = owner in self.effects and self.effects[owner].one_of
            found.update(
                {f"{owner}.{k}": (i,) for k, i in zip(keys, indices, strict=True)}
                if split
                else {owner: indices}
            )
        return found

    def effect(self, candidate: str) -> Effect:
        """The effect that a candidate is, or is one parameter of."""
        return self.effects[candidate.partition(".")[0]]

    @property
    def parts(self) -> tuple[str, ...]:
        """Effects that act in the roll-outs, in the order of their columns."""
        return tuple(name for name in self.owners if name in self.effects)

    @property
    def scale(self) -> np.ndarray:
        """Scales (P,)."""
        return np.array([column.scale for column in self.columns])

    @property
    def prior(self) -> Prior:
        """Spike sigmas in scaled units with the groups."""
        spike = np.array([np.hypot(c.tolerance / c.scale, c.discrepancy) for c in self.columns])
        return Prior(groups=self.groups, spike=spike, local=np.array(self.local_sigma))

    def values(self, z: np.ndarray) -> np.ndarray:
        """Physical values of scaled parameters; z is (P,) or (P, lanes)."""
        neutral = np.array([column.neutral for column in self.columns])
        shape = (-1,) + (1,) * (z.ndim - 1)
        return neutral.reshape(shape) + self.scale.reshape(shape) * z

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest z (P,)."""
        limits = [((c.lower - c.neutral) / c.scale, (c.upper - c.neutral) / c.scale) for c in self.columns]
        lower, upper = np.array(limits).T
        return lower, upper

    def clipped(self, z: np.ndarray) -> np.ndarray:
        """z (P,) moved inside every parameter's bounds."""
        return np.clip(z, *self.bounds)

    def check_finite(self, sizes: np.ndarray) -> None:
        """Refuse roll-outs that diverge: sizes (1 + P,) of the residual and of each parameter's slope.

        Raises UsageError that names the parameter, or the effects with states of their own.
        """
        bad = np.flatnonzero(~np.isfinite(sizes))
        if not len(bad):
            return
        if bad[0] == 0:
            own = [name for name in self.parts if self.effects[name].memory] or list(self.parts)
            what = f"the model with {', '.join(own)}"
        else:
            what = f"{self.columns[bad[0] - 1].owner}.{self.columns[bad[0] - 1].key}"
        raise UsageError(f"roll-outs with {what} diverge; bound what the effect's slots give, or take it out")

    def bounded(self, z: np.ndarray) -> np.ndarray:
        """Which entries (P,) stand at a bound that is not neutral."""
        lower, upper = self.bounds
        return ((z <= lower + 1e-9) & (lower < 0.0)) | ((z >= upper - 1e-9) & (upper > 0.0))

    def theta(self, values: Sequence[Any]) -> dict[str, tuple[Any, ...]]:
        """Parameter values by owner, in the order of each owner's keys."""
        return {owner: tuple(values[i] for i in indices) for owner, indices in self.owners.items()}

    def admissible(self, selected: Iterable[str]) -> bool:
        """Whether every effect of the set finds what it requires in it, and none is in it twice."""
        chosen = [self.effect(candidate) for candidate in selected]
        names = {effect.name for effect in chosen}
        needs = (effect.requires_any for effect in chosen)
        return len(names) == len(chosen) and all(not any_of or names & set(any_of) for any_of in needs)


_THRUST_CURVE = (("log_gain", 0.1, 1.5), ("linear", 0.2, 1.0))
"""The adjustment for an unknown thrust curve: key, scale, bound."""


def space(vehicle: Vehicle, effects: Mapping[str, Effect], unknown: Iterable[str] = ()) -> Space:
    """The space for a vehicle, the candidate effects and what the logs declare unknown."""
    unknown = frozenset(unknown)
    strange = unknown - set(UNKNOWN)
    if strange:
        raise ValueError(f"unknown to tracing: {sorted(strange)}; a log may declare {UNKNOWN}")
    replaced = {name for item in unknown for name in REPLACES[item]}
    free = dict(_FREE[item] for item in unknown if item in _FREE)
    acting = [name for name in effects if name not in replaced or name in free]
    columns = [
        Column(
            owner=name,
            key=p.key,
            unit=p.unit,
            neutral=p.neutral,
            scale=p.typical,
            tolerance=free[name][i] if name in free else tolerance_of(vehicle, name, p.key, p.tolerance),
            lower=-p.upper if name in free and name in _EITHER_SIGN else p.lower,
            upper=p.upper,
            discrepancy=DISCREPANCY.get(f"{name}.{p.key}", DISCREPANCY.get(name, 0.05)),
            strength=p.strength,
        )
        for name in acting
        for i, p in enumerate(effects[name].parameters)
    ]
    if "thrust-curve" in unknown:
        columns += [
            Column(
                owner="thrust-curve", key=key, unit="1", neutral=0.0, scale=scale, tolerance=0.5,
                lower=-bound, upper=bound,
            )
            for key, scale, bound in _THRUST_CURVE
        ]  # fmt: skip
    mounting = 0.1 if "mounting-tilt" in unknown else 0.001
    torque = 0.02 if "torque" in unknown else 0.3
    accelerometer = 0.5 if "mounting-tilt" in unknown else 0.05
    whole = Space(
        columns=tuple(columns),
        effects=dict(effects),
        candidates=(),
        unknown=(*free, *(("thrust-curve",) if "thrust-curve" in unknown else ())),
        local_sigma=(mounting,) * 3 + (torque,) * 3 + (accelerometer,) * 3,
    )
    fixed = {MASS, *whole.unknown}
    candidates = tuple(name for name in whole.groups if name.partition(".")[0] not in fixed)
    return replace(whole, candidates=candidates)


def tolerance_of(vehicle: Vehicle, owner: str, key: str, default: float) -> float:
    """One sigma of "effect.parameter": the vehicle file's where it gives one, else the candidate's
    default.
    """
    return float(vehicle.tolerance(owner, key, default))
