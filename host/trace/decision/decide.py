"""The decision: a pure function of evidence and rules that returns a verdict and findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
from trimtab.host.trace.decision.residual_rules import no_model_bounds, residual_bounds, residual_findings
from trimtab.host.trace.decision.rules import RULES, Rules
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.residual.unexplained import UnexplainedResidual


@dataclass(frozen=True, kw_only=True)
class Evidence:
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
        Relative posterior weight of every admissible set.
    inclusion_probability
        Posterior probability of each candidate.
    detectability
        Sigma by which each effect of typical size would show in these flights.
    by_segments
        Whether the set was selected from segments, not from whole flights in closed loop.
    residual, residual_without
        Unexplained residual of the selected set, and of the model without effects.
    disturbance_sigma
        Standard deviations (6,) of the unexplained disturbance of the selected set: force m/s^2, then angular
        acceleration rad/s^2, FRD.
    thrust_known
        Whether the logs determine the thrust. Otherwise the force along the thrust is ignored.
    rate_driven
        Whether the measured body rate drives the attitude. The torque is then ignored.
    segment_disagreement_nats
        By how many nats segments prefer the selected set without each of its effects; empty if not computed.
    tracking_s, extent_m
        Tracking time of all flights, and the greatest extent of one of them along an axis.
    """

    space: ParameterSpace
    selected: Names
    null_probability: float
    log_evidence: Mapping[Names, float]
    posterior_weights: Mapping[Names, float]
    inclusion_probability: Mapping[str, float]
    detectability: Mapping[str, float]
    by_segments: bool
    residual: UnexplainedResidual
    residual_without: UnexplainedResidual
    disturbance_sigma: Sequence[float]
    thrust_known: bool
    rate_driven: bool
    segment_disagreement_nats: Mapping[str, float]
    tracking_s: float
    extent_m: float

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
    aliases
        Probability of each alternative, by the selected effect that it would replace.
    possible
        Probability of further effects that the data does not exclude.
    to_separate
        Pair of effects that the next flight should separate; None unless the verdict is undecided.
    residual
        Unexplained residual that the findings refer to: that of the selected set or, if the cause is outside
        the library and the model without effects has findings, that of the model without effects.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    aliases: Aliases
    possible: Mapping[str, float]
    to_separate: tuple[str, str] | None
    residual: UnexplainedResidual

    @property
    def effects_added(self) -> bool:
        """Whether the selected effects go into the model."""
        return self.verdict is not Verdict.OUTSIDE_LIBRARY


def decide(evidence: Evidence, rules: Rules = RULES) -> Decision:
    """Return the verdict on `evidence`, with its findings and alternatives."""
    outside, residual = _outside(evidence, rules)
    shortfall = tracking_shortfall(evidence.tracking_s, evidence.extent_m, rules)
    aliases = _aliases(evidence, shortfall is not None, rules)
    disagreements = [
        *([] if evidence.has_repeats else excess_disturbance(evidence, rules)),
        *_disagreement(evidence, rules),
    ]
    verdict = _verdict(evidence, outside, aliases, disagreements, rules)
    added = verdict is not Verdict.OUTSIDE_LIBRARY
    possible = (
        possible_beside(evidence.selected, aliases, evidence.inclusion_probability, rules) if added else {}
    )
    findings = [
        *outside,
        *([] if shortfall is None else [shortfall]),
        *disagreements,
        *_open_alternatives(evidence, verdict, aliases if added else {}, possible, rules),
        *hidden(evidence.detectability, evidence.selected if added else (), evidence.space, rules),
    ]
    undecided = verdict is Verdict.UNDECIDED
    return Decision(
        verdict=verdict,
        findings=tuple(findings),
        aliases=aliases,
        possible=possible,
        to_separate=(pair_to_separate(aliases, evidence.inclusion_probability, rules) if undecided else None),
        residual=residual,
    )


def _verdict(
    evidence: Evidence,
    outside: Sequence[Finding],
    aliases: Aliases,
    disagreements: Sequence[Finding],
    rules: Rules,
) -> Verdict:
    """Return the verdict: first findings outside the library count, then disagreements, then aliases."""
    if outside:
        return Verdict.OUTSIDE_LIBRARY
    if disagreements:
        return Verdict.UNDECIDED
    if not evidence.selected:
        certain = is_null_probable(evidence.null_probability, rules)
        return Verdict.NOTHING_MISSING if certain else Verdict.UNDECIDED
    return Verdict.UNDECIDED if any(aliases.values()) else Verdict.TRACED


def is_null_probable(null_probability: float, rules: Rules = RULES) -> bool:
    """Return whether "no effect is missing" is probable enough for that verdict."""
    return null_probability > rules.alias_probability


def _aliases(evidence: Evidence, too_little: bool, rules: Rules) -> dict[str, dict[str, float]]:
    """Return the alternatives to each selected effect.

    too_little: whether there is too little data to fit whole flights, which leaves more alternatives open.
    """
    aliases = aliases_of(evidence.selected, evidence.posterior_weights, evidence.space, rules)
    if too_little:
        aliases = with_undetectable(aliases, evidence.space, evidence.detectability, rules)
    if evidence.by_segments or not evidence.has_repeats:
        aliases = with_each_other(aliases, evidence.space, rules)
    return aliases


