"""Assembly of the result of a trace: named effects, the model, and errors on held-out flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.models.model import Covariance, Model
from trimtab.host.models.region import Region
from trimtab.host.trace.data.logs import TraceData
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import nominal_thrust
from trimtab.host.trace.decision.decide import Decision
from trimtab.host.trace.decision.exact_aliases import exact_aliases
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.hover.fit import HoverFit
from trimtab.host.trace.joint import JointSpace
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.prediction import Errors, predict_flights, predict_segments, rmse
from trimtab.host.trace.result import Named, Value
from trimtab.host.trace.segment_fit.fit import SegmentFit, theta_without_effects
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import Diagnosis

SPEED_S = 0.1
"""Time over which the speeds of the trained region are means: the noise of poses averages out."""


def named_effects(
    space: ParameterSpace,
    diagnosis: Diagnosis,
    aliases: Mapping[str, Mapping[str, float]],
    probabilities: Mapping[str, float],
) -> tuple[Named, ...]:
    """Return the selected effects with values, standard deviations, probabilities and aliases.

    aliases: probability of each alternative by the selected effect that it would replace. probabilities: of
    each selected effect.
    """
    named = []
    for name in diagnosis.selected.effects:
        effect = space.effect(name)
        others: dict[str, float] = {}
        for other, probability in aliases[name].items():
            other_name = space.effect(other).name
            others[other_name] = others.get(other_name, 0.0) + probability
        exact = exact_aliases(
            space, diagnosis.selected.theta_scaled, diagnosis.selected.covariance, effect.name
        )
        for other in exact:
            others.setdefault(other, probabilities[name])
        named.append(
            Named(
                name=effect.name,
                title=effect.title,
                parameters=values_of(space, diagnosis.selected, name),
                probability=probabilities[name],
                aliases=others,
                exact_aliases=exact,
            )
        )
    return tuple(named)


def after_change(segment_model: SegmentModel, diagnosis: Diagnosis) -> tuple[SegmentModel, Diagnosis]:
    """Return model and diagnosis in the parameters of flights after the change.

    Without a baseline they are the given ones.
    """
    space = segment_model.space
    if not isinstance(space, JointSpace):
        return segment_model, diagnosis
    selected, null_fit = diagnosis.selected, diagnosis.null_fit
    theta_scaled, covariance = space.mapped(selected.theta_scaled, selected.covariance)
    without, _ = space.mapped(theta_without_effects(space, null_fit), null_fit.covariance)
    return (
        SegmentModel.of(segment_model.vehicle, space.rolled, selected.data, jobs=segment_model.jobs),
        replace(
            diagnosis,
            selected=replace(selected, theta_scaled=theta_scaled, covariance=covariance),
            null_fit=replace(null_fit, theta_scaled=without),
        ),
    )


def values_of(space: ParameterSpace, fit: SegmentFit | HoverFit, candidate: str) -> dict[str, Value]:
    """Return values and standard deviations of a candidate by key, without those of its form."""
    values = space.values(fit.theta_scaled)
    sd = np.sqrt(np.diag(fit.covariance)) * space.scale
    return {
        space.columns[i].key: Value(value=float(values[i]), sd=float(sd[i]), unit=space.columns[i].unit)
        for i in space.groups[candidate]
    }


def covariance_of(space: ParameterSpace, fit: SegmentFit | HoverFit, columns: Sequence[int]) -> Covariance:
    """Return the covariance of these columns, in the units of their parameters."""
    scaled = fit.covariance * np.outer(space.scale, space.scale)
    scaled = scaled[np.ix_(columns, columns)]
    return Covariance(
        names=tuple(f"{space.columns[i].owner}.{space.columns[i].key}" for i in columns),
        matrix=tuple(tuple(float(x) for x in row) for row in 0.5 * (scaled + scaled.T)),
    )


def model_of(
    space: ParameterSpace,
    diagnosis: Diagnosis,
    theta_scaled: np.ndarray,
    flights: Sequence[Flight],
    named: Sequence[Named],
    added: bool,
    provenance: Mapping[str, object] | None,
) -> Model:
    """Return the model: named effects as effects, all other parameters as adjustments.

    If the effects are not `added`, the model holds only the adjustments that the logs free, and no
    covariance.

    Parameters
    ----------
    space
        Parameter space of the trace.
    diagnosis
        Gives the covariance, and the segments that the trained region is computed from.
    theta_scaled
        Scaled parameters (P,) of the model.
    flights
        Flights of the trace, all of one vehicle.
    named
        Effects that the trace names.
    added
        Whether the selected effects go into the model.
    provenance
        Recorded in the model file.
    """
    values = space.values(theta_scaled)
    effect_names = {effect.name for effect in named}
    effects: dict[str, dict[str, float]] = {}
    adjustments: dict[str, dict[str, float]] = {}
    owners = [owner for owner in space.owners if added or owner in space.freed]
    for owner in owners:
        table = effects if owner in effect_names else adjustments
        table[owner] = {
            space.columns[i].key: float(values[i])
            for i in space.owners[owner]
            if owner in effect_names or not space.columns[i].form
        }
    covariance = None
    if added:
        held = {**effects, **adjustments}
        kept = [i for i, c in enumerate(space.columns) if c.key in held[c.owner]]
        covariance = covariance_of(space, diagnosis.selected, kept)
    data, vehicle = diagnosis.selected.data, flights[0].vehicle
    thrust = nominal_thrust(vehicle, data.command, in_newton=data.in_newton).sum(-1)
    return Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects=effects,
        adjustments=adjustments,
        covariance=covariance,
        sources={name: space.effects[name].source_id for name in space.parts if name in owners},
        region=Region.measured(_speeds(data), data.R_ned_frd[:, :, 8][data.pose_weight > 0], thrust),
        data=tuple(flight.id for flight in flights),
        provenance=dict(provenance or {}),
    )


def far_adjustments(space: ParameterSpace, model: Model) -> tuple[Finding, ...]:
    """Return a finding for each adjustment that a log does not free and that takes much of its tolerance."""
    return tuple(
        Finding(
            code=Code.ADJUSTED_FAR,
            value=abs(value - column.neutral) / column.tolerance,
            bound=RULES.far_tolerances,
            unit="tolerances",
            subject=(column.owner, column.key, column.unit),
            details={"value": value},
        )
        for column in space.columns
        if column.owner in model.adjustments and column.owner not in space.freed and not column.form
        for value in (model.adjustments[column.owner][column.key],)
        if abs(value - column.neutral) > RULES.far_tolerances * column.tolerance
    )


def _speeds(data: Segments) -> Annotated[np.ndarray, "pairs"]:
    """Return the mean speed from each pose to the first of its segment that is at least SPEED_S later."""
    span = round(SPEED_S / data.dt_s)
    stamp_s = data.dt_s * np.arange(data.steps) + data.shift_s
    speeds = []
    for p, t, weight in zip(data.p_ned, stamp_s, data.pose_weight, strict=True):
        posed = np.flatnonzero(weight > 0)
        later = np.searchsorted(posed, posed + span)
        first, second = posed[later < len(posed)], posed[later[later < len(posed)]]
        speeds.append(np.linalg.norm(p[second] - p[first], axis=1) / (t[second] - t[first]))
    return np.concatenate(speeds)


def assessed(
    model: Model,
    decision: Decision,
    named: Sequence[Named],
    before: Sequence[Errors],
    after: Sequence[Errors],
) -> Model:
    """Return the model with verdict, inclusion probabilities, and held-out errors without and with it."""
    return model.assessed(
        decision.verdict.value,
        probabilities={**decision.possible, **{effect.name: effect.probability for effect in named}},
        flights=len(before),
        before_m=rmse(before)["position_rmse_m"] if before else None,
        after_m=rmse(after)["position_rmse_m"] if after else None,
    )


def held_out_errors(
    logs: TraceData,
    segment_model: SegmentModel,
    diagnosis: Diagnosis,
    added: bool,
    model: Model,
    effects: Mapping[str, Effect],
) -> tuple[tuple[Errors, ...], tuple[Errors, ...], tuple[Errors, ...]]:
    """Return held-out errors without effects, with the model, and with only its adjustments.

    Each is a tuple with one entry for each held-out flight. If the effects are not `added`, all three are the
    errors without effects.
    """
    if not logs.held_out:
        return (), (), ()
    space = segment_model.space
    selected_columns = [i for name in diagnosis.selected.effects for i in space.groups[name]]
    adjusted = Model(
        vehicle_id=model.vehicle_id, vehicle_name=model.vehicle_name, adjustments=model.adjustments
    )

    def predict(values: np.ndarray, whole: Model | None) -> tuple[Errors, ...]:
        if logs.drive == "reference":
            return predict_flights(logs.held_out, whole, effects, jobs=segment_model.jobs)
        return predict_segments(logs.held_out, segment_model, values)

    without_effects = theta_without_effects(space, diagnosis.null_fit)
    before = predict(without_effects, None)
    if not added:
        return before, before, before
    theta_scaled = diagnosis.selected.theta_scaled
    adjustments_only = theta_scaled.copy()
    adjustments_only[selected_columns] = without_effects[selected_columns]
    return before, predict(theta_scaled, model), predict(adjustments_only, adjusted)
