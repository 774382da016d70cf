"""Two models compared: parameters over their combined standard deviation, effects and networks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from trimtab.host.base.errors import UsageError
from trimtab.host.effects import Effect
from trimtab.host.models.model import NUISANCES, Model, network_digest

FAR_SDS = 2.0
"""Combined standard deviations beyond which two values of a parameter are far apart."""

Networks = Literal["none", "same", "different", "only-a", "only-b"]


@dataclass(frozen=True, kw_only=True)
class ParameterDifference:
    """A parameter that both models have, named or as an adjustment.

    difference: b minus a. a_sd, b_sd: standard deviations, None where a file has none. sds: difference over
    the combined standard deviation; None unless both are known and one is not 0.
    """

    effect: str
    key: str
    unit: str | None
    a: float
    b: float
    a_sd: float | None
    b_sd: float | None
    a_named: bool
    b_named: bool

    @property
    def difference(self) -> float:
        """The value in b minus that in a."""
        return self.b - self.a

    @property
    def sds(self) -> float | None:
        """The difference over the combined standard deviation, as if the two values were independent."""
        if self.a_sd is None or self.b_sd is None or not (self.a_sd or self.b_sd):
            return None
        return self.difference / math.hypot(self.a_sd, self.b_sd)

    @property
    def far(self) -> bool | None:
        """Whether the values differ by more than FAR_SDS; None if that is not known."""
        return None if self.sds is None else abs(self.sds) > FAR_SDS

    def to_dict(self) -> dict[str, Any]:
        """Return the parameter as plain data for JSON."""
        return {**vars(self), "difference": self.difference, "sds": self.sds, "far": self.far}


@dataclass(frozen=True, kw_only=True)
class ComparedModel:
    """One of two models: its file and id, and what the file states of its support, each None if absent."""

    file: str
    id: str
    verdict: str | None
    held_out_flights: int | None
    error_before_m: float | None
    error_after_m: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data for JSON."""
        return dict(vars(self))


@dataclass(frozen=True, kw_only=True)
class ModelsComparison:
    """Two models of one vehicle.

    a_only, b_only: effects that only one of them names. networks: "same" for the same bytes of weights.
    shared_logs: number of logs that both were made from.
    """

    vehicle: str
    a: ComparedModel
    b: ComparedModel
    parameters: tuple[ParameterDifference, ...]
    a_only: tuple[str, ...]
    b_only: tuple[str, ...]
    networks: Networks
    shared_logs: int

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
        return {
            "vehicle": self.vehicle,
            "a": self.a.to_dict(),
            "b": self.b.to_dict(),
            "parameters": [parameter.to_dict() for parameter in self.parameters],
            "a_only": list(self.a_only),
            "b_only": list(self.b_only),
            "networks": self.networks,
            "shared_logs": self.shared_logs,
        }


def compare_models(
    a: Model, b: Model, a_path: Path, b_path: Path, effects: Mapping[str, Effect]
) -> ModelsComparison:
    """Return what differs between two models. effects: give the units of parameters.

    Raises UsageError if they are of two vehicles, whose values would be relative to two nominal models.
    """
    if a.vehicle_id != b.vehicle_id:
        raise UsageError(
            f"{b_path}: of vehicle {b.vehicle_name} ({b.vehicle_id}), {a_path} of {a.vehicle_name} "
            f"({a.vehicle_id}); compare models of one vehicle"
        )
    first, second = ({**model.adjustments, **model.effects} for model in (a, b))
    return ModelsComparison(
        vehicle=a.vehicle_name,
        a=_described(a, a_path),
        b=_described(b, b_path),
        parameters=tuple(
            ParameterDifference(
                effect=name,
                key=key,
                unit=_unit(effects.get(name), key),
                a=first[name][key],
                b=second[name][key],
                a_sd=a.sd(name, key),
                b_sd=b.sd(name, key),
                a_named=name in a.effects,
                b_named=name in b.effects,
            )
            for name in sorted(set(first) & set(second) - NUISANCES)
            for key in first[name]
            if key in second[name]
        ),
        a_only=tuple(sorted(set(a.effects) - set(b.effects))),
        b_only=tuple(sorted(set(b.effects) - set(a.effects))),
        networks=_networks(a, b),
        shared_logs=len(set(a.data) & set(b.data)),
    )


def _described(model: Model, path: Path) -> ComparedModel:
    known = model.assessment
    return ComparedModel(
        file=str(path),
        id=model.id,
        verdict=None if known is None else known.verdict,
        held_out_flights=None if known is None else known.held_out_flights,
        error_before_m=None if known is None else known.before_m,
        error_after_m=None if known is None else known.after_m,
    )


def _unit(effect: Effect | None, key: str) -> str | None:
    """Return the unit of an effect's parameter; None if it is not known here."""
    units = {} if effect is None else {parameter.key: parameter.unit for parameter in effect.parameters}
    return units.get(key)


def _networks(a: Model, b: Model) -> Networks:
    if a.network is None or b.network is None:
        if a.network is b.network:
            return "none"
        return "only-a" if b.network is None else "only-b"
    same = a.network.layout == b.network.layout and network_digest(a.network) == network_digest(b.network)
    return "same" if same else "different"
