"""Trace flight logs: call the packages of `trimtab.host.trace` in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from trimtab.host.base import parallel
from trimtab.host.effects import Effect
from trimtab.host.effects.unknowns import THRUST, TORQUE
from trimtab.host.log import Flight, changed_between
from trimtab.host.log.provenance import count_simulated
from trimtab.host.trace.assembly import (
    after_change,
    assessed,
    far_adjustments,
    held_out_errors,
    model_of,
    named_effects,
)
from trimtab.host.trace.baseline import baseline_of, check_baseline
from trimtab.host.trace.data.audit import with_missing_repeats
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.logs import TraceData, observable_effects, read_logs
from trimtab.host.trace.data.real_time import late_share
from trimtab.host.trace.data.sets import check_sets
from trimtab.host.trace.decision.decide import decide, tracking_shortfall
from trimtab.host.trace.decision.findings import Verdict
from trimtab.host.trace.flight_fit.loop import amount_of_tracking
from trimtab.host.trace.gathering import gather_inputs
from trimtab.host.trace.hover.compare import compare, compares_hovers
from trimtab.host.trace.joint import JointSpace, joint_space
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
from trimtab.host.trace.next_flight.separation import propose
from trimtab.host.trace.parameters import ParameterSpace, space
from trimtab.host.trace.prediction import noise_floor
from trimtab.host.trace.residual.description import describe
from trimtab.host.trace.residual.network import train_network
from trimtab.host.trace.result import Trace
from trimtab.host.trace.segment_fit.fit import disturbance_left, theta_without_effects
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import select_effects
from trimtab.host.vehicle import Vehicle

OnProgress = Callable[[str], None]
Manoeuvres = Callable[[], Sequence[Manoeuvre]]


@parallel.one_thread_of_algebra()
def run(  # noqa: PLR0913 (one keyword for each choice)
    flights: Sequence[Flight],
    held_out: Sequence[Flight],
    effects: Mapping[str, Effect],
    *,
    baseline: Sequence[Flight] = (),
    vehicle: Vehicle | None = None,
    manoeuvres: Manoeuvres | None = None,
    provenance: Mapping[str, object] | None = None,
    network: bool = False,
    jobs: int | None = None,
    on_progress: OnProgress = lambda _: None,
) -> Trace:
    """Find the effects that the nominal model of `flights` lacks, and score the result on `held_out`.

    With a baseline, find what changed between the baseline and `flights`.

    Parameters
    ----------
    flights
        Logs in which effects are searched.
    held_out
        Logs that only the prediction error is computed on.
    effects
        Candidate effects by name.
    baseline
        Logs before the change; none to compare with the nominal model.
    vehicle
        Vehicle of all logs; that of the first log if None.
    manoeuvres
        Returns the candidates for the next flight. It is called only if the verdict is undecided; None to
        propose no flight.
    provenance
        Recorded in the model file.
    network
        Whether to train a network on the residual if the cause is outside the library and all logs hold a
        reference and the control law.
    jobs
        Threads that work on flights; as many as there are cores if None. The result does not depend on it.
    on_progress
        Called with a text as each step begins or ends.

    Raises
    ------
    LogsRefused
        If the logs cannot be traced, alone or together.
    """
    jobs = parallel.cores() if jobs is None else jobs
    if baseline:
        check_sets(flights, baseline)
    logs = read_logs([*baseline, *flights], held_out, vehicle)
    if baseline and compares_hovers([data.flight for data in logs.flights]):
        on_progress("comparing hovers")
        return compare(logs, effects, len(baseline), provenance)
    logs = logs.compared(len(baseline)) if baseline else logs
    on_progress("reading segments")
    parameters = _space(logs, effects, len(baseline))
    data, audits = segments_of(logs.flights, rate_driven=TORQUE in logs.unknown)
    segment_model = SegmentModel.of(logs.vehicle, parameters, data, jobs=jobs)
    if baseline:
        on_progress("fitting the baseline")
        thrust_known = THRUST not in logs.unknown
        check_baseline(segment_model, data, baseline, logs.repeat_flights, thrust_known=thrust_known)
    tracking = amount_of_tracking(logs.flights)
    shortfall = tracking_shortfall(*tracking)
    whole_flights = logs.flights if logs.drive == "reference" and shortfall is None else ()
    diagnosis = select_effects(segment_model, data, whole_flights, logs.repeat_flights, on_progress)
    late = {each.path.name: late_share(each) for each in (*baseline, *flights)}
    decision = decide(
        gather_inputs(segment_model, diagnosis, logs.repeat_flights, logs.unknown, tracking, late)
    )
    within_library, null_fit = decision.within_library, diagnosis.null_fit
    named = (
        named_effects(parameters, diagnosis, decision.aliases, decision.probabilities)
        if within_library
        else ()
    )
    model_after, answer = after_change(segment_model, diagnosis)
    space_after = model_after.space
    theta_after = (
        answer.selected.theta_scaled
        if within_library
        else theta_without_effects(space_after, answer.null_fit)
    )
    every = [*baseline, *flights]
    model = model_of(space_after, answer, theta_after, every, named, within_library, provenance)
    on_progress("predicting the held-out flights")
    before, after, adjusted = held_out_errors(logs, model_after, answer, within_library, model, effects)
    next_flight = description = learned = None
    if decision.to_separate is not None and manoeuvres is not None:
        on_progress("searching for the next flight")
        next_flight = propose(segment_model, diagnosis.selected, *decision.to_separate, manoeuvres())
    if decision.verdict is Verdict.OUTSIDE_LIBRARY:
        on_progress("describing the unexplained disturbance")
        disturbance = disturbance_left(null_fit, theta_without_effects(parameters, null_fit))
        description = describe(disturbance, null_fit.data, [f.reference_id for f in every], logs.vehicle)
        if network and logs.drive == "reference":
            learned = train_network(flights, held_out, model, effects, description, on_progress)
    return Trace(
        verdict=decision.verdict,
        findings=(*decision.findings, *far_adjustments(space_after, model)),
        effects=named,
        possible=decision.possible,
        drive=logs.drive,
        before=before,
        after=after,
        adjustments_only=adjusted,
        noise_floor=noise_floor(logs, model, effects, jobs=jobs),
        next_flight=next_flight,
        model=assessed(model, decision, named, before, after),
        space=parameters,
        diagnosis=diagnosis,
        residual=decision.residual,
        audits=with_missing_repeats(audits, logs.repeat_flights),
        description=description,
        unexplained=learned,
        baseline=(
            baseline_of(
                parameters,
                diagnosis.selected,
                [each.log for each in audits[: len(baseline)]],
                changed_between(baseline, flights),
            )
            if isinstance(parameters, JointSpace)
            else None
        ),
        simulated_flights=count_simulated(flight.metadata for flight in every),
    )


def _space(logs: TraceData, effects: Mapping[str, Effect], baseline: int) -> ParameterSpace:
    """Return the parameter space of the flights, of which the first `baseline` are the baseline."""
    flights = [data.flight for data in logs.flights]
    in_newton = all(f.recorded_inputs is not None and f.recorded_inputs.thrust_n is not None for f in flights)
    observable = observable_effects(effects, flights)
    if not baseline:
        return space(logs.vehicle, observable, logs.unknown, thrust_commanded=in_newton)
    return joint_space(
        logs.vehicle,
        observable,
        logs.unknown,
        [index >= baseline for index in range(len(flights))],
        thrust_commanded=in_newton,
    )
