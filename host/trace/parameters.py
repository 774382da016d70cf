"""The scaled parameter space that tracing searches: parameters of the candidates and of the adjustments.

Every parameter is scaled: an entry of theta_scaled = (value - neutral) / scale. Candidates can be selected.
Adjustments never are: they move within their tolerance, or freely if a log frees them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from trimtab.host.base.errors import UsageError
from trimtab.host.effects import Effect, Parameter
from trimtab.host.effects.parameter import LOOP_DISCREPANCY
from trimtab.host.effects.unknowns import MOUNTING_TILT, THRUST_CURVE, TORQUE, UNKNOWN
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.vehicle import Vehicle


class RollOutDiverged(UsageError):
    """A roll-out of segments diverges."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """One scaled parameter.

    Attributes
    ----------
    owner, key, unit
        Owner: the effect that the parameter belongs to, or an adjustment without an effect, such as the
        thrust curve. Key within the owner. Unit.
    neutral
        Value that changes nothing.
    scale
        Value of one scaled unit: the typical size.
    tolerance
        Standard deviation of deviations from neutral that are too small to report.
    lower, upper
        Bounds of the value.
    discrepancy
        Standard deviation, scaled, of the value that segment fits show although the effect is absent.
    loop_discrepancy
        The same for fits to whole flights in closed loop.
    strength
        Whether the effect is present if only this parameter differs from neutral.
    form
        Whether this is a parameter of the form of the effect (`Parameter.form`).
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
    form: bool = False

    def __post_init__(self) -> None:
        if not self.scale > 0 or not self.tolerance > 0:
            raise ValueError(f"{self.owner}.{self.key}: scale and tolerance must be positive")


