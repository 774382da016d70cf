"""Sentences for people, made from codes and numbers. Nothing reads them back.

`sentence` words one finding; the other functions word a whole result. Modules that raise errors about logs
take their texts from here too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trimtab.host.trace.decision.findings import DOUBTS, UNEXPLAINED, Code, Finding, Verdict
from trimtab.host.trace.decision.rules import RULES

if TYPE_CHECKING:
    from trimtab.host.trace.data.audit import Audit, Stretch
    from trimtab.host.trace.decision.exact_aliases import ObservedAlias
    from trimtab.host.trace.next_flight.separation import NextFlight
    from trimtab.host.trace.residual.closed_forms import ClosedForm
    from trimtab.host.trace.residual.description import Dependence, Description
    from trimtab.host.trace.residual.network import Unexplained
    from trimtab.host.trace.result import Named, Trace

UNITS = {"force": "m/s^2", "torque": "rad/s^2"}
MIXED_INPUTS = "the logs record inputs of different kinds; trace those with motor commands apart"

_SHOWN_STRETCHES = 5

_STRETCHES = {
    Code.CLOCK_JUMP: "a clock that jumps",
    Code.MOTOR_AT_LIMIT: "a motor at its limit",
    Code.PITCH_SINGULAR: "a pitch near 90 deg, where Euler angles are singular",
    Code.IMPACT: "an impact",
    Code.GAP_IN_COMMANDS: "gaps in the commands",
    Code.GAP_IN_POSES: "gaps in the poses",
    Code.GROUND_CONTACT: "ground contact",
    Code.TILTED: f"more than {math.degrees(RULES.tilt_max_rad):.0f} deg of tilt",
}


def sentence(finding: Finding) -> str:
    """Return one finding as a sentence without a full stop."""
    return _SENTENCES[finding.code](finding)


def sentences(findings: Sequence[Finding], codes: frozenset[Code]) -> list[str]:
    """Return the sentences of the findings that have one of `codes`, in order."""
    return [sentence(finding) for finding in findings if finding.code in codes]


def _channel_repeats(f: Finding) -> str:
    z = f.details["z"]
    if f.code is Code.FORCE_REPEATS:
        return f"a force of {f.value:.2f} m/s^2 repeats between twin flights (z {z:.1f})"
    return f"an angular acceleration of {f.value:.2f} rad/s^2 repeats between twin flights (z {z:.1f})"


def _rings(f: Finding) -> str:
    name = "force" if f.code is Code.FORCE_RINGS else "torque"
    return f"the residual {name} rings at {f.details['hz']:.2f} Hz, {f.value:.1f} times its surroundings"


def _excess(f: Finding) -> str:
    if f.code is Code.EXCESS_FORCE:
        what = f"a force of {f.value:.1f} m/s^2"
    else:
        what = f"an angular acceleration of {f.value:.0f} rad/s^2"
    return f"{what} is left, too much for turbulence indoors; fly references twice to see whether it repeats"


def _topic_at(f: Finding, rate_hz: float | None) -> str:
    return f"{f.subject[0]} at {rate_hz:.0f} Hz"


_SENTENCES: Mapping[Code, Callable[[Finding], str]] = {
    Code.FLIGHTS_REPEAT: lambda f: (
        f"{1e3 * f.details['position_m']:.1f} mm of whole flights' error repeat between twin flights, "
        f"{f.details['amplitude']:.1f} times turbulence and noise (z {f.details['z']:.1f})"
    ),
    Code.FLIGHTS_WORSENED: lambda f: (
        f"{1e3 * (f.value or 0.0):.1f} mm of whole flights' error repeat with the effects that fit best, "
        f"less than {1e3 * (f.bound or 0.0):.1f} mm without any"
    ),
    Code.FORCE_REPEATS: _channel_repeats,
    Code.TORQUE_REPEATS: _channel_repeats,
    Code.FORCE_RINGS: _rings,
    Code.TORQUE_RINGS: _rings,
    Code.TRACKING_TOO_SHORT: lambda f: (
        f"only {f.value:.1f} s of tracking in all: fly longer; whole flights are not searched"
    ),
    Code.HOVER_ONLY: lambda f: "a hover throughout: fly manoeuvres; whole flights are not searched",
    Code.EXCESS_FORCE: _excess,
    Code.EXCESS_TORQUE: _excess,
    Code.BETTER_BUT_INADMISSIBLE: lambda f: (
        f"{', '.join(f.subject)} would explain more, but not in sizes that they could have"
    ),
    Code.SEGMENTS_DISAGREE: lambda f: f"{', '.join(f.subject)}: whole flights say yes, segments no; fly more",
    Code.ALIAS: lambda f: f"{f.subject[0]} may be {f.subject[1]} ({f.value:.2f})",
    Code.EXACT_ALIAS: lambda f: f"no flight tells {f.subject[0]} from {f.subject[1]}",
    Code.POSSIBLE: lambda f: f"{f.subject[0]} is not excluded ({f.value:.2f})",
    Code.SOMETHING_MISSING: lambda f: (
        f"something is missing with probability {f.value:.2f}, and these flights do not say what"
    ),
    Code.HIDDEN: lambda f: f"of typical size, these flights would not show {f.subject[0]}",
    Code.NO_TWIN: lambda f: (
        "no twin: fly its reference once more; without, physics outside the library passes for turbulence"
    ),
    Code.NO_INPUTS: lambda f: "no inputs recorded: only forces across the thrust show",
    Code.NO_REFERENCE: lambda f: (
        "no reference with the law that flew it: read in segments, which know timing less well"
    ),
    Code.NO_GYRO: lambda f: "no gyro: delay and latency are hard to tell apart",
    Code.SAMPLED_COMMANDS: lambda f: (
        "sampled commands make false lag and inertia: what the motors did between two is unknown"
    ),
    Code.SLOW_COMMANDS: lambda f: (
        f"{_topic_at(f, f.value)}: too slow to show the motors' lag of "
        f"{1e3 * f.details['motor_lag_s']:.0f} ms"
    ),
    Code.RATE_DROPS: lambda f: (
        f"{_topic_at(f, f.details['median_hz'])} falls to {f.value:.0f} Hz in its leanest second"
    ),
    Code.REPEATED_STAMPS: lambda f: (
        f"{f.subject[0]}: {f.value:.0f} time stamps are repeated; one sample of each pair is misplaced"
    ),
    Code.CLOCK_DRIFT: lambda f: (
        f"camera and vehicle clocks drift apart by {1e3 * (f.value or 0.0):.1f} ms while tracking: it reads "
        "as a latency that changes"
    ),
    Code.ROTORS_SATURATED: lambda f: (
        f"rotors clipped on {100 * (f.value or 0.0):.0f} % of the ticks: the reference asks for more than "
        "they have"
    ),
    Code.SEGMENTS_LEFT_OUT: lambda f: f"{f.value:.0f} segments with {_STRETCHES[Code(f.subject[0])]}",
    Code.SEGMENTS_WITH_GAPS: lambda f: f"{f.value:.0f} segments with gaps in poses or commands",
}


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
    return _STRETCHES[stretch.code]


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


def too_few_poses(path: Path) -> str:
    """Return the refusal of a log with too few poses."""
    return f"{path}: fewer than {RULES.min_poses} poses; log /mocap/pose in flight"


def too_few_tracking_poses(path: Path) -> str:
    """Return the refusal of a log with too few poses in its tracking phase."""
    return f"{path}: fewer than {RULES.min_tracking_poses} poses in the tracking phase; fly or log longer"


def no_tracking(path: Path) -> str:
    """Return the refusal of a log without a tracking phase."""
    return f"{path}: no tracking phase; the flight ended before its reference began"


def too_few_segments(audits: Sequence[Audit], count: int, segment_s: float) -> str:
    """Return the refusal of logs with too few usable segments."""
    why = "; ".join(f"{audit.log}: {', '.join(remarks(audit))}" for audit in audits if audit.left_out)
    logs = ", ".join(audit.log for audit in audits)
    return (
        f"{logs}: only {count} usable segments of {segment_s} s; fly longer or log more{why and f' ({why})'}"
    )


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


def closed_form(form: ClosedForm) -> str:
    """Return a closed form of a force that depends on the place, as the predicate of a sentence."""
    return _FORMS[form.name](form.parameters)


def _point(x: Mapping[str, float]) -> str:
    way = "pulls towards" if x["per_s2"] > 0.0 else "pushes away from"
    text = (
        f"{way} ({x['north_m']:.2f}, {x['east_m']:.2f}, {x['down_m']:.2f}), "
        f"{abs(x['per_s2']):.2g} m/s^2 a metre"
    )
    return text + (f" beyond {x['slack_m']:.2g} m" if x["slack_m"] > 0.1 else "")


def _place(x: Mapping[str, float]) -> str:
    return (
        f"pushes by ({x['push_north']:.2g}, {x['push_east']:.2g}, {x['push_down']:.2g}) m/s^2 at "
        f"({x['north_m']:.2f}, {x['east_m']:.2f}, {x['down_m']:.2f}), and half as much "
        f"{1.18 * x['width_m']:.2g} m from there"
    )


def _along(x: Mapping[str, float]) -> str:
    way = "pushes" if x["greatest_m_s2"] > 0.0 else "pushes back"
    return (
        f"{way} towards azimuth {x['azimuth_deg']:.0f} deg, twice as much each {0.69 * x['length_m']:.2g} m "
        f"that way, up to {abs(x['greatest_m_s2']):.2g} m/s^2 where it was flown"
    )


def _jet(x: Mapping[str, float]) -> str:
    azimuth = math.radians(x["azimuth_deg"])
    north, east = -x["offset_m"] * math.sin(azimuth), x["offset_m"] * math.cos(azimuth)
    return (
        f"blows by {x['push_m_s2']:.2g} m/s^2 towards azimuth {x['azimuth_deg']:.0f} deg along a line "
        f"through ({north:.2f}, {east:.2f}), and half as much {1.18 * x['width_m']:.2g} m beside it"
    )


_FORMS: Mapping[str, Callable[[Mapping[str, float]], str]] = {
    "point": _point,
    "place": _place,
    "along": _along,
    "jet": _jet,
}


def description(told: Description) -> list[str]:
    """Return what a disturbance outside the library depends on, a few lines."""
    lines = dependence(told.force)
    if told.form is not None:
        lines = [lines[0], f"  it {closed_form(told.form)} (held-out skill {told.form.skill:.2f})"]
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
            f"({x:.2g}, {y:.2g}, {z:.2g}) {UNITS[one.channel]} in body axes"
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
