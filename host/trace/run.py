"""From logs to a verdict: audit, search, abstention, alias set, and the error before and after on held-out
flights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.models.model import Covariance, Model
from trimtab.host.models.region import Region
from trimtab.host.trace import evidence
from trimtab.host.trace.audit import with_missing_twins
from trimtab.host.trace.data import SEGMENT_S, segments_of
from trimtab.host.trace.decision.decide import Evidence, decide, is_null_probable, tracking_shortfall
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.describe import describe
from trimtab.host.trace.diagnose import Diagnosis, Fit, SegmentFitter, at_parameters, refit, stands_out
from trimtab.host.trace.exact import exact_aliases
from trimtab.host.trace.form import Form
from trimtab.host.trace.intervals import by_segments, honest_covariance
from trimtab.host.trace.loop import closed_loop, order_of, tracking_extent
from trimtab.host.trace.manoeuvres import Manoeuvre
from trimtab.host.trace.parameters import Space, space
from trimtab.host.trace.refine import ClosedFit, LoopFitter, fit_loop, prior_of
from trimtab.host.trace.repeats import in_turbulence, repeat
from trimtab.host.trace.result import Named, Trace, Value
from trimtab.host.trace.score import (
    Errors,
    drive_of,
    noise_floor,
    predict_flights,
    predict_segments,
    rmse,
    strata_of,
    twins_of,
)
from trimtab.host.trace.search import Found, Names, likeliest, search, sizes, smallest
from trimtab.host.trace.segments import Segments, nominal_thrust
from trimtab.host.trace.separate import NextFlight, propose
from trimtab.host.trace.signals import has_signals, signals, unknowns
from trimtab.host.trace.twins import unexplained_residual
from trimtab.host.trace.unexplained import unexplained
from trimtab.host.vehicle import Vehicle

Report = Callable[[str], None]
Manoeuvres = Callable[[], Sequence[Manoeuvre]]


def check_logs(flights: Sequence[Flight], held_out: Sequence[Flight], vehicle: Vehicle | None) -> Vehicle:
    """The one vehicle of all logs.

    Raises UsageError for a mixture, a log given twice or a held-out reference that was used, and
    TooLittleData for a log without poses or tracking phase.
    """
    first = vehicle or flights[0].vehicle
    seen: dict[str, Flight] = {}
    for flight in (*flights, *held_out):
        if flight.vehicle.id != first.id:
            raise LogsRefused(
                Code.MIXED_VEHICLES,
                f"{flight.path}: a log of vehicle {flight.vehicle.name} ({flight.vehicle.id}), "
                f"not of {first.name} ({first.id}): {_differences(flight.vehicle, first)}; "
                "trace each vehicle's logs apart",
            )
        if flight.id in seen:
            raise LogsRefused(
                Code.LOG_GIVEN_TWICE,
                f"{flight.path}: the same log as {seen[flight.id].path}; give it once",
            )
        seen[flight.id] = flight
        signals(flight)
    used = {flight.reference_id for flight in flights if flight.reference_id is not None}
    for flight in held_out:
        if flight.reference_id in used:
            raise LogsRefused(
                Code.HELD_OUT_REFERENCE_USED,
                f"{flight.path}: flies reference {flight.reference_id}, which is among the flights used; "
                "hold out flights of other references",
            )
    return first


def _differences(one: Vehicle, other: Vehicle) -> str:
    """Which entries of two vehicle files differ."""
    keys = [key for key in Vehicle.model_fields if getattr(one, key) != getattr(other, key)]
    return ", ".join(keys) + " differ"


def run(
    flights: Sequence[Flight],
    held_out: Sequence[Flight],
    effects: Mapping[str, Effect],
    *,
    vehicle: Vehicle | None = None,
    manoeuvres: Manoeuvres | None = None,
    provenance: Mapping[str, object] | None = None,
    network: bool = False,
    report: Report = lambda _: None,
) -> Trace:
    """The trace of `flights`, scored on `held_out`.

    From `manoeuvres` the next flight is chosen where the data cannot decide. With `network`, one learns what
    is left where the cause is outside the library. Raises UsageError (logs that do not belong together) and
    TooLittleData.
    """
    airframe = check_logs(flights, held_out, vehicle)
    report("reading segments")
    unknown = unknowns([*flights, *held_out])
    chosen = space(airframe, _observable(effects, flights), unknown)
    data, audits = segments_of(flights, rate_driven="torque" in unknown)
    form = Form(airframe, chosen, dt_s=data.dt_s, in_newton=data.in_newton, rate_driven=data.rate_driven)
    drive = drive_of([*flights, *held_out])
    tracking_s, extent_m = tracking_extent(flights)
    enough = tracking_shortfall(tracking_s, extent_m) is None
    diagnosis = _diagnosis(form, data, flights if drive == "reference" and enough else (), report)
    twins = twins_of(flights)
    decision = decide(_evidence(form, diagnosis, twins, unknown, tracking_s, extent_m))
    added, nothing = decision.effects_added, diagnosis.nothing
    named = _named(chosen, diagnosis, decision.aliases) if added else ()
    z = diagnosis.best.z if added else _reading(chosen, nothing)
    model = _model(chosen, diagnosis, z, flights, named, added, provenance)

    report("predicting the held-out flights")
    before, after, middle = _errors(drive, form, diagnosis, added, model, held_out, effects)
    following: NextFlight | None = None
    if decision.to_separate is not None and manoeuvres is not None:
        report("looking for the flight that decides")
        following = propose(form, diagnosis.best, *decision.to_separate, manoeuvres())
    described = more = None
    if not added:
        report("describing what is outside the library")
        described = describe(_left(nothing, z), nothing.data, [f.reference_id for f in flights], airframe)
        if network and drive == "reference":
            more = unexplained(flights, held_out, model, effects, described, report)
    return Trace(
        verdict=decision.verdict,
        findings=decision.findings,
        effects=named,
        possible=decision.possible,
        drive=drive,
        horizon_s=None if drive == "reference" else SEGMENT_S,
        before=before,
        after=after,
        adjustments_only=middle,
        before_score=rmse(before) if before else None,
        after_score=rmse(after) if after else None,
        noise_floor=noise_floor(
            flights, predict_flights(flights, model, effects) if drive == "reference" else ()
        ),
        next_flight=following,
        model=model,
        space=chosen,
        diagnosis=diagnosis,
        residual=decision.residual,
        audits=with_missing_twins(audits, twins),
        description=described,
        unexplained=more,
    )


def _evidence(
    form: Form,
    diagnosis: Diagnosis,
    twins: Sequence[tuple[int, int]],
    unknown: frozenset[str],
    tracking_s: float,
    extent_m: float,
) -> Evidence:
    """Return everything that the verdict is decided by."""
    best, nothing = diagnosis.best, diagnosis.nothing
    axial = "thrust" not in unknown
    after, before = diagnosis.repeats
    residual = unexplained_residual(*_remainder(form, diagnosis), twins, axial=axial)
    without = unexplained_residual(
        _left(nothing, _reading(form.space, nothing)), nothing.data, twins, axial=axial
    )
    by_segments = diagnosis.method == "segments"
    return Evidence(
        space=form.space,
        selected=best.effects,
        null_probability=diagnosis.none,
        log_evidence=diagnosis.sets,
        posterior_weights=diagnosis.weights,
        inclusion_probability=diagnosis.inclusion,
        detectability=diagnosis.stands_out,
        by_segments=by_segments,
        residual=replace(residual, flights=after),
        residual_without=replace(without, flights=before),
        disturbance_sigma=tuple(best.process.sigma().tolist()),
        thrust_known=axial,
        rate_driven=best.data.rate_driven,
        segment_disagreement_nats=(
            {}
            if by_segments or twins or not best.effects
            else _segment_disagreement(form, nothing, best.effects)
        ),
        tracking_s=tracking_s,
        extent_m=extent_m,
    )


def _segment_disagreement(form: Form, nothing: Fit, selected: Names) -> dict[str, float]:
    """Return by how many nats segments prefer the selected set without each of its effects."""
    whole = refit(form, nothing.data, selected, nothing)
    return {
        name: refit(form, nothing.data, tuple(n for n in selected if n != name), whole).log_evidence
        - whole.log_evidence
        for name in selected
    }


def _diagnosis(form: Form, data: Segments, flights: Sequence[Flight], report: Report) -> Diagnosis:
    """What is missing, by whole `flights` over the closed loop, or by segments where there are none.

    The segments show in both cases what the kept set leaves.
    """
    nothing = refit(form, data, (), None, iterations=3)
    report("no effect fitted")
    if not flights:
        found, repeats = search(SegmentFitter(form=form), nothing, report), (None, None)
        covariance = by_segments(form.space, found.best)
        best, method = replace(found.best, covariance=covariance), "segments"
        prior = form.space.prior
        gram = evidence.whitened(best.lin, best.process, prior).flight_grams.sum(0)
    else:
        loop = closed_loop(flights, form.vehicle, form.space, nothing.z)
        order = order_of(loop)
        fitter = LoopFitter(loop=loop, order=order)
        found = search(fitter, fit_loop(loop, (), nothing.z, order), report)
        report("comparing twin flights")
        twins, unread = twins_of(flights), _reading(form.space, nothing)
        found = _without_faults(found, fitter, twins)
        kept = in_turbulence(loop, found.best, order, twins)
        there = tuple(name for name, size in sizes(fitter, kept).items() if size > RULES.present_tolerances)
        if there != kept.effects:  # sizes are told better than the search does
            found = replace(found, best=fitter.fit(there, found.best))
            kept = in_turbulence(loop, found.best, order, twins)
        covariance = honest_covariance(form.space, kept, strata_of(twins, len(flights)))
        judged = kept if _is_judged(found) else fitter.fit(likeliest(found.weights), kept)
        repeats = repeat(loop, judged.z, order, twins), repeat(loop, unread, order, twins)
        best = at_parameters(form, nothing, kept.effects, kept.z, covariance, kept.log_evidence)
        method = "closed-loop"
        gram, prior = kept.grams.sum(0), prior_of(form.space)
    return Diagnosis(
        best=best,
        nothing=nothing,
        method=method,
        inclusion=found.inclusion,
        weights=found.weights,
        sets=found.sets,
        stands_out=stands_out(form.space, gram, prior.precision(best.effects)),
        repeats=repeats,
    )


def _without_faults(
    found: Found[ClosedFit], fitter: LoopFitter, twins: Sequence[tuple[int, int]]
) -> Found[ClosedFit]:
    """The search's outcome without effects that take up what the form of a swinging one leaves.

    What a payload on its line leaves of itself is strong and repeats; other effects explain a little of it.
    """
    if not any(fitter.space.effect(name).memory for name in found.best.effects):
        return found
    left = repeat(fitter.loop, found.best.z, fitter.order, twins)
    names = smallest(
        found,
        RULES.tie_nats
        if left is None
        else max(RULES.tie_nats, RULES.memory_fault_share * left.log_evidence(RULES)),
    )
    if len(names) >= len(found.best.effects):
        return found
    return replace(found, best=fitter.fit(names, found.best))


def _observable(effects: Mapping[str, Effect], flights: Sequence[Flight]) -> dict[str, Effect]:
    """The effects that these flights could show by their signals: no sag where every battery stayed full."""
    return {name: effect for name, effect in effects.items() if has_signals(effect, flights)}


def _remainder(form: Form, diagnosis: Diagnosis) -> tuple[np.ndarray, Segments]:
    """Disturbance (segments, bins, 6) that the library leaves, by which abstention is judged.

    Of the kept set; where none is kept though one is more probable than nothing, of the most probable.
    """
    best = diagnosis.best
    if _is_judged(diagnosis):
        return _left(best, best.z), best.data
    fit = refit(form, diagnosis.nothing.data, likeliest(diagnosis.weights), diagnosis.nothing)
    return _left(fit, fit.z), fit.data


def _is_judged(found: Found[Any] | Diagnosis) -> bool:
    """Whether abstention is judged by what was kept: not by nothing where that is improbable."""
    return bool(found.best.effects) or is_null_probable(found.none)


def _left(fit: Fit, z: np.ndarray) -> np.ndarray:
    """Disturbance (segments, bins, 6) that the model with scaled parameters z (P,) leaves, in the fit's
    linearisation.
    """
    return evidence.disturbances(fit.lin, fit.process, z - fit.lin.z, fit.local - fit.lin.local)


def _reading(chosen: Space, nothing: Fit) -> np.ndarray:
    """Scaled values (P,) of a model that adds nothing: only what the logs declare unknown is fitted."""
    unknown = [i for i, column in enumerate(chosen.columns) if column.owner in chosen.unknown]
    z = np.zeros(len(chosen.columns))
    z[unknown] = nothing.z[unknown]
    return z


def _named(
    chosen: Space, diagnosis: Diagnosis, aliases: Mapping[str, Mapping[str, float]]
) -> tuple[Named, ...]:
    values, sd = chosen.values(diagnosis.best.z), np.sqrt(np.diag(diagnosis.best.covariance)) * chosen.scale
    out = []
    for name in diagnosis.best.effects:
        effect = chosen.effect(name)
        parameters = {
            chosen.columns[i].key: Value(value=float(values[i]), sd=float(sd[i]), unit=chosen.columns[i].unit)
            for i in chosen.groups[name]
        }
        others: dict[str, float] = {}
        for other, probability in aliases[name].items():
            title = chosen.effect(other).name
            others[title] = others.get(title, 0.0) + probability
        exact = exact_aliases(chosen, diagnosis.best.z, diagnosis.best.covariance, effect.name)
        for other in exact:
            others.setdefault(other, diagnosis.inclusion[name])
        out.append(
            Named(
                name=effect.name,
                title=effect.title,
                parameters=parameters,
                probability=diagnosis.inclusion[name],
                aliases=others,
                exact_aliases=exact,
            )
        )
    return tuple(out)


def _model(
    chosen: Space,
    diagnosis: Diagnosis,
    z: np.ndarray,
    flights: Sequence[Flight],
    named: Sequence[Named],
    added: bool,
    provenance: Mapping[str, object] | None,
) -> Model:
    """The model file's content: named effects, everything else within tolerance as adjustments.

    Unless effects are `added` there are none, no adjustments beside what the logs declare unknown, and no
    covariance.
    """
    values = chosen.values(z)
    found = {effect.name for effect in named}
    tables: dict[bool, dict[str, dict[str, float]]] = {True: {}, False: {}}
    kept = [owner for owner in chosen.owners if added or owner in chosen.unknown]
    for owner in kept:
        table = {chosen.columns[i].key: float(values[i]) for i in chosen.owners[owner]}
        tables[owner in found][owner] = table
    covariance = None
    if added:
        scaled = diagnosis.best.covariance * np.outer(chosen.scale, chosen.scale)
        covariance = Covariance(
            names=tuple(f"{c.owner}.{c.key}" for c in chosen.columns),
            matrix=tuple(tuple(float(x) for x in row) for row in 0.5 * (scaled + scaled.T)),
        )
    data, vehicle = diagnosis.best.data, flights[0].vehicle
    tilt = np.arccos(np.clip(data.attitude[:, :, 8], -1.0, 1.0))
    speed = np.linalg.norm(np.diff(data.position, axis=1), axis=2) / data.dt_s
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


def _errors(
    drive: str,
    form: Form,
    diagnosis: Diagnosis,
    added: bool,
    model: Model,
    held_out: Sequence[Flight],
    effects: Mapping[str, Effect],
) -> tuple[tuple[Errors, ...], tuple[Errors, ...], tuple[Errors, ...]]:
    """Held-out errors with nothing, with everything, and with the adjustments only."""
    if not held_out:
        return (), (), ()
    chosen = form.space
    named = [i for name in diagnosis.best.effects for i in chosen.groups[name]]
    bare = Model(vehicle_id=model.vehicle_id, vehicle_name=model.vehicle_name, adjustments=model.adjustments)

    def predict(values: np.ndarray, whole: Model | None) -> tuple[Errors, ...]:
        if drive == "reference":
            return predict_flights(held_out, whole, effects)
        return predict_segments(held_out, form, values)

    before = predict(_reading(chosen, diagnosis.nothing), None)
    if not added:
        return before, before, before
    z = diagnosis.best.z
    middle = z.copy()
    middle[named] = 0.0
    return before, predict(z, model), predict(middle, bare)
