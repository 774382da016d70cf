"""The result of a trace as text for people; `trimtab.host.trace.sentences` words single findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trimtab.host.base.card import card, simulated_badge, table
from trimtab.host.log import settings_lines
from trimtab.host.trace.data.audit import Audit, UnusedStretch
from trimtab.host.trace.decision.exact_aliases import ObservedAlias
from trimtab.host.trace.decision.findings import CHANNEL_UNITS, DOUBTS, OUTSIDE_LIBRARY_CODES, Code, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.next_flight.separation import NextFlight
from trimtab.host.trace.residual.description import Dependence, Description
from trimtab.host.trace.residual.network import NetworkResult
from trimtab.host.trace.result import Baseline, Named, Trace
from trimtab.host.trace.sentences import closed_form, sentence, sentences, stretch_reason

_SHOWN_STRETCHES = 5
"""Stretches of one log that the text lists."""


def exact_alias(observed: ObservedAlias) -> str:
    """Return what flights show of two exact aliases, and which measurement distinguishes them."""
    finding, alias = observed.finding, observed.alias
    observable = sentence(finding)
    if alias.ratio is not None:
        sd = finding.details["sd"]
        observable = (
            f"flights show only {alias.ratio}: {finding.value:.4f} +- {2 * sd:.4f} times the nominal ratio"
        )
    return f"{observable}; {alias.remedy}"


def reason(stretch: UnusedStretch) -> str:
    """Return why a stretch of a flight is not used."""
    return stretch_reason(stretch.code)


def stretch(unused: UnusedStretch) -> str:
    """Return start, end and reason of a stretch that is not used."""
    return f"{unused.start_s:.2f} to {unused.end_s:.2f} s: {reason(unused)}"


def remarks(audit: Audit) -> list[str]:
    """Return the findings of an audit as sentences."""
    return [sentence(finding) for finding in audit.findings]


def audit_lines(audits: Sequence[Audit]) -> list[str]:
    """Return the unused stretches of each log with reasons, and every remark once with its logs."""
    lines = []
    for audit in audits:
        shown = [stretch(each) for each in audit.stretches[:_SHOWN_STRETCHES]]
        more = len(audit.stretches) - len(shown)
        if shown:
            tail = f", and {more} more" if more else ""
            lines.append(f"{audit.log}: not used from {'; '.join(shown)}{tail}")
    logs_by_remark: dict[str, list[str]] = {}
    for audit in audits:
        for remark in remarks(audit):
            logs_by_remark.setdefault(remark, []).append(audit.log)
    for remark, logs in logs_by_remark.items():
        others = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        lines.append(f"{logs[0]}{others}: {remark}")
    return lines


def next_flight(proposal: NextFlight) -> str:
    """Return the proposed flight as one line."""
    a, b = proposal.separates
    plan = "" if proposal.total_time_s is None else f" (plan it with --time-s {proposal.total_time_s:.1f})"
    if proposal.decides:
        return (
            f"fly {proposal.route} next{plan} and trace all flights together: this separates {a} and {b} by "
            f"{proposal.expected_sigma:.1f} sigma, now {proposal.so_far_sigma:.1f} sigma"
        )
    other = f"; {proposal.measurement}" if proposal.measurement else ""
    return (
        f"no known route separates {a} from {b} well enough: the best one, {proposal.route}{plan}, separates "
        f"them by {proposal.expected_sigma:.1f} sigma, but {RULES.detectable_sigma} sigma are needed{other}"
    )


def network(outcome: NetworkResult) -> str:
    """Return the errors of the network that was trained on the unexplained residual, as one line."""
    before, after = outcome.before.position_rmse_m, outcome.after.position_rmse_m
    return (
        "unexplained: a network trained on the residual changes the error on held-out flights from "
        f"{1e3 * before:.1f} to {1e3 * after:.1f} mm; "
        f"{'it names no cause' if outcome.model is not None else 'it is not kept'}"
    )


def description(description: Description) -> list[str]:
    """Return what a disturbance outside the library depends on, as a few lines."""
    lines = dependence(description.force)
    if description.form is not None:
        form = closed_form(description.form.name, description.form.parameters)
        lines = [lines[0], f"  it {form} (held-out skill {description.form.skill:.2f})"]
    if description.torque is not None:
        lines += dependence(description.torque)
    if description.held_out == "blocks":
        lines.append(
            "all flights flew one reference: skill is computed on held-out parts of the flights, which is a "
            "weaker test"
        )
    return lines


def dependence(entry: Dependence) -> list[str]:
    """Return what the residual force or torque depends on, as a few lines."""
    if entry.group is None:
        names = ", ".join(skill.group for skill in entry.skills)
        return [f"the {entry.channel} depends on none of these, judged on held-out data: {names}"]
    best = entry.skill_of(entry.group)
    span = f"held-out skill {best.skill:.2f}, {best.low:.2f} to {best.high:.2f}"
    if entry.group == "constant":
        x, y, z = entry.mean
        return [
            f"the {entry.channel} has only a constant part ({span}): its mean is "
            f"({x:.2g}, {y:.2g}, {z:.2g}) {CHANNEL_UNITS[entry.channel]} in body axes"
        ]
    others = "".join(
        f"; {'the control law changes' if s.group in entry.responses else 'or on'} {s.group}, {s.skill:.2f}"
        for s in entry.rivals
    )
    lines = [f"the {entry.channel} depends on {best.group} ({span}{others})"]
    if entry.group in entry.responses:
        lines.append(
            f"  the control law changes {best.group} in response to any disturbance: it need not be the cause"
        )
    return lines + [
        f"  {entry.channel} {s.axis}: {s.value:+.3g} {s.unit} of {s.quantity}" for s in entry.slopes
    ]


def _possible(result: Trace) -> tuple[str, str]:
    """Return the possible effects with probabilities: those above RULES.open_probability, and the rest."""
    probable = {name: p for name, p in result.possible.items() if p > RULES.open_probability}
    rest = {name: p for name, p in result.possible.items() if name not in probable}
    return _with_probabilities(probable), _with_probabilities(rest)


def _with_probabilities(effects: Mapping[str, float]) -> str:
    return ", ".join(f"{name} ({p:.2f})" for name, p in effects.items())


def result_lines(result: Trace) -> list[str]:
    """Return the whole result as lines of text."""
    lines = [f"verdict: {result.verdict}"]
    if result.baseline is not None:
        lines += [f"  {text}" for text in baseline_lines(result.baseline)]
    for effect in result.effects:
        lines += _effect_lines(effect)
    if result.effects:
        lines.append("  (+- is two standard deviations)")
    probable, open_ = _possible(result)
    also = "also " if result.effects else ""
    lines += [f"  {also}probable, but not certain enough to name: {probable}"] if probable else []
    lines += [f"  {also}not excluded: {open_}"] if open_ else []
    lines += [f"  {text}" for text in sentences(result.findings, frozenset({Code.SOMETHING_MISSING}))]
    lines += [f"  {text}" for text in sentences(result.findings, DOUBTS)]
    if result.hidden:
        lines.append(f"  these flights would not show, at typical size: {', '.join(result.hidden)}")
    lines += [f"  {text}" for text in taken_up(result)]
    lines += [f"  {text}" for text in sentences(result.findings, OUTSIDE_LIBRARY_CODES)]
    if result.description is not None:
        lines += [f"  {line}" for line in description(result.description)]
    lines.append(_errors_line(result))
    if result.unexplained is not None:
        lines.append(network(result.unexplained))
    if result.next_flight is not None:
        lines.append(next_flight(result.next_flight))
    return lines + [f"data: {line}" for line in audit_lines(result.audits)]


def baseline_lines(baseline: Baseline) -> list[str]:
    """Return lines on the flights with which a comparison was made, and on settings that differ."""
    logs = len(baseline.logs)
    return [
        f"the baseline is {logs} {'flight' if logs == 1 else 'flights'}; the thrust of each log may differ "
        f"by about {100 * baseline.thrust_sigma:.2g} % (battery, temperature, propellers)",
        *settings_lines(baseline.settings, ("before", "after")),
    ]


def _effect_lines(effect: Named) -> list[str]:
    values = ", ".join(
        f"{key} {v.value:.4g} +- {2 * v.sd:.2g}{'' if v.unit == '1' else ' ' + v.unit}"
        for key, v in effect.parameters.items()
    )
    others = "".join(f"; or {name} ({p:.2f})" for name, p in effect.inexact_aliases.items())
    lines = [f"  {effect.name}: {values} (probability {effect.probability:.3f}{others})"]
    return lines + [f"    {exact_alias(each)}" for each in effect.exact_aliases.values()]


def _errors_line(result: Trace) -> str:
    if any(finding.code is Code.ONLY_HOVER for finding in result.findings):
        return "no prediction error: a comparison of hovers predicts no flight"
    if result.before_score is None or result.after_score is None:
        return "no flight held out, so no prediction error; add --hold-out LOG"
    span = "whole flights" if result.horizon_s is None else f"{result.horizon_s} s ahead"
    return (
        f"prediction error on {len(result.before)} held-out flights ({span}): "
        f"{1e3 * result.before_score['position_rmse_m']:.1f} mm before, "
        f"{1e3 * result.after_score['position_rmse_m']:.1f} mm after"
        f"{' (no effect was added)' if result.verdict is Verdict.OUTSIDE_LIBRARY else ''}"
    )


def taken_up(result: Trace) -> list[str]:
    """Return a line on the adjustments that take much of their tolerance; none if there are none."""
    far = sentences(result.findings, frozenset({Code.ADJUSTED_FAR}))
    if not far:
        return []
    return [
        f"moved by more than {RULES.far_tolerances:g} tolerances, but not named: {', '.join(far)}; if you "
        "know one better, give it a smaller tolerance in the vehicle file"
    ]


_VERDICTS = {
    (Verdict.TRACED, True): "The model is missing {}.",
    (Verdict.UNDECIDED, True): "The model may be missing {}; another explanation cannot be excluded.",
    (Verdict.UNDECIDED, False): "The model may be missing something; these flights do not show what.",
    (Verdict.NOTHING_MISSING, False): "Nothing stands out beyond the tolerances of the vehicle.",
    (Verdict.OUTSIDE_LIBRARY, True): "The cause is an effect that the library does not hold: {}.",
}
"""What a verdict says, by whether there are names or reasons to fill in."""

_VERDICTS_ON_CHANGE = {
    (Verdict.TRACED, True): "Since the baseline flights this changed: {}.",
    (Verdict.UNDECIDED, True): "Since the baseline flights this may have changed: {}; another explanation "
    "cannot be excluded.",
    (Verdict.UNDECIDED, False): "Something may have changed since the baseline flights; these flights do not "
    "show what.",
    (Verdict.NOTHING_MISSING, False): "Nothing changed since the baseline flights beyond the tolerances of "
    "the vehicle.",
    (Verdict.OUTSIDE_LIBRARY, True): "What changed is an effect that the library does not hold: {}.",
}
"""The same if two sets of flights were compared."""


def verdict(result: Trace) -> str:
    """Return the verdict in one or two sentences."""
    names = _listed([e.title.lower() for e in result.effects])
    texts = _VERDICTS if result.baseline is None else _VERDICTS_ON_CHANGE
    if result.verdict is Verdict.OUTSIDE_LIBRARY:
        names = "; ".join(sentences(result.findings, OUTSIDE_LIBRARY_CODES))
    text = texts[result.verdict, bool(names)].format(names)
    if result.baseline is not None:
        text += "".join(f" {line[0].upper()}{line[1:]}." for line in baseline_lines(result.baseline))
    if result.before_score and result.after_score and result.effects:
        b, a = result.before_score["position_rmse_m"], result.after_score["position_rmse_m"]
        n = len(result.before)
        flights = "flight" if n == 1 else "flights"
        text += (
            f" On {n} held-out {flights} the prediction error went from {1e3 * b:.0f} to {1e3 * a:.0f} mm."
        )
    return text


def _listed(names: Sequence[str]) -> str:
    """Return names joined as in a sentence ("a, b and c"); an empty text for no names."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def trace_card(result: Trace) -> str:
    """Return the HTML card of a trace for notebooks."""
    before, after = result.before_score, result.after_score
    held_out = None
    if before is not None and after is not None:
        before_mm, after_mm = 1e3 * before["position_rmse_m"], 1e3 * after["position_rmse_m"]
        held_out = f"{before_mm:.1f} mm before, {after_mm:.1f} mm after, {len(result.before)} flights"
    planned = result.next_flight
    probable, open_ = _possible(result)
    return card(
        f"Trace: {result.verdict}",
        [
            ("vehicle", result.model.vehicle_name),
            ("flights", len(result.audits)),
            ("prediction error of held-out flights", held_out),
            ("probable", probable or None),
            ("not excluded", open_ or None),
            ("propose to fly next", None if planned is None else planned.route),
            *(("reason", each) for each in sentences(result.findings, OUTSIDE_LIBRARY_CODES | DOUBTS)),
        ],
        table(
            ("effect", "parameter", "value", "sd", "unit", "probability"),
            [
                (effect.name, key, value.value, value.sd, value.unit, effect.probability)
                for effect in result.effects
                for key, value in effect.parameters.items()
            ],
        ),
        badge=simulated_badge(result.simulated_flights, len(result.audits)),
    )