@dataclass(frozen=True, kw_only=True)
class ParameterSpace:
    """The scaled parameters of a trace.

    Attributes
    ----------
    columns
        The P parameters.
    effects
        Effects by name, of the candidates and of the adjustments.
    candidates
        Candidates that may be selected: the name of an effect, or "effect.key" if only one parameter of the
        effect leaves neutral (`Effect.one_of`). All other owners of columns are adjustments.
    freed
        Adjustments that the logs free, since the logs do not determine them.
    nuisance_sigma
        Prior standard deviations of the nuisances of a flight: mounting tilt rad; angular acceleration
        rad/s^2 or gyro bias rad/s; accelerometer bias m/s^2. Three each, FRD. Then, if two sets of
        flights are compared, the logarithm of the thrust scale.
    """

    columns: tuple[Column, ...]
    effects: Mapping[str, Effect]
    candidates: tuple[str, ...]
    freed: tuple[str, ...]
    nuisance_sigma: tuple[float, ...]

    @cached_property
    def owners(self) -> dict[str, tuple[int, ...]]:
        """Column indices by owner: an effect, or an adjustment that is none (such as the thrust curve)."""
        owners: dict[str, tuple[int, ...]] = {}
        for index, column in enumerate(self.columns):
            owners[column.owner] = (*owners.get(column.owner, ()), index)
        return owners

    @cached_property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Column indices by candidate or adjustment, without those of `forms`."""
        groups: dict[str, tuple[int, ...]] = {}
        for owner, all_indices in self.owners.items():
            indices = tuple(i for i in all_indices if not self.columns[i].form)
            keys = [self.columns[i].key for i in indices]
            split = owner in self.effects and self.effects[owner].one_of
            groups.update(
                {f"{owner}.{k}": (i,) for k, i in zip(keys, indices, strict=True)}
                if split
                else {owner: indices}
            )
        return groups

    @cached_property
    def forms(self) -> dict[str, tuple[int, ...]]:
        """Column indices of the form of the effect, by candidate or adjustment."""
        return {
            name: tuple(i for i in self.owners[name.partition(".")[0]] if self.columns[i].form)
            for name in self.groups
        }

    def strengths(self, candidate: str) -> list[int]:
        """Return the indices of the columns that say how strong a candidate is."""
        return [i for i in self.groups[candidate] if self.columns[i].strength]

    def of_predicted_flights(self) -> ParameterSpace:
        """Return the space without the effects of which predictions of whole flights show nothing.

        Their columns stay, within tolerance and without slopes.
        """
        shown = {name: effect for name, effect in self.effects.items() if not effect.noise_dependent}
        candidates = tuple(name for name in self.candidates if not self.effect(name).noise_dependent)
        return replace(self, effects=shown, candidates=candidates)

    def active(self, theta_scaled: Annotated[np.ndarray, "parameters"]) -> Annotated[np.ndarray, "active"]:
        """Return the indices of all columns except forms of effects that are within their tolerance."""
        large = {
            column.owner
            for column, value in zip(self.columns, theta_scaled, strict=True)
            if not column.form and abs(value) * column.scale > column.tolerance
        }
        return np.array([i for i, c in enumerate(self.columns) if not c.form or c.owner in large])

    def are_aliases(self, candidate: str, other: str) -> bool:
        """Return whether one of two candidates states the other one's effect as an alias."""
        first, second = self.effect(candidate), self.effect(other)
        return second.name in first.aliases or first.name in second.aliases

    def effect(self, candidate: str) -> Effect:
        """Return the effect of a candidate, which may be only one of its parameters."""
        return self.effects[candidate.partition(".")[0]]

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """Names of the effects in the roll-outs, in the order of their columns."""
        return tuple(name for name in self.owners if name in self.effects)

    @cached_property
    def scale(self) -> Annotated[np.ndarray, "parameters"]:
        """Scales of the parameters, each in its unit."""
        return np.array([column.scale for column in self.columns])

    @cached_property
    def prior(self) -> Prior:
        """Prior of segment fits: its spike combines tolerance and discrepancy, scaled."""
        spike = np.array([np.hypot(c.tolerance / c.scale, c.discrepancy) for c in self.columns])
        return Prior(
            groups=self.groups,
            forms=self.forms,
            strengths={name: tuple(self.strengths(name)) for name in self.candidates},
            spike=spike,
            nuisance_sigma=np.array(self.nuisance_sigma),
            added=self.added,
        )

    @property
    def rolled(self) -> ParameterSpace:
        """Parameters of the roll-outs: these. A space of several sets of flights has more columns."""
        return self

    @cached_property
    def added(self) -> Annotated[np.ndarray, "parameters"] | None:
        """Columns to which others add (`Prior.added`); None here."""
        return None

    def of_flight(
        self, theta_scaled: Annotated[np.ndarray, "parameters"], flight: int
    ) -> Annotated[np.ndarray, "rolled"]:
        """Return the scaled parameters of the roll-out of a flight: here the same for all flights."""
        del flight
        return theta_scaled

    def at_starts(
        self, name: str, theta_scaled: Annotated[np.ndarray, "parameters"]
    ) -> Annotated[np.ndarray, "starts parameters"]:
        """Return theta_scaled with the candidate `name` at each of the start values in its effect file."""
        columns, starts = list(self.groups[name]), np.array(self.effect(name).starts)
        points = np.repeat(theta_scaled[None], len(starts), axis=0)
        neutral = np.array([self.columns[i].neutral for i in columns])
        points[:, columns] = (starts - neutral) / self.scale[columns]
        return points

    def after_change(self) -> ParameterSpace:
        """Return the space for flights that are all after the change: here this one."""
        return self

    def expanded(
        self, gram: Annotated[np.ndarray, "segments all all"], flight: int
    ) -> Annotated[np.ndarray, "segments all_columns all_columns"]:
        """Return Grams of [r | rolled parameters | others] of a flight as those of [r | columns | others]."""
        del flight
        return gram

    def values(self, theta_scaled: np.ndarray) -> np.ndarray:
        """Return the physical values of scaled parameters, (parameters,) or (parameters, lanes)."""
        neutral = np.array([column.neutral for column in self.columns])
        shape = (-1,) + (1,) * (theta_scaled.ndim - 1)
        return neutral.reshape(shape) + self.scale.reshape(shape) * theta_scaled

    @cached_property
    def bounds(self) -> tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters"]]:
        """Lower and upper bounds of theta_scaled."""
        limits = [((c.lower - c.neutral) / c.scale, (c.upper - c.neutral) / c.scale) for c in self.columns]
        lower, upper = np.array(limits).T
        return lower, upper

    def clipped(
        self, theta_scaled: Annotated[np.ndarray, "parameters"]
    ) -> Annotated[np.ndarray, "parameters"]:
        """Return theta_scaled clipped to the bounds."""
        return np.clip(theta_scaled, *self.bounds)

    def check_finite(self, sizes: Annotated[np.ndarray, "columns"]) -> None:
        """Raise RollOutDiverged if roll-outs diverge; it names the parameter, or the effects with states.

        sizes: norm of the residual, then of the slope of each parameter.
        """
        bad = np.flatnonzero(~np.isfinite(sizes))
        if not len(bad):
            return
        if bad[0] == 0:
            suspects = [name for name in self.parts if self.effects[name].memory] or list(self.parts)
            cause = ", ".join(suspects)
        else:
            cause = f"{self.columns[bad[0] - 1].owner}.{self.columns[bad[0] - 1].key}"
        raise RollOutDiverged(
            f"the model with {cause} diverges on these flights; leave out one log at a time to find wrong "
            "values, or bound what the functions of your own effect file return"
        )

    def at_bound(
        self, theta_scaled: Annotated[np.ndarray, "parameters"]
    ) -> Annotated[np.ndarray, "parameters"]:
        """Return the mask of entries of theta_scaled that are at a bound other than neutral."""
        lower, upper = self.bounds
        return ((theta_scaled <= lower + 1e-9) & (lower < 0.0)) | (
            (theta_scaled >= upper - 1e-9) & (upper > 0.0)
        )

    def by_owner(self, values: Sequence[Any]) -> dict[str, tuple[Any, ...]]:
        """Return P values as tuples by owner, each in the order of the owner's keys."""
        return {owner: tuple(values[i] for i in indices) for owner, indices in self.owners.items()}

    def admissible(self, selected: Iterable[str]) -> bool:
        """Return whether a set contains what each of its effects requires, and no effect twice."""
        members = tuple(selected)
        names = {self.effect(candidate).name for candidate in members}
        return len(names) == len(members) and all(self.carried(name, members) for name in members)

    def carried(self, candidate: str, selected: Iterable[str]) -> bool:
        """Return whether a set contains an effect that `candidate` acts through, if it needs one."""
        required = self.effect(candidate).requires_any
        return not required or bool({self.effect(name).name for name in selected} & set(required))


