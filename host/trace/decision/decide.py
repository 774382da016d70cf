"""The decision: a pure function of inputs and rules that returns a verdict and findings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from scipy.special import expit

from trimtab.host.trace.decision.alternatives import (
    Aliases,
    Names,
    aliases_of,
    pair_to_separate,
    possible_beside,
    with_each_other,
    with_undetectable,
)
from trimtab.host.trace.decision.findings import CHANNEL_UNITS, Code, Finding, Verdict
from trimtab.host.trace.decision.residual_rules import no_effect_bounds, residual_bounds, residual_findings
from trimtab.host.trace.decision.rules import RULES, Rules
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.residual.unexplained import UnexplainedResidual


@dataclass(frozen=True, kw_only=True)
class DecisionInputs:
    """The numbers that a verdict depends on.

    Parameters
    ----------
    space
        Candidates and the facts about their effects.
    selected
        The set of effects that the search selected.
    null_probability
        Posterior probability that no effect is missing.
    log_evidence
        Log evidence in nats of every fitted set.
    posterior_weights
        Relative posterior weight of every supported set.
    inclusion_probability
        Posterior probability of each candidate.
    detectability
        Sigma by which each effect of typical size would show in these flights.
    by_segments
        Whether the set was selected from segments, not from whole flights in closed loop.
    closed_loop
        Whether there were whole flights to select from. If the set was selected from segments all the same,
        an effect that depends on noise is the reason.
    residual, residual_without
        Unexplained residual of the selected set, and of the model without effects. If the search selected no
        effect although the posterior makes that improbable, `residual` is that of the most probable set.
    disturbance_sigma
        Standard deviations (6,) of the unexplained disturbance of the selected set: force m/s^2, then angular
        acceleration rad/s^2, FRD.
    thrust_known
        Whether the logs determine the thrust. Otherwise the force along the thrust is ignored.
    rate_driven
        Whether the measured body rate drives the attitude. The torque is then ignored.
    segment_disagreement_nats
        For each selected effect: by how many nats segments prefer the set without it; empty if not computed.
    tracking_s, extent_m
        Tracking time of all flights, and the greatest extent of one of them along an axis.
    pose_interval_s
        Longest median interval between the poses of a flight.
    late_share
        For each log, the share of its tracking phase in which time ran late.
    compared
        Whether two sets of flights were compared. For the verdict `nothing-missing` it must then be more
        probable that nothing changed than that something did.
    """

    space: ParameterSpace
    selected: Names
    null_probability: float
    log_evidence: Mapping[Names, float]
    posterior_weights: Mapping[Names, float]
    inclusion_probability: Mapping[str, float]
    detectability: Mapping[str, float]
    by_segments: bool
    closed_loop: bool
    residual: UnexplainedResidual
    residual_without: UnexplainedResidual
    disturbance_sigma: Sequence[float]
    thrust_known: bool
    rate_driven: bool
    segment_disagreement_nats: Mapping[str, float]
    tracking_s: float
    extent_m: float
    pose_interval_s: float
    late_share: Mapping[str, float] = field(default_factory=dict)
    compared: bool = False

    @property
    def has_repeats(self) -> bool:
        """Whether any flights are repeat flights."""
        return self.residual.pairs > 0

    @property
    def has_memory(self) -> bool:
        """Whether a selected effect has states of its own."""
        return any(self.space.effect(name).memory for name in self.selected)


@dataclass(frozen=True, kw_only=True)
class Decision:
    """A verdict with its findings.

    Attributes
    ----------
    verdict, findings
        The verdict, and the comparisons that led to it.
    within_library
        Whether the selected effects go into the model: not if the cause is outside the library, nor if time
        ran late.
    aliases
        For each selected effect: the effects that could replace it, with their probabilities.
    possible
        Probability of further effects that the data does not exclude.
    probabilities
        Probability of each selected effect. If segments judged it too, the smaller of the two counts: each
        fit has its own noise model, and no flight was repeated to show which one is wrong.
    to_separate
        Pair of effects that the next flight should separate; None unless they leave the verdict undecided.
    residual
        Unexplained residual that the findings refer to: `DecisionInputs.residual` or, if the cause is outside
        the library and the model without effects has findings too, `DecisionInputs.residual_without`.
    """

    verdict: Verdict
    within_library: bool
    findings: tuple[Finding, ...]
    aliases: Aliases
    possible: Mapping[str, float]
    probabilities: Mapping[str, float]
    to_separate: tuple[str, str] | None
    residual: UnexplainedResidual


def decide(inputs: DecisionInputs, rules: Rules = RULES) -> Decision:
    """Return the verdict on `inputs`, with its findings and alternatives."""
    outside, residual = _outside(inputs, rules)
    late = time_ran_late(inputs.late_share, 0.0 if outside else rules.late_share)
    if late:
        outside, residual = [], inputs.residual
    shortfall = tracking_shortfall(inputs.tracking_s, inputs.extent_m, inputs.pose_interval_s, rules)
    aliases = _aliases(inputs, shortfall is not None, rules)
    undecided_reasons = [
        *late,
        *([] if inputs.has_repeats else excess_disturbance(inputs, rules)),
        *_disagreement(inputs, rules),
    ]
    verdict = _verdict(inputs, outside, aliases, undecided_reasons, rules)
    added = verdict is not Verdict.OUTSIDE_LIBRARY and not late
    possible = possible_beside(inputs.selected, aliases, inputs.inclusion_probability, rules) if added else {}
    findings = [
        *outside,
        *([] if shortfall is None else [shortfall]),
        *undecided_reasons,
        *_open_alternatives(inputs, verdict, aliases if added else {}, possible, rules),
        *hidden(inputs.detectability, inputs.selected if added else (), inputs.space, rules),
    ]
    undecided = verdict is Verdict.UNDECIDED and added
    return Decision(
        verdict=verdict,
        within_library=added,
        findings=tuple(findings),
        aliases=aliases,
        possible=possible,
        probabilities={
            name: min(
                inputs.inclusion_probability[name],
                expit(-inputs.segment_disagreement_nats.get(name, -math.inf)),
            )
            for name in inputs.selected
        },
        to_separate=(pair_to_separate(aliases, inputs.inclusion_probability, rules) if undecided else None),
        residual=residual,
    )


def _verdict(
    inputs: DecisionInputs,
    outside: Sequence[Finding],
    aliases: Aliases,
    undecided_reasons: Sequence[Finding],
    rules: Rules,
) -> Verdict:
    """Return the verdict.

    Findings that put the cause outside the library take precedence over reasons for `undecided`, and these
    over aliases.
    """
    if outside:
        return Verdict.OUTSIDE_LIBRARY
    if undecided_reasons:
        return Verdict.UNDECIDED
    if not inputs.selected:
        # Sessions differ in thrust, so a change of mass is often probable without being certain.
        bound = rules.majority if inputs.compared else rules.alias_probability
        return Verdict.NOTHING_MISSING if inputs.null_probability > bound else Verdict.UNDECIDED
    return Verdict.UNDECIDED if any(aliases.values()) else Verdict.TRACED


def is_null_open(null_probability: float) -> bool:
    """Return whether it remains possible that the model lacks nothing: its probability exceeds 1/odds."""
    return null_probability > RULES.alias_probability


def _aliases(inputs: DecisionInputs, too_little: bool, rules: Rules) -> dict[str, dict[str, float]]:
    """Return the alternatives to each selected effect.

    too_little: whether there is too little data to fit whole flights, which leaves more alternatives open.
    """
    aliases = aliases_of(inputs.selected, inputs.posterior_weights, inputs.space, rules)
    if too_little:
        aliases = with_undetectable(aliases, inputs.space, inputs.detectability, rules)
    if not (inputs.closed_loop and inputs.has_repeats):
        aliases = with_each_other(aliases, inputs.space, rules)
    return aliases


def _outside(inputs: DecisionInputs, rules: Rules) -> tuple[list[Finding], UnexplainedResidual]:
    """Return the findings that put the cause outside the library, and the residual that they refer to.

    If the residual of the model without effects exceeds its bounds too, return the findings on it and that
    residual: the selected effects were fitted to a cause that they do not describe.
    """
    repeat = inputs.residual.flight_repeat
    bounds = residual_bounds(
        inputs.residual_without,
        has_effects=bool(inputs.selected) or not is_null_open(inputs.null_probability),
        has_memory=inputs.has_memory,
        position_m=0.0 if repeat is None else repeat.position_m,
        rules=rules,
    )
    findings = residual_findings(inputs.residual, bounds, rules)
    if not findings:
        return [], inputs.residual
    without = residual_findings(inputs.residual_without, no_effect_bounds(rules), rules)
    return (without, inputs.residual_without) if without else (findings, inputs.residual)


def tracking_shortfall(
    tracking_s: float, extent_m: float, pose_interval_s: float, rules: Rules = RULES
) -> Finding | None:
    """Return why flights cannot be fitted whole in closed loop; None if they can.

    tracking_s: tracking time of all flights. extent_m: greatest extent of one of them along an axis.
    pose_interval_s: longest median interval between the poses of one of them.
    """
    if tracking_s < rules.flight_fit_min_s:
        return Finding(code=Code.TRACKING_TOO_SHORT, value=tracking_s, bound=rules.flight_fit_min_s, unit="s")
    if extent_m < rules.hover_extent_m:
        return Finding(code=Code.HOVER_ONLY, value=extent_m, bound=rules.hover_extent_m, unit="m")
    if pose_interval_s > rules.flight_fit_pose_s:
        bound = rules.flight_fit_pose_s
        return Finding(code=Code.POSES_TOO_SLOW, value=pose_interval_s, bound=bound, unit="s")
    return None


def time_ran_late(late_share: Mapping[str, float], bound: float) -> list[Finding]:
    """Return a finding for each log whose share of the tracking phase in which time ran late exceeds `bound`.

    late_share: that share, by log.
    """
    return [
        Finding(code=Code.TIME_RAN_LATE, value=share, bound=bound, log=log)
        for log, share in late_share.items()
        if share > bound
    ]


def excess_disturbance(inputs: DecisionInputs, rules: Rules) -> list[Finding]:
    """Return a finding if the disturbance is too large for indoor turbulence.

    It is for flights without repeat flights, which would show whether the disturbance repeats.
    """
    sigma = inputs.disturbance_sigma
    force = float(max(sigma[: 3 if inputs.thrust_known else 2]))
    torque = float(max(sigma[3:]))
    if force > rules.excess_force_m_s2:
        bound = rules.excess_force_m_s2
        return [Finding(code=Code.EXCESS_FORCE, value=force, bound=bound, unit=CHANNEL_UNITS["force"])]
    if torque > rules.excess_torque_rad_s2 and not inputs.rate_driven:
        bound = rules.excess_torque_rad_s2
        return [Finding(code=Code.EXCESS_TORQUE, value=torque, bound=bound, unit=CHANNEL_UNITS["torque"])]
    return []


def _disagreement(inputs: DecisionInputs, rules: Rules) -> list[Finding]:
    """Return what contradicts the selected set: a better but unsupported set, or segments."""
    if inputs.by_segments:
        return better_but_unsupported(inputs.log_evidence, inputs.posterior_weights, rules)
    return segment_disagreement(inputs.segment_disagreement_nats, rules)


def better_but_unsupported(
    log_evidence: Mapping[Names, float], posterior_weights: Mapping[Names, float], rules: Rules
) -> list[Finding]:
    """Return a finding if a set explains the segments much better but cannot be selected.

    Such a set is unsupported: it has an effect at its bounds or within its tolerance. Unsupported sets have
    no entry in posterior_weights.
    """
    best_supported = max(value for names, value in log_evidence.items() if names in posterior_weights)
    unsupported = {names: value for names, value in log_evidence.items() if names not in posterior_weights}
    if not unsupported:
        return []
    names = max(unsupported, key=lambda names: (unsupported[names], names))
    gain = unsupported[names] - best_supported
    if gain < rules.tie_nats:
        return []
    return [
        Finding(
            code=Code.BETTER_BUT_INADMISSIBLE, value=gain, bound=rules.tie_nats, unit="nats", subject=names
        )
    ]


def segment_disagreement(disagreement_nats: Mapping[str, float], rules: Rules) -> list[Finding]:
    """Return a finding if segments do not confirm some of the selected effects by RULES.odds.

    One flight contains few gusts, and a fit to the whole flight may mistake them for physics. Segments have a
    free disturbance for gusts and a free initial state. disagreement_nats: by how many nats segments prefer
    the set without each effect.
    """
    absent = {name: nats for name, nats in disagreement_nats.items() if nats > -rules.tie_nats}
    if not absent:
        return []
    return [
        Finding(
            code=Code.SEGMENTS_DISAGREE,
            value=max(absent.values()),
            bound=-rules.tie_nats,
            unit="nats",
            subject=tuple(absent),
        )
    ]


def _open_alternatives(
    inputs: DecisionInputs, verdict: Verdict, aliases: Aliases, possible: Mapping[str, float], rules: Rules
) -> list[Finding]:
    """Return findings on what the data does not exclude: aliases, further effects, an unnamed effect."""
    findings = not_excluded(aliases, possible, rules)
    missing = 1.0 - inputs.null_probability
    if verdict is Verdict.UNDECIDED and not inputs.selected and missing > rules.majority:
        findings.append(Finding(code=Code.SOMETHING_MISSING, value=missing, bound=rules.majority))
    return findings


def not_excluded(aliases: Aliases, possible: Mapping[str, float], rules: Rules = RULES) -> list[Finding]:
    """Return a finding for each alias and for each further effect that the data does not exclude."""
    bound = rules.alias_probability
    return [
        *(
            Finding(code=Code.ALIAS, value=p, bound=bound, subject=(name, other))
            for name, others in aliases.items()
            for other, p in others.items()
        ),
        *(Finding(code=Code.POSSIBLE, value=p, bound=bound, subject=(name,)) for name, p in possible.items()),
    ]


def hidden(
    detectability: Mapping[str, float], selected: Sequence[str], space: ParameterSpace, rules: Rules = RULES
) -> list[Finding]:
    """Return a finding for each hidden effect.

    At typical size, these flights could not distinguish such an effect from the other parameters.
    """
    named = {space.effect(name).name for name in selected}
    bound = rules.detectable_sigma
    return [
        Finding(code=Code.HIDDEN, value=sigma, bound=bound, unit="sigma", subject=(name,))
        for name, sigma in sorted(detectability.items())
        if sigma < bound and name not in named
    ]
