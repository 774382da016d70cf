"""From flights to a model with a learned residual: split by reference, learn, select by whole flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.base.parallel import cores, one_thread_of_algebra
from trimtab.host.effects import Effect
from trimtab.host.learn.candidates import Candidate, best, note
from trimtab.host.learn.condensed import CondensedSettings
from trimtab.host.learn.evaluate import Errors, model_errors, model_parts
from trimtab.host.learn.quick import CondensedTrained, train_condensed
from trimtab.host.learn.result import Judged, Learned, improves
from trimtab.host.learn.split import Split
from trimtab.host.learn.train import LOSS_SIGMA, Settings, Trained, train
from trimtab.host.log import Flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.log.provenance import count_simulated
from trimtab.host.models.airframe import Part
from trimtab.host.models.model import Model
from trimtab.host.models.phi import Phi
from trimtab.host.models.region import Region
from trimtab.host.models.segments import Segments, cut
from trimtab.host.models.slots import mocap_latency_s
from trimtab.host.models.states import States

SEGMENT_STEPS = 50
"""Steps of 20 ms in a segment of one second."""

DEFAULT_FORMS = ("linear-drag", "com-offset")
"""Effects to learn beside a network: an acceleration that grows with speed, and a constant torque.

The law's rate integral balances that torque, and every segment begins with that integral. A model without
the torque therefore swings at the start of every segment. A network, which gives no torque, would learn that
swing as an acceleration, and whole flights have no such swing.
"""


@one_thread_of_algebra()
def learn(  # noqa: PLR0913 (one keyword for each choice)
    flights: Sequence[Flight],
    *,
    hold_out: Sequence[Flight] | None = None,
    base: Model | None = None,
    effects: Mapping[str, Effect] | None = None,
    settings: Settings | CondensedSettings | None = None,
    forms: Sequence[str] = (),
    seed: int = 0,
    as_asked: bool = False,
    jobs: int | None = None,
    provenance: Mapping[str, Any] | None = None,
    on_epoch: Callable[[int, float], None] | None = None,
) -> Learned:
    """Return a model learned from `flights` of one vehicle, or less where less predicts better.

    Segments decide when learning stops. Whole flights decide what the model gets: nothing, the effects, or
    the network too (`trimtab.host.learn.candidates.best`).

    hold_out: flights for the test; None for those of every fourth reference, of three or more. base: a model
    whose effects and adjustments stay as they are; the residual that they leave is learned. effects: the
    library, by name. forms: effects of the library that are learned beside the network, on the condensed loss
    only; they replace adjustments of the base. as_asked:
    select everything that was asked for, even where less predicts better. jobs: threads of the condensed
    loss; as many as there are cores if None. The result does not depend on it.

    Raises TooLittleData, also for flights of two vehicles.
    """
    settings = settings or CondensedSettings()
    rng = np.random.default_rng(seed)
    library = effects or {}
    if base is not None:
        base = base.without_adjustments(forms)
    parts = model_parts(base, library)
    data = Split.of(flights, hold_out, float(mocap_latency_s(FLOAT, parts)), rng)
    grown = (*(effect for effect, _ in parts), *(library[name] for name in forms))
    late = any(effect.mocap_latency_s is not None for effect in grown)
    phi = Phi(vehicle=flights[0].vehicle, effects=grown, estimator=late, parameters=data.used[0].parameters)
    segments = _segments(data.used, phi, rng)
    candidates, trained = _candidates(phi, parts, forms, segments, settings, rng, jobs, on_epoch)
    trials = tuple(data.trial(candidate) for candidate in candidates)
    selected = trials[-1] if as_asked else best(trials)
    candidate = candidates[trials.index(selected)]
    late_log = isinstance(settings, CondensedSettings) and settings.delay
    model = _model(base, candidate, library, data, provenance or {})
    nothing, test = trials[0], None
    if nothing.test and selected.test:
        bare = Candidate(phi=replace(phi, effects=()), theta=np.zeros(0))
        by_inputs = data.test_errors(bare) if base is not None and data.test_drive == "inputs" else None
        test = _judged(data, data.test, nothing.test, selected.test, base, model, nominal=by_inputs)
        test = replace(test, drive=data.test_drive)
    train_errors = _judged(data, data.used, nothing.train, selected.train, base, model)
    return Learned(
        model=_assessed(model, base, train_errors, test),
        train=train_errors,
        test=test,
        trials=trials,
        selected=selected,
        trained=trained,
        segments=segments[0].count,
        forms=tuple(forms),
        flights=len(flights) + len(hold_out or ()),
        simulated_flights=count_simulated(each.metadata for each in (*flights, *(hold_out or ()))),
        log_latency_s=candidate.delay_s if late_log else None,
        notes=(
            *note(trials, selected),
            *_small_batch(segments[0], settings),
            *(line for states in [*data.used, *data.test] for line in states.notes),
        ),
    )


def _judged(
    data: Split,
    chosen: Sequence[States],
    before: Errors,
    learned: Errors,
    base: Model | None,
    model: Model,
    *,
    nominal: Errors | None = None,
) -> Judged:
    """Return the errors on some of the flights, without and with the learned model.

    nominal: of the vehicle file alone; None to compute them on whole flights.
    """
    assert model.region is not None
    if nominal is None:
        flights = [data.logs[s.flight_id] for s in chosen]
        nominal = before if base is None else model_errors(flights, None, {})
    return Judged(
        flights=tuple(s.flight_id for s in chosen),
        references=tuple(dict.fromkeys(s.reference_id for s in chosen)),
        nominal=nominal,
        base=before,
        learned=learned,
        outside=float(model.region.outside(*_states_and_thrust(chosen)).mean()),
    )


def _candidates(
    phi: Phi,
    parts: Sequence[Part],
    forms: Sequence[str],
    segments: tuple[Segments, Segments],
    settings: Settings | CondensedSettings,
    rng: np.random.Generator,
    jobs: int | None,
    on_epoch: Callable[[int, float], None] | None,
) -> tuple[list[Candidate], Trained | CondensedTrained]:
    """Return all candidates, from nothing learned to everything asked for, and how the last was trained.

    phi has the effects of `parts`, which stay as they are, then those of `forms`.
    """
    theta = phi.theta(parts)
    weight = 1.0 / np.square(LOSS_SIGMA)
    with_estimator = replace(phi, estimator=True)
    before = replace(with_estimator, effects=tuple(effect for effect, _ in parts))
    nothing = Candidate(phi=before, theta=before.theta(parts))
    if not isinstance(settings, CondensedSettings):
        trained = train(phi, theta, *segments, settings, rng, weight=weight, on_epoch=on_epoch)
        return [nothing, replace(nothing, network=trained.network)], trained
    free = [i for i in phi.learnable if i >= len(nothing.theta)]
    effects_alone = [replace(settings, layout=None)] if forms and settings.layout is not None else []
    runs = [
        train_condensed(
            phi,
            theta,
            segments,
            each,
            rng,
            weight=weight,
            free=free,
            jobs=cores() if jobs is None else jobs,
            on_iteration=on_epoch if each is settings else None,
        )
        for each in (*effects_alone, settings)
    ]
    learned = [
        Candidate(
            phi=with_estimator,
            theta=run.theta,
            forms=tuple(forms),
            network=run.network,
            delay_s=run.delay_s,
        )
        for run in runs
    ]
    return [nothing, *learned], runs[-1]


def _model(
    base: Model | None,
    candidate: Candidate,
    library: Mapping[str, Effect],
    data: Split,
    provenance: Mapping[str, Any],
) -> Model:
    """Return the base model with what the candidate adds."""
    vehicle = candidate.phi.vehicle
    model = base or Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name)
    values = {effect.name: values for effect, values in candidate.phi.parts(candidate.theta)}
    effects = {
        name: dict(zip(library[name].keys, map(float, values[name]), strict=True)) for name in candidate.forms
    }
    return replace(
        model,
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects={**model.effects, **effects},
        sources={**model.sources, **{name: library[name].source_id for name in candidate.forms}},
        network=candidate.network,
        region=region(data.used),
        data=tuple(sorted({s.flight_id for s in data.used} | set(model.data))),
        provenance=provenance,
    )


def _assessed(model: Model, base: Model | None, train_errors: Judged, test: Judged | None) -> Model:
    """Return the model with its assessment. It is undecided without improvement, or if the base is."""
    earlier = None if base is None else base.assessment
    decided = improves(train_errors, test) and (earlier is None or earlier.verdict != "undecided")
    return model.assessed(
        "learned" if decided else "undecided",
        probabilities={} if earlier is None else earlier.probabilities,
        flights=0 if test is None else len(test.flights),
        before_m=None if test is None else test.base.position_rmse_m,
        after_m=None if test is None else test.learned.position_rmse_m,
    )


def region(states: Sequence[States]) -> Region:
    """Return the speeds, tilts and collective thrusts that the flights went through."""
    return Region.of(*_states_and_thrust(states))


def _states_and_thrust(states: Sequence[States]) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (n, 12) and collective thrusts (n,), N, of all samples."""
    return np.concatenate([s.x for s in states]), np.concatenate([s.thrust for s in states]).sum(axis=1)


def _segments(used: Sequence[States], phi: Phi, rng: np.random.Generator) -> tuple[Segments, Segments]:
    """Return segments to fit, and a fifth of all, drawn at random, that decide when to stop."""
    try:
        segments = cut(used, phi, steps=SEGMENT_STEPS)
    except ValueError as error:
        raise TooLittleData(f"{error}; learning needs flights of several seconds") from None
    if segments.count < 8:
        raise TooLittleData(
            f"{segments.count} segments of a second are too few to learn from; give 8 s of flight or more"
        )
    order = rng.permutation(segments.count)
    checks = max(2, segments.count // 5)
    return segments.take(order[checks:]), segments.take(order[:checks])


def _small_batch(segments: Segments, settings: Settings | CondensedSettings) -> list[str]:
    """Return a note where a batch holds all segments."""
    if isinstance(settings, CondensedSettings) or segments.count >= settings.batch:
        return []
    return [
        f"{segments.count} segments of a second are fewer than a batch of {settings.batch}: every batch "
        "holds all of them; more flights would help"
    ]
