"""The effective parameters of a sealed world: the noise-free fit of the library's forms to its plant.

The plant has its own physics, so its parameters are not the truth for the library's forms. The world's
references are therefore flown once more in still air with perfect sensors. The closed-loop model phi is
fitted to these flights, with the world's effects free and the build's deviations free within tolerance around
the drawn ones. Each flight counts as often as it was flown, and is weighted by the turbulence and noise of
the traced flights. The fit is the truth, its held-out error the floor, and its covariance the Cramer-Rao
bound.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.models.model import Model
from trimtab.host.trace.data.logs import repeat_flights_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import fit_with_whitening, prior_of
from trimtab.host.trace.flight_fit.loop import closed_loop, order_of
from trimtab.host.trace.flight_fit.repeatability import turbulence
from trimtab.host.trace.next_flight.separation import information_of
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.prediction import predict_flights, rmse
from trimtab.host.vehicle import Vehicle
from trimtab.sitl.studies.scoring.names import effect_of, ratios

Values = dict[str, dict[str, float]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Effective:
    """A world in terms of the library's forms, with the information in its flights.

    `candidates` maps the name of an effect to the candidate of tracing. `z` and `covariance` are scaled.
    `gram` is of the whitened slopes.
    """

    space: ParameterSpace
    candidates: Mapping[str, str]
    z: Annotated[np.ndarray, "parameters"]
    covariance: Annotated[np.ndarray, "parameters parameters"]
    gram: Annotated[np.ndarray, "parameters parameters"]

    @property
    def values(self) -> Values:
        """All parameters, by owner and key."""
        return _values(self.space, self.z)

    def true(self) -> Values:
        """Return the world's effects, by name and key."""
        return {name: self.values[name] for name in self.candidates}

    def bound_sd(self, name: str, key: str) -> float:
        """Return the bound of a parameter, one standard deviation."""
        (i,) = (i for i in self.space.owners[name] if self.space.columns[i].key == key)
        return float(np.sqrt(self.covariance[i, i])) * self.space.columns[i].scale


def effective(
    vehicle: Vehicle,
    space: ParameterSpace,
    drawn: Mapping[str, Mapping[str, float]],
    deviations: Mapping[str, float],
    still: Sequence[Flight],
    flights: Sequence[Flight],
) -> Effective:
    """Return the effective parameters of a world with the `drawn` effects and the build's `deviations`.

    `still` holds each reference flown once in still air with perfect sensors. `flights` are the traced ones,
    with repeat flights. Effects without a form in `space` are left out. A drawn effect takes the place of the
    build's deviations in its parameters.
    """
    candidates = {name: _candidate(space, name, drawn[name]) for name in drawn if name in space.effects}
    names = tuple(sorted(candidates.values()))
    of_build = {name: away for name, away in deviations.items() if effect_of(name) not in drawn}
    centre = deviations_scaled(space, of_build)
    z = centre + deviations_scaled(
        space, {f"{n}.{k}": v for n in candidates for k, v in _away(space, n, drawn[n]).items()}
    )
    flown = closed_loop([FlightData.of(flight) for flight in flights], vehicle, space, z)
    white = turbulence(flown, z, order_of(flown), repeat_flights_of(flights))
    if white is None:
        raise ValueError("there are no repeat flights, so turbulence cannot be distinguished from physics")
    loop = closed_loop([FlightData.of(flight) for flight in still], vehicle, space, z, noise_free=True)
    z, covariance, grams, _ = fit_with_whitening(
        loop, white, names, z, centre=centre, flight_weight=len(flights) / len(still)
    )
    gram = grams.sum(0)[1:, 1:]
    return Effective(space=space, candidates=candidates, z=z, covariance=covariance, gram=gram)


def _candidate(space: ParameterSpace, name: str, values: Mapping[str, float]) -> str:
    """Return the candidate of an effect with these values: its name, or its one parameter off neutral."""
    if name in space.groups:
        return name
    (key,) = [key for key, value in _away(space, name, values).items() if value]
    return f"{name}.{key}"


def _away(space: ParameterSpace, name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return the distance of each parameter of an effect from neutral."""
    columns = [space.columns[i] for i in space.owners[name]]
    return {column.key: values.get(column.key, column.neutral) - column.neutral for column in columns}


def deviations_scaled(
    space: ParameterSpace, away: Mapping[str, float]
) -> Annotated[np.ndarray, "parameters"]:
    """Return the scaled parameters of distances from neutral by "effect.parameter"."""
    return np.array([away.get(f"{c.owner}.{c.key}", 0.0) / c.scale for c in space.columns])


def off_by(space: ParameterSpace, deviations: Mapping[str, float]) -> Values:
    """Return the values by owner and key of a world without effects, with the build's deviations."""
    return _values(space, deviations_scaled(space, deviations))


def _values(space: ParameterSpace, z: np.ndarray) -> Values:
    theta = space.values(z)
    return {
        owner: {space.columns[i].key: float(theta[i]) for i in rows} for owner, rows in space.owners.items()
    }


def nearest(known: Effective) -> dict[str, dict[str, float]]:
    """Return the separation, sigma, of each effect from each other candidate of any size.

    Effects of which flights show only ratios do not count as aliases of each other.
    """
    space, prior = known.space, prior_of(known.space)
    same = [ratio.effects for ratio in ratios(space.effects)]
    names = tuple(sorted(known.candidates.values()))
    out = {}
    for name, candidate in known.candidates.items():
        others = [o for o in space.candidates if o not in names and not any({name, o} <= s for s in same)]
        columns = list(space.groups[candidate])
        build = np.diag(prior.precision(())[columns])
        out[name] = {
            other: _sigma_beyond_build(
                information_of(space, known.gram, names, candidate, other, prior), build, known.z[columns]
            )
            for other in others
        }
    return out


def _sigma_beyond_build(information: np.ndarray, build: np.ndarray, size: np.ndarray) -> float:
    """Return by how many sigma an effect exceeds noise and the build's deviations in the same parameters.

    A vehicle without the effect still deviates in them within tolerance, so an effect of n tolerances never
    exceeds them by more than n sigma. information: about its parameters. build: precision of the deviations.
    """
    within = build @ np.linalg.solve(information + build, information)
    return float(np.sqrt(max(size @ within @ size, 0.0)))


def is_identifiable(separations: Mapping[str, Mapping[str, float]]) -> bool:
    """Return whether every effect is separated from every alias."""
    return all(min(each.values(), default=np.inf) >= RULES.detectable_sigma for each in separations.values())


def floor_m(
    vehicle: Vehicle,
    library: Mapping[str, Effect],
    values: Mapping[str, Mapping[str, float]],
    names: Collection[str],
    held_out: Sequence[Flight],
) -> float:
    """Return the position RMSE, m, on held-out flights of the model with `values`; `names` are effects."""
    tables: dict[bool, dict[str, dict[str, float]]] = {True: {}, False: {}}
    for owner, table in values.items():
        tables[owner in names][owner] = dict(table)
    model = Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects=tables[True],
        adjustments=tables[False],
    )
    return rmse(predict_flights([FlightData.of(flight) for flight in held_out], model, library))[
        "position_rmse_m"
    ]
