"""From flights to a model with a learned residual: split by reference, learn, keep what predicts best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.effects import Effect
from trimtab.host.learn.candidates import Candidate, Trial, best, note
from trimtab.host.learn.evaluate import Errors, model_errors, model_parts, whole_flights
from trimtab.host.learn.quick import CondensedSettings, CondensedTrained, train_condensed
from trimtab.host.learn.train import LOSS_SIGMA, Settings, Trained, train
from trimtab.host.log import Flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.model import Model
from trimtab.host.models.phi import Phi
from trimtab.host.models.region import Region
from trimtab.host.models.segments import Segments, cut
from trimtab.host.models.slots import mocap_latency_s
from trimtab.host.models.states import States, flight_states

SEGMENT_STEPS = 50
"""Of 20 ms: a second."""

DEFAULT_FORMS = ("linear-drag", "com-offset")
"""Effects to learn beside a network: an acceleration that grows with speed, and the torque that the law's
rate integral stands against. Every segment begins with that integral: to a network, which gives no torque,
the swing that a model without the torque makes there looks like an acceleration, and whole flights have none.
"""


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Whole-flight errors on one set of flights.

    nominal: of the vehicle file alone. base: with the effects of the model learned upon, the same where there
    was none. learned: of the model that is kept. outside: share of samples beyond the region learned in.
    """

    flights: tuple[str, ...]
    references: tuple[str, ...]
    nominal: Errors
    base: Errors
    learned: Errors
    outside: float

    @property
    def ratio(self) -> float:
        """Position error with what was learned over that without."""
        return self.learned.position_rmse_m / self.base.position_rmse_m

    def to_json(self) -> dict[str, Any]:
        """Return the errors, those of the nominal vehicle and of the base, and which flights."""
        return {
            **self.learned.to_json(),
            "nominal": self.nominal.to_json(),
            "base": self.base.to_json(),
            "outside_region": self.outside,
            "flights": list(self.flights),
            "references": list(self.references),
        }


@dataclass(frozen=True, kw_only=True)
class Learned:
    """The model that is kept, and how good it is; `test` None: nothing was held out.

    trials: what could be kept, from nothing to what was asked for, with the errors that decide; kept: the one
    that is. trained: what was asked for. log_latency_s: how much older poses are than stamped in the log,
    where that was learned. notes: why less is kept than was asked for, what was cut or left out of the logs.
    """

    model: Model
    train: Judged
    test: Judged | None
    trials: tuple[Trial, ...]
    kept: Trial
    trained: Trained | CondensedTrained
    segments: int
    log_latency_s: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def improved(self) -> bool:
        """Whether flights are predicted better with the model than without: those used and those held out."""
        return all(judged.ratio < 1.0 for judged in (self.train, self.test) if judged is not None)