def _outside(evidence: Evidence, rules: Rules) -> tuple[list[Finding], UnexplainedResidual]:
    """Return the findings that put the cause outside the library, and the residual that they refer to.

    The size of the unexplained residual is that of the model without effects, since the selected effects were
    fitted to a cause that they do not describe.
    """
    bounds = residual_bounds(evidence.residual_without, has_memory=evidence.has_memory, rules=rules)
    findings = residual_findings(evidence.residual, bounds, rules)
    if not findings:
        return [], evidence.residual
    without = residual_findings(evidence.residual_without, no_model_bounds(rules), rules)
    return (without, evidence.residual_without) if without else (findings, evidence.residual)


def tracking_shortfall(tracking_s: float, extent_m: float, rules: Rules = RULES) -> Finding | None:
    """Return why flights cannot be fitted whole in closed loop; None if they can.

    tracking_s: tracking time of all flights. extent_m: greatest extent of one of them along an axis.
    """
    if tracking_s < rules.flight_fit_min_s:
        return Finding(code=Code.TRACKING_TOO_SHORT, value=tracking_s, bound=rules.flight_fit_min_s, unit="s")
    if extent_m < rules.hover_extent_m:
        return Finding(code=Code.HOVER_ONLY, value=extent_m, bound=rules.hover_extent_m, unit="m")
    return None


def excess_disturbance(evidence: Evidence, rules: Rules) -> list[Finding]:
    """Return a finding if the disturbance is too large for indoor turbulence.

    It is for flights without repeat flights, which would show whether the disturbance repeats.
    """
    sigma = evidence.disturbance_sigma
    force = float(max(sigma[: 3 if evidence.thrust_known else 2]))
    torque = float(max(sigma[3:]))
    if force > rules.excess_force_m_s2:
        bound = rules.excess_force_m_s2
        return [Finding(code=Code.EXCESS_FORCE, value=force, bound=bound, unit=CHANNEL_UNITS["force"])]
    if torque > rules.excess_torque_rad_s2 and not evidence.rate_driven:
        bound = rules.excess_torque_rad_s2
        return [Finding(code=Code.EXCESS_TORQUE, value=torque, bound=bound, unit=CHANNEL_UNITS["torque"])]
    return []


def _disagreement(evidence: Evidence, rules: Rules) -> list[Finding]:
    """Return what contradicts the selected set: a better but inadmissible set, or segments."""
    if evidence.by_segments:
        return better_but_inadmissible(evidence.log_evidence, evidence.posterior_weights, rules)
    return segment_disagreement(evidence.segment_disagreement_nats, rules)


def better_but_inadmissible(
    log_evidence: Mapping[Names, float], posterior_weights: Mapping[Names, float], rules: Rules
) -> list[Finding]:
    """Return a finding if a set explains the segments much better but cannot be selected.

    Such a set has an effect at its bounds or within its tolerance. Sets that cannot be selected have no entry
    in posterior_weights.
    """
    admissible = max(value for names, value in log_evidence.items() if names in posterior_weights)
    inadmissible = {names: value for names, value in log_evidence.items() if names not in posterior_weights}
    if not inadmissible:
        return []
    names = max(inadmissible, key=lambda names: (inadmissible[names], names))
    gain = inadmissible[names] - admissible
    if gain < rules.tie_nats:
        return []
    return [
        Finding(
            code=Code.BETTER_BUT_INADMISSIBLE, value=gain, bound=rules.tie_nats, unit="nats", subject=names
        )
    ]


def segment_disagreement(disagreement_nats: Mapping[str, float], rules: Rules) -> list[Finding]:
    """Return a finding if segments prefer the selected set without some of its effects.

    One flight contains few gusts, and a fit to the whole flight may mistake them for physics. Segments have a
    free disturbance for gusts and a free initial state. disagreement_nats: by how many nats segments prefer
    the set without each effect.
    """
    absent = {name: nats for name, nats in disagreement_nats.items() if nats > rules.tie_nats}
    if not absent:
        return []
    return [
        Finding(
            code=Code.SEGMENTS_DISAGREE,
            value=max(absent.values()),
            bound=rules.tie_nats,
            unit="nats",
            subject=tuple(absent),
        )
    ]


def _open_alternatives(
    evidence: Evidence, verdict: Verdict, aliases: Aliases, possible: Mapping[str, float], rules: Rules
) -> list[Finding]:
    """Return findings on what the data does not exclude: aliases, further effects, an unnamed effect."""
    bound = rules.alias_probability
    findings = [
        Finding(code=Code.ALIAS, value=p, bound=bound, subject=(name, other))
        for name, others in aliases.items()
        for other, p in others.items()
    ]
    findings += [
        Finding(code=Code.POSSIBLE, value=p, bound=bound, subject=(name,)) for name, p in possible.items()
    ]
    missing = 1.0 - evidence.null_probability
    if verdict is Verdict.UNDECIDED and not evidence.selected and missing > rules.majority:
        findings.append(Finding(code=Code.SOMETHING_MISSING, value=missing, bound=rules.majority))
    return findings


def hidden(
    detectability: Mapping[str, float], selected: Sequence[str], space: ParameterSpace, rules: Rules = RULES
) -> list[Finding]:
    """Return the effects that these flights would not show at typical size, or only within an alias."""
    named = {space.effect(name).name for name in selected}
    bound = rules.detectable_sigma
    return [
        Finding(code=Code.HIDDEN, value=sigma, bound=bound, unit="sigma", subject=(name,))
        for name, sigma in sorted(detectability.items())
        if sigma < bound and name not in named
    ]
