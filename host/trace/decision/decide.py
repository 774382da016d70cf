"""The decision: from evidence and rules to a verdict and findings. Pure; nothing is fitted here."""

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
    """Everything a verdict is decided by, as numbers.

    Parameters
    ----------
    space
        Candidates and what is known of them.
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
        Whether the set was found by segments, not by whole flights over the closed loop.
    residual, residual_without
        What the selected set leaves, and what a model without any effect leaves.
    disturbance_sigma
        Standard deviations (6,) of the disturbance that the selected set leaves: force m/s^2, then angular
        acceleration rad/s^2, FRD.
    thrust_known
        Whether the logs tell the thrust; otherwise the force along it says nothing.
    rate_driven
        Whether the measured body rate drives the attitude; the torque then says nothing.
    segment_disagreement_nats
        By how much segments prefer the selected set without each effect; empty where they were not asked.
    tracking_s, extent_m
        Tracking time of all flights, and the greatest extent of one.
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
        """Whether a reference was flown twice."""
        return self.residual.pairs > 0

    @property
    def has_memory(self) -> bool:
        """Whether a selected effect has states of its own."""
        return any(self.space.effect(name).memory for name in self.selected)


@dataclass(frozen=True, kw_only=True)
class Decision:
    """A verdict with its findings.

    aliases: alternatives to each selected effect. possible: effects beside them that the data does not
    exclude. to_separate: the pair that the next flight should separate, where the verdict is undecided.
    residual: what the findings about the residual are about: of the selected set or, outside the library, of
    the model without any effect where that one shows something.
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
    """Return the verdict on `evidence` and everything that was found."""
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
    """Return the verdict: outside before doubts, doubts before how sure the selected set is."""
    if outside:
        return Verdict.OUTSIDE_LIBRARY
    if disagreements:
        return Verdict.UNDECIDED
    if not evidence.selected:
        certain = is_null_probable(evidence.null_probability, rules)
        return Verdict.NOTHING_MISSING if certain else Verdict.UNDECIDED
    return Verdict.UNDECIDED if any(aliases.values()) else Verdict.TRACED


def is_null_probable(null_probability: float, rules: Rules = RULES) -> bool:
    """Return whether it is probable enough that no effect is missing to say so."""
    return null_probability > rules.alias_probability


def _aliases(evidence: Evidence, too_little: bool, rules: Rules) -> dict[str, dict[str, float]]:
    """Return the alternatives to each selected effect; thin data leave more of them open."""
    aliases = aliases_of(evidence.selected, evidence.posterior_weights, evidence.space, rules)
    if too_little:
        aliases = with_undetectable(aliases, evidence.space, evidence.detectability, rules)
    if evidence.by_segments or not evidence.has_repeats:
        aliases = with_each_other(aliases, evidence.space, rules)
    return aliases


def _outside(evidence: Evidence, rules: Rules) -> tuple[list[Finding], UnexplainedResidual]:
    """Return what puts the cause outside the library, and the residual that it is about.

    How much is missing counts from the model without any effect: what the library fitted in vain may be wild.
    """
    bounds = residual_bounds(evidence.residual_without, has_memory=evidence.has_memory, rules=rules)
    findings = residual_findings(evidence.residual, bounds, rules)
    if not findings:
        return [], evidence.residual
    without = residual_findings(evidence.residual_without, no_model_bounds(rules), rules)
    return (without, evidence.residual_without) if without else (findings, evidence.residual)


def tracking_shortfall(tracking_s: float, extent_m: float, rules: Rules = RULES) -> Finding | None:
    """Return what flights lack to be fitted whole over the closed loop; None where they are enough.

    tracking_s: tracking time of all flights. extent_m: greatest extent of one of them, largest axis.
    """
    if tracking_s < rules.flight_fit_min_s:
        return Finding(code=Code.TRACKING_TOO_SHORT, value=tracking_s, bound=rules.flight_fit_min_s, unit="s")
    if extent_m < rules.hover_extent_m:
        return Finding(code=Code.HOVER_ONLY, value=extent_m, bound=rules.hover_extent_m, unit="m")
    return None


def excess_disturbance(evidence: Evidence, rules: Rules) -> list[Finding]:
    """Return the disturbance that is too much for turbulence, where no twin says whether it repeats."""
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
    """Return what speaks against the selected set: inadmissible sets, or segments."""
    if evidence.by_segments:
        return better_but_inadmissible(evidence.log_evidence, evidence.posterior_weights, rules)
    return segment_disagreement(evidence.segment_disagreement_nats, rules)


def better_but_inadmissible(
    log_evidence: Mapping[Names, float], posterior_weights: Mapping[Names, float], rules: Rules
) -> list[Finding]:
    """Return the set that explains segments far better, but with an effect at its bounds or negligible.

    Only sets that could be selected have posterior weights.
    """
    admissible = max(value for names, value in log_evidence.items() if names in posterior_weights)
    rest = {names: value for names, value in log_evidence.items() if names not in posterior_weights}
    if not rest:
        return []
    names = max(rest, key=lambda names: (rest[names], names))
    gain = rest[names] - admissible
    if gain < rules.tie_nats:
        return []
    return [
        Finding(
            code=Code.BETTER_BUT_INADMISSIBLE, value=gain, bound=rules.tie_nats, unit="nats", subject=names
        )
    ]


def segment_disagreement(disagreement_nats: Mapping[str, float], rules: Rules) -> list[Finding]:
    """Return the selected effects that segments find far more probably absent.

    One flight's gusts are few, and its whitening may take them for physics; segments have a disturbance of
    their own for them, and a free state at each start.
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
    """Return what the data does not exclude: aliases, effects beside the selected ones, something at all."""
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
