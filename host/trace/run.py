"""A trace from logs to the answer: the rooms of `trimtab.host.trace`, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.trace.assembly import held_out_errors, model_of, named_effects
from trimtab.host.trace.data.audit import with_missing_twins
from trimtab.host.trace.data.cutting import SEGMENT_S, segments_of
from trimtab.host.trace.data.logs import check_logs, observable_effects
from trimtab.host.trace.data.signals import unknowns
from trimtab.host.trace.decision.decide import decide, tracking_shortfall
from trimtab.host.trace.flight_fit.loop import tracking_extent
from trimtab.host.trace.gathering import gather_evidence
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
from trimtab.host.trace.next_flight.separation import NextFlight, propose
from trimtab.host.trace.parameters import space
from trimtab.host.trace.prediction import (
    drive_of,
    noise_floor,
    predict_flights,
    rmse,
    twins_of,
)
from trimtab.host.trace.residual.description import describe
from trimtab.host.trace.residual.network import unexplained
from trimtab.host.trace.result import Trace
from trimtab.host.trace.segment_fit.fit import disturbance_left, unknowns_only
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import select_effects
from trimtab.host.vehicle import Vehicle

Report = Callable[[str], None]
Manoeuvres = Callable[[], Sequence[Manoeuvre]]


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
    chosen = space(airframe, observable_effects(effects, flights), unknown)
    data, audits = segments_of(flights, rate_driven="torque" in unknown)
    form = SegmentModel(
        airframe, chosen, dt_s=data.dt_s, in_newton=data.in_newton, rate_driven=data.rate_driven
    )
    drive = drive_of([*flights, *held_out])
    tracking_s, extent_m = tracking_extent(flights)
    enough = tracking_shortfall(tracking_s, extent_m) is None
    diagnosis = select_effects(form, data, flights if drive == "reference" and enough else (), report)
    twins = twins_of(flights)
    decision = decide(gather_evidence(form, diagnosis, twins, unknown, tracking_s, extent_m))
    added, nothing = decision.effects_added, diagnosis.nothing
    named = named_effects(chosen, diagnosis, decision.aliases) if added else ()
    z = diagnosis.best.z if added else unknowns_only(chosen, nothing)
    model = model_of(chosen, diagnosis, z, flights, named, added, provenance)

    report("predicting the held-out flights")
    before, after, middle = held_out_errors(drive, form, diagnosis, added, model, held_out, effects)
    following: NextFlight | None = None
    if decision.to_separate is not None and manoeuvres is not None:
        report("looking for the flight that decides")
        following = propose(form, diagnosis.best, *decision.to_separate, manoeuvres())
    described = more = None
    if not added:
        report("describing what is outside the library")
        described = describe(
            disturbance_left(nothing, z), nothing.data, [f.reference_id for f in flights], airframe
        )
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
