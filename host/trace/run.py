"""A trace from logs to the answer: the rooms of `trimtab.host.trace`, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from trimtab.host.effects import Effect
from trimtab.host.effects.unknowns import TORQUE
from trimtab.host.log import Flight
from trimtab.host.trace.assembly import held_out_errors, model_of, named_effects
from trimtab.host.trace.data.audit import with_missing_twins
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.logs import observable_effects, read_logs
from trimtab.host.trace.decision.decide import decide, tracking_shortfall
from trimtab.host.trace.flight_fit.loop import tracking_extent
from trimtab.host.trace.gathering import gather_evidence
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
from trimtab.host.trace.next_flight.separation import propose
from trimtab.host.trace.parameters import space
from trimtab.host.trace.prediction import noise_floor
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
    """Trace `flights` to the effects that their model lacks, and score the answer on `held_out`.

    A next flight is chosen from `manoeuvres` where the data cannot decide. With `network`, one learns what is
    left of a cause outside the library. Raises LogsRefused and LogsRefused.
    """
    logs = read_logs(flights, held_out, vehicle)
    report("reading segments")
    chosen = space(logs.vehicle, observable_effects(effects, flights), logs.unknown)
    data, audits = segments_of(logs.flights, rate_driven=TORQUE in logs.unknown)
    form = SegmentModel.of(logs.vehicle, chosen, data)
    extent = tracking_extent(logs.flights)
    whole = logs.drive == "reference" and tracking_shortfall(*extent) is None
    diagnosis = select_effects(form, data, logs.flights if whole else (), logs.twins, report)
    decision = decide(gather_evidence(form, diagnosis, logs.twins, logs.unknown, *extent))
    added, nothing = decision.effects_added, diagnosis.null_fit
    named = named_effects(chosen, diagnosis, decision.aliases) if added else ()
    theta_scaled = diagnosis.selected.theta_scaled if added else unknowns_only(chosen, nothing)
    model = model_of(chosen, diagnosis, theta_scaled, flights, named, added, provenance)
    report("predicting the held-out flights")
    before, after, adjusted = held_out_errors(logs, form, diagnosis, added, model, effects)
    following = description = more = None
    if decision.to_separate is not None and manoeuvres is not None:
        report("looking for the flight that decides")
        following = propose(form, diagnosis.selected, *decision.to_separate, manoeuvres())
    if not added:
        report("describing what is outside the library")
        left = disturbance_left(nothing, theta_scaled)
        description = describe(left, nothing.data, [f.reference_id for f in flights], logs.vehicle)
        if network and logs.drive == "reference":
            more = unexplained(flights, held_out, model, effects, description, report)
    return Trace(
        verdict=decision.verdict,
        findings=decision.findings,
        effects=named,
        possible=decision.possible,
        drive=logs.drive,
        before=before,
        after=after,
        adjustments_only=adjusted,
        noise_floor=noise_floor(logs, model, effects),
        next_flight=following,
        model=model,
        space=chosen,
        diagnosis=diagnosis,
        residual=decision.residual,
        audits=with_missing_twins(audits, logs.twins),
        description=description,
        unexplained=more,
    )
