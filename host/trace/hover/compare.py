"""The comparison of two sets of hovers, as a trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.effects.unknowns import THRUST_CURVE
from trimtab.host.log import Flight, changed_between
from trimtab.host.log.provenance import count_simulated
from trimtab.host.models.model import Model
from trimtab.host.models.region import Region
from trimtab.host.trace.assembly import SPEED_S, covariance_of, values_of
from trimtab.host.trace.data.audit import audit
from trimtab.host.trace.data.logs import TraceData
from trimtab.host.trace.data.signals import nominal_thrust, without_inputs
from trimtab.host.trace.data.stretches import within
from trimtab.host.trace.decision.alternatives import possible_beside
from trimtab.host.trace.decision.decide import hidden, is_null_open, not_excluded
from trimtab.host.trace.decision.findings import Code, Finding, LogsRefused, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.hover.balance import balances
from trimtab.host.trace.hover.fit import HoverDiagnosis, HoverFit, HoverFitter
from trimtab.host.trace.hover.mean import hover_mean
from trimtab.host.trace.parameters import ParameterSpace, space
from trimtab.host.trace.residual.unexplained import NOTHING_UNEXPLAINED
from trimtab.host.trace.result import Baseline, Named, Trace
from trimtab.host.trace.search import null_probability_of
from trimtab.host.trace.selection import detectability


def compares_hovers(flights: Sequence[Flight]) -> bool:
    """Return whether the logs are compared by their hovers: motor commands or thrusts, but no body rate."""
    return all(
        flight.control is None
        and not without_inputs(flight)
        and (flight.recorded_imu is None or flight.recorded_imu.gyro is None)
        for flight in flights
    )


def at_first_start(effect: Effect) -> Effect:
    """Return an effect with states whose other parameters than strengths are neutral at its first start.

    A hover does not tell them. With the shortest line, a payload hangs free in most hovers, so its weight
    shows; that of one on the floor would not.
    """
    if not (effect.memory and effect.starts):
        return effect
    start = dict(zip(effect.keys, effect.starts[0], strict=False))  # without the form
    parameters = (
        parameter
        if parameter.strength or parameter.form
        else replace(parameter, neutral=start[parameter.key])
        for parameter in effect.parameters
    )
    return replace(effect, parameters=tuple(parameters))


def compare(
    logs: TraceData, effects: Mapping[str, Effect], baseline: int, provenance: Mapping[str, object] | None
) -> Trace:
    """Return what changed between the first `baseline` flights of `logs` and the others.

    Raises LogsRefused for a log with too little time in the air, and for held-out flights.
    """
    vehicle = logs.vehicle
    if logs.held_out:
        raise LogsRefused(
            Code.ONLY_HOVER,
            f"{logs.held_out[0].flight.path}: without a body rate in the logs, a comparison predicts no "
            "flight; leave out --hold-out",
        )
    flights = [data.flight for data in logs.flights]
    audits = [audit(data) for data in logs.flights]
    means = [hover_mean(data, each) for data, each in zip(logs.flights, audits, strict=True)]
    parameters = space(
        vehicle,
        {
            name: replace(at_first_start(effect), adjustment=False, replaced_by=(), freed_by=())
            for name, effect in effects.items()
            if effect.changes_hover
        },
    )
    shares = RULES.thrust_curve_linear if THRUST_CURVE in logs.unknown else vehicle.thrust_curve[:1]
    fitter = HoverFitter(
        vehicle=vehicle,
        space=parameters,
        curves=[balances(vehicle, parameters, means, baseline, share) for share in shares],
        baseline=baseline,
    )
    fits = [fitter.fit(cause) for cause in fitter.causes]
    top = max(fit.log_evidence for fit in fits)
    weights = {fit.effects: float(np.exp(fit.log_evidence - top)) for fit in fits}
    selected = max(fits, key=lambda fit: fit.log_evidence)
    inclusion = {
        name: sum(w for names, w in weights.items() if name in names) / sum(weights.values())
        for name in parameters.candidates
    }
    aliases, null_open = _alternatives(fits, selected, inclusion, null_probability_of(weights))
    named = _named(parameters, selected, inclusion, aliases)
    possible = possible_beside(selected.effects, aliases, inclusion, RULES)
    verdict = _verdict(named, null_open)
    sigmas = detectability(parameters, selected.gram, parameters.prior.precision(selected.effects))
    return Trace(
        verdict=verdict,
        findings=(
            Finding(code=Code.ONLY_HOVER),
            *not_excluded(aliases, possible),
            *hidden(sigmas, selected.effects, parameters),
        ),
        effects=named,
        possible=possible,
        drive="inputs",
        before=(),
        after=(),
        adjustments_only=(),
        noise_floor={"position_rmse_m": None, "velocity_rmse_m_s": None},
        next_flight=None,
        model=_model(parameters, selected, logs, named, provenance).assessed(
            verdict.value,
            probabilities={**possible, **{each.name: each.probability for each in named}},
            flights=0,
            before_m=None,
            after_m=None,
        ),
        space=parameters,
        diagnosis=HoverDiagnosis(selected=selected, posterior_weights=weights),
        residual=NOTHING_UNEXPLAINED,
        audits=tuple(replace(each, used_s=mean.flying_s) for each, mean in zip(audits, means, strict=True)),
        description=None,
        unexplained=None,
        baseline=Baseline(
            logs=tuple(each.log for each in audits[:baseline]),
            common={},
            thrust_sigma=selected.thrust_sigma,
            settings=changed_between(flights[:baseline], flights[baseline:]),
        ),
        simulated_flights=count_simulated(flight.metadata for flight in flights),
    )


def _alternatives(
    fits: Sequence[HoverFit], selected: HoverFit, inclusion: Mapping[str, float], null_probability: float
) -> tuple[dict[str, dict[str, float]], bool]:
    """Return the aliases of each effect of the selected cause, and whether nothing may have changed.

    Four numbers a log are few. So another cause is open not only if its posterior probability exceeds
    RULES.alias_probability. It also is, with RULES.open_probability, if it explains at least half of what the
    selected cause explains and fits as well within RULES.tie_nats, whatever its prior (`HoverFit.widest`).
    """
    null = next(fit for fit in fits if not fit.effects)
    tie = selected.widest + 2.0 * RULES.tie_nats
    bound = min(tie, 0.5 * (selected.widest + null.widest))
    fitting = {name for fit in fits if fit.widest <= bound for name in fit.effects}
    others = {name: p for name, p in inclusion.items() if p > RULES.alias_probability}
    others |= {name: max(inclusion[name], RULES.open_probability) for name in fitting}
    others = dict(sorted(others.items(), key=lambda item: (-item[1], item[0])))
    aliases = {
        name: {other: p for other, p in others.items() if other not in selected.effects}
        for name in selected.effects
    }
    return aliases, is_null_open(null_probability) or null.widest <= tie


def _verdict(named: Sequence[Named], null_open: bool) -> Verdict:
    """Return the verdict: nothing if no change is the most probable answer, and a name only without rival."""
    if not named:
        return Verdict.NOTHING_MISSING
    return Verdict.UNDECIDED if null_open or any(each.aliases for each in named) else Verdict.TRACED


def _named(
    space: ParameterSpace,
    selected: HoverFit,
    inclusion: Mapping[str, float],
    aliases: Mapping[str, Mapping[str, float]],
) -> tuple[Named, ...]:
    """Return the selected effects with values, standard deviations, probabilities and aliases."""
    named = []
    for name in selected.effects:
        effect, others = space.effect(name), {}
        for other, p in aliases[name].items():
            other_name = space.effect(other).name
            other_name = other if other_name == effect.name else other_name  # another rotor
            others[other_name] = max(others.get(other_name, 0.0), p)
        open_share = max(others.values(), default=0.0)
        named.append(
            Named(
                name=effect.name,
                title=effect.title,
                parameters=values_of(space, selected, name),
                probability=min(inclusion[name], 1.0 - open_share),
                aliases=others,
                exact_aliases={},
            )
        )
    return tuple(named)


def _model(
    space: ParameterSpace,
    selected: HoverFit,
    logs: TraceData,
    named: Sequence[Named],
    provenance: Mapping[str, object] | None,
) -> Model:
    """Return the model that holds the named effects."""
    columns = [i for name in selected.effects for i in space.groups[name]]
    return Model(
        vehicle_id=logs.vehicle.id,
        vehicle_name=logs.vehicle.name,
        effects={each.name: _whole(space, selected, each.name) for each in named},
        covariance=covariance_of(space, selected, columns) if columns else None,
        sources={each.name: space.effects[each.name].source_id for each in named},
        region=_region(logs),
        data=tuple(data.flight.id for data in logs.flights),
        provenance=dict(provenance or {}),
    )


def _region(logs: TraceData) -> Region:
    """Return the speeds, tilts and nominal thrusts of the flights."""
    speeds, cosines, thrusts = [], [], []
    for s in (data.signals for data in logs.flights):
        flown = within(s.pose_s, s.span_s)
        t_s, p = s.pose_s[flown], s.p_ned[flown]
        later = np.searchsorted(t_s, t_s + SPEED_S)
        first, second = np.flatnonzero(later < len(t_s)), later[later < len(t_s)]
        speeds.append(np.linalg.norm(p[second] - p[first], axis=1) / (t_s[second] - t_s[first]))
        cosines.append(s.R_ned_frd[flown, 2, 2])
        commands = s.command[within(s.input_s[:, 1], s.span_s)]
        thrusts.append(nominal_thrust(logs.vehicle, commands, in_newton=s.in_newton).sum(-1))
    return Region.measured(np.concatenate(speeds), np.concatenate(cosines), np.concatenate(thrusts))


def _whole(space: ParameterSpace, selected: HoverFit, owner: str) -> dict[str, float]:
    """Return all values of an effect by key; those that its candidate does not move are neutral."""
    moved = {i for name in selected.effects for i in (*space.groups[name], *space.forms[name])}
    values = space.values(
        np.where([i in moved for i in range(len(space.columns))], selected.theta_scaled, 0.0)
    )
    return {space.columns[i].key: float(values[i]) for i in space.owners[owner]}
