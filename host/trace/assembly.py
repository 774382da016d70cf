"""What a trace answers with: named effects, the model, and errors on held-out flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.models.model import Covariance, Model
from trimtab.host.models.region import Region
from trimtab.host.trace.data.logs import TraceData
from trimtab.host.trace.data.signals import nominal_thrust
from trimtab.host.trace.decision.exact_aliases import exact_aliases
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.prediction import (
    Errors,
    predict_flights,
    predict_segments,
)
from trimtab.host.trace.result import Named, Value
from trimtab.host.trace.segment_fit.fit import unknowns_only
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import Diagnosis


def named_effects(
    chosen: ParameterSpace, diagnosis: Diagnosis, aliases: Mapping[str, Mapping[str, float]]
) -> tuple[Named, ...]:
    """Return the selected effects with values, probability and aliases."""
    values, sd = (
        chosen.values(diagnosis.selected.theta_scaled),
        np.sqrt(np.diag(diagnosis.selected.covariance)) * chosen.scale,
    )
    out = []
    for name in diagnosis.selected.effects:
        effect = chosen.effect(name)
        parameters = {
            chosen.columns[i].key: Value(value=float(values[i]), sd=float(sd[i]), unit=chosen.columns[i].unit)
            for i in chosen.groups[name]
        }
        others: dict[str, float] = {}
        for other, probability in aliases[name].items():
            title = chosen.effect(other).name
            others[title] = others.get(title, 0.0) + probability
        exact = exact_aliases(
            chosen, diagnosis.selected.theta_scaled, diagnosis.selected.covariance, effect.name
        )
        for other in exact:
            others.setdefault(other, diagnosis.inclusion_probability[name])
        out.append(
            Named(
                name=effect.name,
                title=effect.title,
                parameters=parameters,
                probability=diagnosis.inclusion_probability[name],
                aliases=others,
                exact_aliases=exact,
            )
        )
    return tuple(out)


def model_of(
    chosen: ParameterSpace,
    diagnosis: Diagnosis,
    theta_scaled: np.ndarray,
    flights: Sequence[Flight],
    named: Sequence[Named],
    added: bool,
    provenance: Mapping[str, object] | None,
) -> Model:
    """Return the model file's content: named effects, everything else within tolerance as adjustments.

    Unless effects are `added` there are none, no adjustments beside what the logs declare unknown, and no
    covariance.
    """
    values = chosen.values(theta_scaled)
    found = {effect.name for effect in named}
    tables: dict[bool, dict[str, dict[str, float]]] = {True: {}, False: {}}
    kept = [owner for owner in chosen.owners if added or owner in chosen.unknown]
    for owner in kept:
        table = {chosen.columns[i].key: float(values[i]) for i in chosen.owners[owner]}
        tables[owner in found][owner] = table
    covariance = None
    if added:
        scaled = diagnosis.selected.covariance * np.outer(chosen.scale, chosen.scale)
        covariance = Covariance(
            names=tuple(f"{c.owner}.{c.key}" for c in chosen.columns),
            matrix=tuple(tuple(float(x) for x in row) for row in 0.5 * (scaled + scaled.T)),
        )
    data, vehicle = diagnosis.selected.data, flights[0].vehicle
    tilt = np.arccos(np.clip(data.R_ned_frd[:, :, 8], -1.0, 1.0))
    speed = np.linalg.norm(np.diff(data.p_ned, axis=1), axis=2) / data.dt_s
    seen = data.pose_weight[:, 1:] * data.pose_weight[:, :-1] > 0
    thrust = nominal_thrust(vehicle, data.command, in_newton=data.in_newton)
    thrust = np.maximum(thrust.sum(-1), 0.0)
    return Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects=tables[True],
        adjustments=tables[False],
        covariance=covariance,
        sources={name: chosen.effects[name].source_id for name in chosen.parts if name in kept},
        region=Region(
            speed_max_m_s=float(np.quantile(speed[seen], 0.99)),
            tilt_max_deg=float(np.rad2deg(np.quantile(tilt[data.pose_weight > 0], 0.999))),
            thrust_min_n=float(np.quantile(thrust, 0.001)),
            thrust_max_n=float(np.quantile(thrust, 0.999)),
        ),
        data=tuple(flight.id for flight in flights),
        provenance=dict(provenance or {}),
    )


def held_out_errors(
    logs: TraceData,
    segment_model: SegmentModel,
    diagnosis: Diagnosis,
    added: bool,
    model: Model,
    effects: Mapping[str, Effect],
) -> tuple[tuple[Errors, ...], tuple[Errors, ...], tuple[Errors, ...]]:
    """Held-out errors with nothing, with everything, and with the adjustments only."""
    if not logs.held_out:
        return (), (), ()
    chosen = segment_model.space
    named = [i for name in diagnosis.selected.effects for i in chosen.groups[name]]
    bare = Model(vehicle_id=model.vehicle_id, vehicle_name=model.vehicle_name, adjustments=model.adjustments)

    def predict(values: np.ndarray, whole: Model | None) -> tuple[Errors, ...]:
        if logs.drive == "reference":
            return predict_flights(logs.held_out, whole, effects)
        return predict_segments(logs.held_out, segment_model, values)

    before = predict(unknowns_only(chosen, diagnosis.null_fit), None)
    if not added:
        return before, before, before
    theta_scaled = diagnosis.selected.theta_scaled
    middle = theta_scaled.copy()
    middle[named] = 0.0
    return before, predict(theta_scaled, model), predict(middle, bare)
