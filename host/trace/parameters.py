"""The scaled parameter space that tracing searches: the candidates' parameters and the adjustments beside
them.

Every parameter is a column theta_scaled = (value - neutral) / scale. Candidates can be selected; adjustments
never are: they move within their tolerance, or freely where a log declares them unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from trimtab.host.base.errors import UsageError
from trimtab.host.effects import Effect, Parameter
from trimtab.host.effects.parameter import LOOP_DISCREPANCY
from trimtab.host.effects.unknowns import MOUNTING_TILT, THRUST_CURVE, TORQUE, UNKNOWN
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class Column:
    """One scaled parameter: whose it is, how it scales, and one sigma of what is not worth naming.

    `discrepancy`: one sigma, in scales, of what the library's form of things may be off by here in segments;
    `loop_discrepancy`: the same over the closed loop. `strength`: whether the effect is there where this one
    alone is off neutral.
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
    loop_discrepancy: float = LOOP_DISCREPANCY
    strength: bool = True

    def __post_init__(self) -> None:
        if not self.scale > 0 or not self.tolerance > 0:
            raise ValueError(f"{self.owner}.{self.key}: scale and tolerance must be positive")


@dataclass(frozen=True, kw_only=True)
class ParameterSpace:
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
        """Return the effect that a candidate is, or is one parameter of."""
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

    def values(self, theta_scaled: np.ndarray) -> np.ndarray:
        """Physical values of scaled parameters; z is (P,) or (P, lanes)."""
        neutral = np.array([column.neutral for column in self.columns])
        shape = (-1,) + (1,) * (theta_scaled.ndim - 1)
        return neutral.reshape(shape) + self.scale.reshape(shape) * theta_scaled

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest theta_scaled (P,)."""
        limits = [((c.lower - c.neutral) / c.scale, (c.upper - c.neutral) / c.scale) for c in self.columns]
        lower, upper = np.array(limits).T
        return lower, upper

    def clipped(self, theta_scaled: np.ndarray) -> np.ndarray:
        """Return theta_scaled (P,) moved inside every parameter's bounds."""
        return np.clip(theta_scaled, *self.bounds)

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

    def bounded(self, theta_scaled: np.ndarray) -> np.ndarray:
        """Which entries (P,) stand at a bound that is not neutral."""
        lower, upper = self.bounds
        return ((theta_scaled <= lower + 1e-9) & (lower < 0.0)) | (
            (theta_scaled >= upper - 1e-9) & (upper > 0.0)
        )

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


def space(vehicle: Vehicle, effects: Mapping[str, Effect], unknown: Iterable[str] = ()) -> ParameterSpace:
    """Return the space for a vehicle, the candidate effects and what the logs declare unknown."""
    unknown = frozenset(unknown)
    strange = unknown - set(UNKNOWN)
    if strange:
        raise ValueError(f"unknown to tracing: {sorted(strange)}; a log may declare {UNKNOWN}")
    free = [name for name, effect in effects.items() if unknown & set(effect.freed_by)]
    acting = [name for name in effects if name in free or not unknown & set(effects[name].replaced_by)]
    columns = [
        _column(vehicle, name, p, free=name in free) for name in acting for p in effects[name].parameters
    ]
    if THRUST_CURVE in unknown:
        columns += [
            Column(
                owner=THRUST_CURVE, key=key, unit="1", neutral=0.0, scale=scale, tolerance=0.5,
                lower=-bound, upper=bound,
            )
            for key, scale, bound in _THRUST_CURVE
        ]  # fmt: skip
    tilted = MOUNTING_TILT in unknown
    mounting = RULES.free_mounting_sigma_rad if tilted else RULES.mounting_sigma_rad
    torque = RULES.gyro_bias_sigma_rad_s if TORQUE in unknown else RULES.torque_sigma_rad_s2
    accelerometer = RULES.free_force_bias_sigma_m_s2 if tilted else RULES.force_bias_sigma_m_s2
    whole = ParameterSpace(
        columns=tuple(columns),
        effects=dict(effects),
        candidates=(),
        unknown=(*free, *({THRUST_CURVE} & unknown)),
        local_sigma=(mounting,) * 3 + (torque,) * 3 + (accelerometer,) * 3,
    )
    fixed = {*whole.unknown, *(name for name, effect in effects.items() if effect.adjustment)}
    candidates = tuple(name for name in whole.groups if name.partition(".")[0] not in fixed)
    return replace(whole, candidates=candidates)


def _column(vehicle: Vehicle, owner: str, parameter: Parameter, *, free: bool) -> Column:
    """Return the column of an effect's parameter, with the vehicle file's tolerance where it gives one;
    `free` where a log leaves the effect free.
    """
    tolerance = float(vehicle.tolerance(owner, parameter.key, parameter.tolerance))
    lower, upper = parameter.lower, parameter.upper
    if free:
        tolerance = parameter.typical if parameter.free_sigma is None else parameter.free_sigma
        lower, upper = parameter.free_bounds
    return Column(
        owner=owner,
        key=parameter.key,
        unit=parameter.unit,
        neutral=parameter.neutral,
        scale=parameter.typical,
        tolerance=tolerance,
        lower=lower,
        upper=upper,
        discrepancy=parameter.discrepancy,
        loop_discrepancy=parameter.loop_discrepancy,
        strength=parameter.strength,
    )