_THRUST_CURVE = (("log_gain", 0.1, 1.5), ("linear", 0.2, 1.0))
"""Parameters of the adjustment for an unknown thrust curve: key, scale, bound."""


def space(
    vehicle: Vehicle,
    effects: Mapping[str, Effect],
    unknown: Iterable[str] = (),
    *,
    thrust_commanded: bool = False,
) -> ParameterSpace:
    """Return the parameter space of a vehicle.

    effects: effects by name. unknown: what the logs do not determine, as words of `UNKNOWN`.
    thrust_commanded: whether the logs hold commanded thrust in N instead of motor commands. Raises ValueError
    for another word in `unknown`.
    """
    if thrust_commanded:
        of_motors = {name for name, effect in effects.items() if effect.tolerance_of_motors}
        kept = {
            key: value for key, value in vehicle.tolerances.items() if key.partition(".")[0] not in of_motors
        }
        vehicle = vehicle.model_copy(update={"tolerances": kept})
    unknown = frozenset(unknown)
    unsupported = unknown - set(UNKNOWN)
    if unsupported:
        raise ValueError(f"a log declares {sorted(unsupported)} unknown; it may declare {UNKNOWN}")
    free = [name for name, effect in effects.items() if unknown & set(effect.freed_by)]
    acting = [name for name, effect in effects.items() if not effect.replaced(unknown)]
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
        freed=(*free, *({THRUST_CURVE} & unknown)),
        nuisance_sigma=(mounting,) * 3 + (torque,) * 3 + (accelerometer,) * 3,
    )
    fixed = {*whole.freed, *(name for name, effect in effects.items() if effect.adjustment)}
    candidates = tuple(name for name in whole.groups if name.partition(".")[0] not in fixed)
    return replace(whole, candidates=candidates)


def _column(vehicle: Vehicle, owner: str, parameter: Parameter, *, free: bool) -> Column:
    """Return the column of a parameter of the effect `owner`.

    The tolerance of the vehicle file takes precedence over that of the effect. free: whether a log frees the
    effect (`Effect.freed_by`).
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
        form=parameter.form,
    )
