"""Sentences of single findings, refusals and closed forms, made from codes and numbers.

The program never reads a sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.decision.rules import RULES

MIXED_INPUTS = (
    "some logs record motor commands and others thrusts or no inputs; trace the logs with motor commands "
    "separately"
)
"""Refusal of logs with inputs of different kinds."""

_STRETCHES = {
    Code.CLOCK_JUMP: "a clock jump",
    Code.LATE_POSES: "poses that came late or with a wrong stamp, since time ran late",
    Code.MOTOR_AT_LIMIT: "a motor at its limit",
    Code.PITCH_SINGULAR: "pitch near 90 deg, where Euler angles are singular",
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
        return f"an unexplained force of {f.value:.2f} m/s^2 repeats between repeat flights (z {z:.1f})"
    return (
        f"an unexplained angular acceleration of {f.value:.2f} rad/s^2 repeats between repeat flights "
        f"(z {z:.1f})"
    )


def _rings(f: Finding) -> str:
    name = "force" if f.code is Code.FORCE_RINGS else "torque"
    return (
        f"the residual {name} rings at {f.details['hz']:.2f} Hz, with {f.value:.1f} times the power of "
        "neighbouring frequencies"
    )


def _excess(f: Finding) -> str:
    if f.code is Code.EXCESS_FORCE:
        residual = f"a force of {f.value:.1f} m/s^2"
    else:
        residual = f"an angular acceleration of {f.value:.0f} rad/s^2"
    return (
        f"{residual} remains unexplained, which is too much for indoor turbulence; fly each reference twice "
        "to see whether it repeats"
    )


def _topic_at(f: Finding, rate_hz: float | None) -> str:
    return f"{f.subject[0]} at {rate_hz:.0f} Hz"


_OBSTACLES = {
    "reference": "no reference recorded",
    "control-law": "no parameters of the control law recorded",
    "host-control": "a controller on the host flew",
}
"""What keeps a flight from being predicted from its reference, by the subject of NO_REFERENCE."""

_SENTENCES: Mapping[Code, Callable[[Finding], str]] = {
    Code.FLIGHTS_REPEAT: lambda f: (
        f"{1e3 * f.details['position_m']:.1f} mm of the prediction error repeat between repeat flights, with "
        f"{f.details['amplitude']:.1f} times the amplitude of turbulence and noise (z {f.details['z']:.1f})"
    ),
    Code.FLIGHTS_WORSENED: lambda f: (
        f"the best effects make the prediction worse: {1e3 * (f.value or 0.0):.1f} mm of its error repeat, "
        f"and the bound is {1e3 * (f.bound or 0.0):.1f} mm"
    ),
    Code.FORCE_REPEATS: _channel_repeats,
    Code.TORQUE_REPEATS: _channel_repeats,
    Code.FORCE_RINGS: _rings,
    Code.TORQUE_RINGS: _rings,
    Code.FORCE_PULSES: lambda f: (
        f"a force of up to {f.value:.2f} m/s^2 pushes towards {f.details['bearing_deg']:.0f} degrees every "
        f"{f.details['period_s']:.1f} s, at other times in each repeat flight, as a fan that sweeps does"
    ),
    Code.TRACKING_TOO_SHORT: lambda f: (
        f"all flights together track for only {f.value:.1f} s with the rate integral inside its limits, so "
        "tracing used segments instead of whole flights; fly longer"
    ),
    Code.HOVER_ONLY: lambda f: (
        "the flights only hover, so tracing used segments instead of whole flights; fly manoeuvres"
    ),
    Code.POSES_TOO_SLOW: lambda f: (
        f"the poses of a log are {1e3 * (f.value or 0.0):.0f} ms apart, so tracing used segments instead of "
        f"whole flights; log one every {1e3 * (f.bound or 0.0):.0f} ms or more often"
    ),
    Code.EXCESS_FORCE: _excess,
    Code.EXCESS_TORQUE: _excess,
    Code.BETTER_BUT_INADMISSIBLE: lambda f: (
        f"{', '.join(f.subject)} would explain the flights better, but only with parameter values at a "
        "bound or within tolerance"
    ),
    Code.SEGMENTS_DISAGREE: lambda f: (
        f"whole flights support {', '.join(f.subject)}, but segments do not; fly more"
    ),
    Code.ONLY_HOVER: lambda _: (
        "without a body rate in the logs, only what the rotors balance in the mean of a flight was compared; "
        "weigh the vehicle, change the propeller of the rotor in question, or log the gyro, and fly again"
    ),
    Code.TIME_RAN_LATE: lambda f: (
        f"{f.log}: time ran late in {100 * (f.value or 0.0):.0f} % of the tracking phase, which looks like "
        "physics; fly again in lock-step, or in real time on a computer with less to do"
    ),
    Code.ALIAS: lambda f: f"{f.subject[0]} may be {f.subject[1]} ({f.value:.2f})",
    Code.EXACT_ALIAS: lambda f: f"no flight can distinguish {f.subject[0]} from {f.subject[1]}",
    Code.POSSIBLE: lambda f: f"{f.subject[0]} is not excluded ({f.value:.2f})",
    Code.SOMETHING_MISSING: lambda f: (
        f"an effect is missing with probability {f.value:.2f}, but these flights do not show which one"
    ),
    Code.ADJUSTED_FAR: lambda f: (
        f"{f.subject[0]} {f.subject[1]} {f.details['value']:.4g}"
        f"{'' if f.subject[2] == '1' else ' ' + f.subject[2]} ({f.value:.1f} tolerances)"
    ),
    Code.HIDDEN: lambda f: f"these flights would not show {f.subject[0]} of typical size",
    Code.NO_REPEAT: lambda f: (
        "no repeat flight: fly the same reference again; otherwise physics outside the library looks like "
        "turbulence"
    ),
    Code.NO_INPUTS: lambda f: "no inputs recorded: only forces perpendicular to the thrust are observable",
    Code.NO_REFERENCE: lambda f: (
        f"{_OBSTACLES[f.subject[0]]}: tracing uses segments, which determine timing less well"
    ),
    Code.NO_GYRO: lambda f: "no gyro: actuation delay and mocap latency are hard to distinguish",
    Code.SAMPLED_COMMANDS: lambda f: (
        "sampled commands bias motor lag and inertia and hide dead zones, since commands between two samples "
        "are unknown"
    ),
    Code.SLOW_COMMANDS: lambda f: (
        f"{_topic_at(f, f.value)} is too slow to show the motor lag of "
        f"{1e3 * f.details['motor_lag_s']:.0f} ms"
    ),
    Code.RATE_DROPS: lambda f: (
        f"{_topic_at(f, f.details['median_hz'])} drops to {f.value:.0f} Hz in its worst second"
    ),
    Code.REPEATED_STAMPS: lambda f: (
        f"{f.subject[0]}: {f.value:.0f} time stamps are repeated; one sample of each pair has a wrong time"
    ),
    Code.CLOCK_DRIFT: lambda f: (
        f"the clocks of camera and vehicle drift apart by {1e3 * (f.value or 0.0):.1f} ms while tracking, "
        "which looks like a changing latency"
    ),
    Code.ROTORS_SATURATED: lambda f: (
        f"rotors saturate in {100 * (f.value or 0.0):.0f} % of the ticks: the reference demands more thrust "
        "than they have"
    ),
    Code.SEGMENTS_LEFT_OUT: lambda f: f"{f.value:.0f} segments with {_STRETCHES[Code(f.subject[0])]}",
    Code.SEGMENTS_WITH_GAPS: lambda f: f"{f.value:.0f} segments with gaps in poses or commands",
}


def too_few_poses(path: Path) -> str:
    """Return the error message for a log with too few poses."""
    return f"{path}: fewer than {RULES.min_poses} poses; log /mocap/pose in flight"


def too_few_tracking_poses(path: Path) -> str:
    """Return the error message for a log with too few poses in its tracking phase."""
    return f"{path}: fewer than {RULES.min_tracking_poses} poses in the tracking phase; fly or log longer"


def no_tracking(path: Path) -> str:
    """Return the error message for a log without a tracking phase."""
    return f"{path}: no tracking phase; the flight ended before its reference began"


def closed_form(name: str, parameters: Mapping[str, float]) -> str:
    """Return the predicate of a sentence about a force field, such as "pulls towards ...".

    name: one of the closed forms of `trimtab.host.trace.residual.closed_forms`. parameters: its parameters.
    """
    return _FORMS[name](parameters)


def _point(x: Mapping[str, float]) -> str:
    verb = "pulls towards" if x["per_s2"] > 0.0 else "pushes away from"
    text = (
        f"{verb} ({x['north_m']:.2f}, {x['east_m']:.2f}, {x['down_m']:.2f}) m by "
        f"{abs(x['per_s2']):.2g} m/s^2 per metre"
    )
    return text + (f" beyond {x['slack_m']:.2g} m" if x["slack_m"] > RULES.shown_slack_m else "")


def _place(x: Mapping[str, float]) -> str:
    return (
        f"is ({x['push_north']:.2g}, {x['push_east']:.2g}, {x['push_down']:.2g}) m/s^2 at "
        f"({x['north_m']:.2f}, {x['east_m']:.2f}, {x['down_m']:.2f}) m, and half as strong "
        f"{1.18 * x['width_m']:.2g} m away from that place"
    )


def _along(x: Mapping[str, float]) -> str:
    azimuth_deg = x["azimuth_deg"]
    push = "pushes towards" if x["greatest_m_s2"] > 0.0 else "pushes against"
    return (
        f"{push} azimuth {azimuth_deg:.0f} deg, doubles every {0.69 * x['length_m']:.2g} m in the direction "
        f"of that azimuth, and reaches {abs(x['greatest_m_s2']):.2g} m/s^2 on the flown paths"
    )


def _jet(x: Mapping[str, float]) -> str:
    azimuth = math.radians(x["azimuth_deg"])
    north, east = -x["offset_m"] * math.sin(azimuth), x["offset_m"] * math.cos(azimuth)
    return (
        f"is a jet of {x['push_m_s2']:.2g} m/s^2 towards azimuth {x['azimuth_deg']:.0f} deg along a line "
        f"through ({north:.2f}, {east:.2f}) m, and half as strong {1.18 * x['width_m']:.2g} m beside it"
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
    """Return the error message for logs with too few usable segments, with the reasons of each log.

    findings_by_log: findings about left-out segments. count: number of usable segments of length segment_s.
    """
    reasons = "; ".join(
        f"{log}: {', '.join(map(sentence, findings))}"
        for log, findings in findings_by_log.items()
        if findings
    )
    logs = ", ".join(findings_by_log)
    return (
        f"{logs}: only {count} usable segments of {segment_s:g} s; fly longer or log more"
        f"{reasons and f' ({reasons})'}"
    )