def learn(
    flights: Sequence[Flight],
    *,
    hold_out: Sequence[Flight] | None = None,
    base: Model | None = None,
    effects: Mapping[str, Effect] | None = None,
    settings: Settings | CondensedSettings | None = None,
    forms: Sequence[str] = (),
    seed: int = 0,
    as_asked: bool = False,
    provenance: Mapping[str, Any] | None = None,
    on_epoch: Callable[[int, float], None] | None = None,
) -> Learned:
    """Return a model learned from `flights` of one vehicle, or less where less predicts better.

    Held out for the test are `hold_out`; None: the flights of every fourth reference where there are three or
    more. A reference is never on both sides. `base` is a model whose effects (found in `effects`) stay as
    they are: what is learned is what they leave. `forms` are effects of the library that are learned beside
    the network, on the condensed loss alone.

    Segments decide when learning stops, whole flights what is kept (`trimtab.host.learn.candidates.best`):
    nothing, the effects, or the network too. `as_asked` keeps what was asked for all the same. Raises
    TooLittleData, also for flights of two vehicles.
    """
    settings = settings or CondensedSettings()
    kept_aside = hold_out or ()
    _check_one_vehicle([*flights, *kept_aside])
    rng = np.random.default_rng(seed)
    library = effects or {}
    parts = model_parts(base, library)
    latency_s = float(mocap_latency_s(FLOAT, parts))
    states = flight_states(flights, latency_s=latency_s)
    if hold_out is None:
        used, test = split_by_reference(states, rng)
    else:
        test = flight_states(kept_aside, latency_s=latency_s)
        shared = {s.reference_id for s in test} & {s.reference_id for s in states}
        if shared:
            names = ", ".join(sorted(shared))
            raise TooLittleData(
                f"held-out flights share the reference {names} with the others; hold out others"
            )
        used = states
    logs = {flight.id: flight for flight in [*flights, *kept_aside]}
    vehicle = flights[0].vehicle
    known = tuple(effect for effect, _ in parts)
    grown = (*known, *(library[name] for name in forms))
    common: dict[str, Any] = {"vehicle": vehicle, "parameters": states[0].parameters}
    late = any(effect.mocap_latency_s is not None for effect in grown)
    phi = Phi(estimator=late, effects=grown, **common)
    theta = phi.theta(parts)
    fitted, checked = _segments(used, phi, rng)
    weight = 1.0 / np.square(LOSS_SIGMA)
    before, after = Phi(effects=known, **common), Phi(effects=grown, **common)

    candidates = [Candidate(phi=before, theta=before.theta(parts))]
    if isinstance(settings, CondensedSettings):
        free = range(sum(len(effect.parameters) for effect in known), len(theta))
        alone = [replace(settings, layout=None)] if forms and settings.layout is not None else []
        found = [
            train_condensed(
                phi,
                theta,
                fitted,
                checked,
                wanted,
                rng,
                weight=weight,
                free=free,
                on_iteration=on_epoch if wanted is settings else None,
            )
            for wanted in (*alone, settings)
        ]
        candidates += [
            Candidate(phi=after, theta=f.theta, forms=tuple(forms), network=f.network, delay_s=f.delay_s)
            for f in found
        ]
        trained = found[-1]
    else:
        trained = train(phi, theta, fitted, checked, settings, rng, weight=weight, on_epoch=on_epoch)
        candidates.append(replace(candidates[0], network=trained.network))

    def errors(of: Candidate, chosen: Sequence[States]) -> Errors:
        if of.latency_s != latency_s:
            chosen = flight_states([logs[s.flight_id] for s in chosen], latency_s=of.latency_s)
        return whole_flights(of.phi, of.theta, chosen, of.network)

    trials = tuple(
        Trial(what=each.what, train=errors(each, used), test=errors(each, test) if test else None)
        for each in candidates
    )
    winner = trials[-1] if as_asked else best(trials)
    kept = candidates[trials.index(winner)]
    values = {effect.name: values for effect, values in kept.phi.parts(kept.theta)}
    learned_in = region(used)
    model = Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects={
            **({} if base is None else base.effects),
            **{
                name: dict(zip(library[name].keys, map(float, values[name]), strict=True))
                for name in kept.forms
            },
        },
        adjustments={} if base is None else base.adjustments,
        covariance=None if base is None else base.covariance,
        sources={
            **({} if base is None else base.sources),
            **{name: library[name].source_id for name in kept.forms},
        },
        network=kept.network,
        region=learned_in,
        data=tuple(sorted({s.flight_id for s in used} | set(() if base is None else base.data))),
        provenance=provenance or {},
    )

    def judged(chosen: Sequence[States], bare: Errors, learned: Errors) -> Judged:
        return Judged(
            flights=tuple(s.flight_id for s in chosen),
            references=tuple(dict.fromkeys(s.reference_id for s in chosen)),
            nominal=bare if base is None else model_errors([logs[s.flight_id] for s in chosen], None, {}),
            base=bare,
            learned=learned,
            outside=float(learned_in.outside(*_states_and_thrust(chosen)).mean()),
        )

    return Learned(
        model=model,
        train=judged(used, trials[0].train, winner.train),
        test=judged(test, trials[0].test, winner.test) if trials[0].test and winner.test else None,
        trials=trials,
        kept=winner,
        trained=trained,
        segments=fitted.count,
        log_latency_s=kept.delay_s,
        notes=(
            *note(trials, winner),
            *_few(fitted, settings),
            *(line for s in [*used, *test] for line in s.notes),
        ),
    )


def split_by_reference(
    states: Sequence[States], rng: np.random.Generator
) -> tuple[list[States], list[States]]:
    """Flights to learn from and flights held out: every fourth reference, at least one of three or more."""
    references = sorted({s.reference_id for s in states})
    if len(references) < 3:
        return list(states), []
    shuffled = [references[i] for i in rng.permutation(len(references))]
    held = set(shuffled[: max(1, len(references) // 4)])
    return (
        [s for s in states if s.reference_id not in held],
        [s for s in states if s.reference_id in held],
    )


def region(states: Sequence[States]) -> Region:
    """Return the speeds, tilts and collective thrusts that the flights went through."""
    return Region.of(*_states_and_thrust(states))


def _states_and_thrust(states: Sequence[States]) -> tuple[np.ndarray, np.ndarray]:
    """(n, 12) and collective thrusts (n,), N, of all samples."""
    return np.concatenate([s.x for s in states]), np.concatenate([s.thrust for s in states]).sum(axis=1)


def _segments(used: Sequence[States], phi: Phi, rng: np.random.Generator) -> tuple[Segments, Segments]:
    """Segments to fit and segments to stop by: a fifth of them, drawn over all flights."""
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


def _few(segments: Segments, settings: Settings | CondensedSettings) -> list[str]:
    """Return a note where a batch holds all there is."""
    if isinstance(settings, CondensedSettings) or segments.count >= settings.batch:
        return []
    return [
        f"{segments.count} segments of a second are fewer than a batch of {settings.batch}: every batch "
        "holds all of them; more flights would help"
    ]


def _check_one_vehicle(flights: Sequence[Flight]) -> None:
    if not flights:
        raise TooLittleData("no flights to learn from; name one or more logs")
    first = flights[0]
    for flight in flights[1:]:
        if flight.vehicle.id != first.vehicle.id:
            one, other = (f"{f.vehicle.name} ({f.vehicle.id})" for f in (flight, first))
            raise TooLittleData(
                f"{flight.path.name} is of vehicle {one}, {first.path.name} of {other}; "
                "learn from one vehicle at a time"
            )
        if flight.firmware_parameters != first.firmware_parameters:
            raise TooLittleData(
                f"{flight.path.name} flew with other firmware parameters than {first.path.name}; "
                "learn from flights of one setting"
            )
