"""Sentences of single findings, refusals and closed forms, made from codes and numbers.

Nothing reads them back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.decision.rules import RULES

MIXED_INPUTS = "the logs record inputs of different kinds; trace those with motor commands apart"


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


def too_few_poses(path: Path) -> str:
    """Return the refusal of a log with too few poses."""
    return f"{path}: fewer than {RULES.min_poses} poses; log /mocap/pose in flight"


def too_few_tracking_poses(path: Path) -> str:
    """Return the refusal of a log with too few poses in its tracking phase."""
    return f"{path}: fewer than {RULES.min_tracking_poses} poses in the tracking phase; fly or log longer"


def no_tracking(path: Path) -> str:
    """Return the refusal of a log without a tracking phase."""
    return f"{path}: no tracking phase; the flight ended before its reference began"


def closed_form(name: str, parameters: Mapping[str, float]) -> str:
    """Return a closed form of a force that depends on the place, as the predicate of a sentence."""
    return _FORMS[name](parameters)


def _point(x: Mapping[str, float]) -> str:
    way = "pulls towards" if x["per_s2"] > 0.0 else "pushes away from"
    text = (
        f"{way} ({x['north_m']:.2f}, {x['east_m']:.2f}, {x['down_m']:.2f}), "
        f"{abs(x['per_s2']):.2g} m/s^2 a metre"
    )
    return text + (f" beyond {x['slack_m']:.2g} m" if x["slack_m"] > RULES.shown_slack_m else "")


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


def stretch_reason(code: Code) -> str:
    """Return why a stretch of a flight with this code is not used."""
    return _STRETCHES[code]


def too_few_segments(findings_by_log: Mapping[str, Sequence[Finding]], count: int, segment_s: float) -> str:
    """Return the refusal of logs with too few usable segments, with what each of them lost."""
    why = "; ".join(
        f"{log}: {', '.join(map(sentence, findings))}"
        for log, findings in findings_by_log.items()
        if findings
    )
    logs = ", ".join(findings_by_log)
    return (
        f"{logs}: only {count} usable segments of {segment_s} s; fly longer or log more{why and f' ({why})'}"
    )
