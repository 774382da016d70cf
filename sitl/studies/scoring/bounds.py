"""What a world's flights allow to know, from its truth: separations, bounds, the error's floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from host.effects import Effect
from host.log import Flight
from host.models.model import Model
from host.trace import evidence
from host.trace.data import segments_of
from host.trace.diagnose import refit
from host.trace.form import Form
from host.trace.parameters import Space
from host.trace.score import predict_flights, rmse
from host.trace.separate import DECISIVE_SIGMA
from host.trace.separate import separation as separation_of
from host.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Sigma of each true effect against each other candidate, and the Cramer-Rao bound (one sd) of each of
    its parameters, by effect.
    """

    separation: Mapping[str, Mapping[str, float]]
    sd: Mapping[str, Mapping[str, float]]

    @property
    def identifiable(self) -> bool:
        """Whether every true effect stands out of every alias."""
        return all(
            min(others.values(), default=np.inf) >= DECISIVE_SIGMA for others in self.separation.values()
        )


def bounds(
    vehicle: Vehicle,
    space: Space,
    truth: Mapping[str, Mapping[str, float]],
    flights: Sequence[Flight],
    same: frozenset[str],
) -> Bounds:
    """What the flights allow to know of the effective parameters `truth`.

    The library with the true effects is linearised along the flights, with the process noise that they show.
    An effect of the set `same`, of which only ratios show, is no alias of another one.
    """
    candidates = {name: _candidate(space, name, values) for name, values in truth.items()}
    names = tuple(sorted(candidates.values()))
    data, _ = segments_of(flights)
    form = Form(vehicle, space, dt_s=data.dt_s, in_newton=data.in_newton, rate_driven=data.rate_driven)
    at = refit(form, data, names, None, iterations=4)
    z = _scaled(space, truth)
    gram = evidence.whitened(at.lin, at.process, space.prior).gram[1:, 1:]
    separation = {}
    for name, candidate in candidates.items():
        others = [o for o in space.candidates if o not in names and not {name, o} <= same]
        separation[name] = {o: separation_of(space, gram, names, z, candidate, o) for o in others}
    sd = np.sqrt(np.diag(at.covariance)) * space.scale
    return Bounds(
        separation=separation,
        sd={
            name: {
                space.columns[i].key: float(sd[i]) for i in space.owners[name] if space.columns[i].key in keys
            }
            for name, keys in truth.items()
        },
    )


def _candidate(space: Space, name: str, values: Mapping[str, float]) -> str:
    """What tracing calls an effect with these values: its name, or that of the one parameter off neutral."""
    if name in space.groups:
        return name
    neutral = {space.columns[i].key: space.columns[i].neutral for i in space.owners[name]}
    (key,) = [key for key in neutral if values.get(key, neutral[key]) != neutral[key]]
    return f"{name}.{key}"


def _scaled(space: Space, truth: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    z = np.zeros(len(space.columns))
    for name, values in truth.items():
        for i in space.owners[name]:
            column = space.columns[i]
            z[i] = (values.get(column.key, column.neutral) - column.neutral) / column.scale
    return z


def floor_m(
    vehicle: Vehicle,
    space: Space,
    library: Mapping[str, Effect],
    truth: Mapping[str, Mapping[str, float]],
    deviations: Mapping[str, float],
    held_out: Sequence[Flight],
) -> float:
    """Position RMSE, m, on the held-out flights of the model that holds the effective parameters and what
    the build is off by.
    """
    adjustments: dict[str, dict[str, float]] = {}
    neutral = {f"{c.owner}.{c.key}": c.neutral for c in space.columns}
    for name, value in deviations.items():
        owner, key = name.split(".")
        if owner not in truth and name in neutral:
            adjustments.setdefault(owner, {})[key] = neutral[name] + value
    model = Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects={name: dict(values) for name, values in truth.items()},
        adjustments=adjustments,
    )
    return rmse(predict_flights(held_out, model, library))["position_rmse_m"]
