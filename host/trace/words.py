"""A whole result in words for people; `trimtab.host.trace.sentences` words what it is made of."""

from __future__ import annotations

from collections.abc import Sequence

from trimtab.host.trace.data.audit import Audit, Stretch
from trimtab.host.trace.decision.exact_aliases import ObservedAlias
from trimtab.host.trace.decision.findings import CHANNEL_UNITS, DOUBTS, UNEXPLAINED, Code, Verdict
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.next_flight.separation import NextFlight
from trimtab.host.trace.residual.description import Dependence, Description
from trimtab.host.trace.residual.network import Unexplained
from trimtab.host.trace.result import Named, Trace
from trimtab.host.trace.sentences import closed_form, sentence, sentences, stretch_reason

_SHOWN_STRETCHES = 5


def exact_alias(observed: ObservedAlias) -> str:
    """Return what flights show of two effects that fit exactly alike, and what tells them apart."""
    finding, alias = observed.finding, observed.alias
    shows = sentence(finding)
    if alias.ratio is not None:
        sd = finding.details["sd"]
        shows = f"only {alias.ratio} shows: {finding.value:.4f} +- {2 * sd:.4f} times the nominal ratio"
    return f"{shows}; {alias.remedy}"


def reason(stretch: Stretch) -> str:
    """Return why a stretch of a flight is not used."""
    return stretch_reason(stretch.code)


def stretch(one: Stretch) -> str:
    """Return a stretch that is not used: from, to and why."""
    return f"{one.start_s:.2f} to {one.end_s:.2f} s: {reason(one)}"


def remarks(audit: Audit) -> list[str]:
    """Return the findings of an audit as sentences."""
    return [sentence(finding) for finding in audit.findings]


def audit_lines(audits: Sequence[Audit]) -> list[str]:
    """Return what is not used of each log and why, and every remark once with the logs that it is about."""
    lines = []
    for one in audits:
        shown = [stretch(each) for each in one.stretches[:_SHOWN_STRETCHES]]
        more = len(one.stretches) - len(shown)
        if shown:
            tail = f", and {more} more" if more else ""
            lines.append(f"{one.log}: not used from {'; '.join(shown)}{tail}")
    logs_by_remark: dict[str, list[str]] = {}
    for one in audits:
        for remark in remarks(one):
            logs_by_remark.setdefault(remark, []).append(one.log)
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
            f"fly {proposal.route} next{plan} and trace with it added: {a} and {b} are then "
            f"{proposal.expected_sigma:.1f} sigma apart, {proposal.so_far_sigma:.1f} so far"
        )
    other = f"; {proposal.measurement}" if proposal.measurement else ""
    return (
        f"no known route tells {a} from {b}: with the best, {proposal.route}{plan}, they are "
        f"{proposal.expected_sigma:.1f} sigma apart, {RULES.detectable_sigma} are needed{other}"
    )


def network(outcome: Unexplained) -> str:
    """Return what the network on the unexplained residual predicts, as one line."""
    before, after = outcome.before.position_rmse_m, outcome.after.position_rmse_m
    return (
        f"unexplained: a network trained on what is left predicts the held-out flights {1e3 * before:.1f} mm "
        f"off without it, {1e3 * after:.1f} mm with it; "
        f"{'it names no cause' if outcome.model is not None else 'it is not kept'}"
    )


def description(told: Description) -> list[str]:
    """Return what a disturbance outside the library depends on, a few lines."""
    lines = dependence(told.force)
    if told.form is not None:
        form = closed_form(told.form.name, told.form.parameters)
        lines = [lines[0], f"  it {form} (held-out skill {told.form.skill:.2f})"]
    if told.torque is not None:
        lines += dependence(told.torque)
    if told.held_out == "blocks":
        lines.append("all flights flew one reference: skill is on parts of them left out, a weaker test")
    return lines


def dependence(one: Dependence) -> list[str]:
    """Return what one channel depends on."""
    if one.group is None:
        names = ", ".join(skill.group for skill in one.skills)
        return [f"the {one.channel} depends on none of {names}: none explains it on held-out data"]
    best = one.skill_of(one.group)
    span = f"held-out skill {best.skill:.2f}, {best.low:.2f} to {best.high:.2f}"
    if one.group == "constant":
        x, y, z = one.mean
        return [
            f"of the {one.channel} only a constant part shows ({span}): in the mean "
            f"({x:.2g}, {y:.2g}, {z:.2g}) {CHANNEL_UNITS[one.channel]} in body axes"
        ]
    others = "".join(
        f"; {'the law answers with' if s.group in one.answers else 'or'} {s.group}, {s.skill:.2f}"
        for s in one.rivals
    )
    lines = [f"the {one.channel} depends on {best.group} ({span}{others})"]
    if one.group in one.answers:
        lines.append(f"  the law answers any disturbance with {best.group}: it need not be the cause")
    return lines + [f"  {one.channel} {s.axis}: {s.value:+.3g} {s.unit} of {s.quantity}" for s in one.slopes]


def result_lines(result: Trace) -> list[str]:
    """Return the whole result for people, a few lines."""
    lines = [f"verdict: {result.verdict}"]
    for effect in result.effects:
        lines += _effect_lines(effect)
    if result.effects:
        lines.append("  (+- is two standard deviations)")
    if result.possible:
        names = ", ".join(f"{name} ({p:.2f})" for name, p in result.possible.items())
        lines.append(f"  not excluded beside them: {names}" if result.effects else f"  not excluded: {names}")
    lines += [f"  {text}" for text in sentences(result.findings, frozenset({Code.SOMETHING_MISSING}))]
    lines += [f"  {text}" for text in sentences(result.findings, DOUBTS)]
    if result.hidden:
        lines.append(f"  of typical size, these flights would not show: {', '.join(result.hidden)}")
    lines += [f"  {text}" for text in sentences(result.findings, UNEXPLAINED)]
    if result.description is not None:
        lines += [f"  {line}" for line in description(result.description)]
    lines.append(_errors_line(result))
    if result.unexplained is not None:
        lines.append(network(result.unexplained))
    if result.next_flight is not None:
        lines.append(next_flight(result.next_flight))
    return lines + [f"data: {line}" for line in audit_lines(result.audits)]


def _effect_lines(effect: Named) -> list[str]:
    values = ", ".join(
        f"{key} {v.value:.4g} +- {2 * v.sd:.2g}{'' if v.unit == '1' else ' ' + v.unit}"
        for key, v in effect.parameters.items()
    )
    others = "".join(f"; or {name} ({p:.2f})" for name, p in effect.inexact_aliases.items())
    lines = [f"  {effect.name}: {values} (probability {effect.probability:.3f}{others})"]
    return lines + [f"    {exact_alias(each)}" for each in effect.exact_aliases.values()]


def _errors_line(result: Trace) -> str:
    if result.before_score is None or result.after_score is None:
        return "no flight held out: no error before and after; add --hold-out LOG"
    how = "whole flights" if result.horizon_s is None else f"{result.horizon_s} s ahead"
    return (
        f"prediction error on {len(result.before)} held-out flights ({how}): "
        f"{1e3 * result.before_score['position_rmse_m']:.1f} mm before, "
        f"{1e3 * result.after_score['position_rmse_m']:.1f} mm after"
        f"{' (nothing was added)' if result.verdict is Verdict.OUTSIDE_LIBRARY else ''}"
    )


def verdict(result: Trace) -> str:
    """Return the verdict in one or two sentences."""
    names = _listed([e.title.lower() for e in result.effects])
    if result.verdict is Verdict.TRACED:
        text = f"The model is missing {names}."
    elif result.verdict is Verdict.UNDECIDED and names:
        text = f"The model may be missing {names}; another explanation cannot be excluded."
    elif result.verdict is Verdict.UNDECIDED:
        text = "The model may be missing something; these flights do not say what."
    elif result.verdict is Verdict.NOTHING_MISSING:
        text = "Nothing beyond the vehicle's tolerances stands out."
    else:
        reasons = sentences(result.findings, UNEXPLAINED)
        text = "Something acts that the library does not hold: " + "; ".join(reasons) + "."
    if result.before_score and result.after_score and result.effects:
        b, a = result.before_score["position_rmse_m"], result.after_score["position_rmse_m"]
        n = len(result.before)
        flights = "flight" if n == 1 else "flights"
        text += (
            f" On {n} held-out {flights} the prediction error went from {1e3 * b:.0f} to {1e3 * a:.0f} mm."
        )
    return text


def _listed(names: Sequence[str]) -> str:
    """Return names as in a sentence: a, b and c; an empty text for none."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
