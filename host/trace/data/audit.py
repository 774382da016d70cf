"""Audit of a log before any fit: rates, sampling, clocks, and stretches to leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from trimtab.host.log import Flight, topics
from trimtab.host.trace.data.contact import ground_contact
from trimtab.host.trace.data.real_time import is_too_late, late_spans
from trimtab.host.trace.data.signals import FlightData, Signals, without_inputs
from trimtab.host.trace.data.stretches import (
    STRETCH_ORDER,
    UnusedStretch,
    clipped_stretch,
    merged_spans,
    runs_of,
    within,
)
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.decision.rules import RULES


@dataclass(frozen=True, kw_only=True)
class Rate:
    """Rate of a topic: median, and in its worst second.

    sampling: "averaged" if a message holds a mean over an interval, "sampled" if an instantaneous value.
    """

    topic: str
    median_hz: float
    worst_hz: float
    sampling: str


@dataclass(frozen=True, kw_only=True)
class Audit:
    """Audit of one flight.

    Attributes
    ----------
    log
        Name of the log file.
    rates
        Rate of each topic.
    largest_gap_s
        Longest interval between poses in the tracking phase.
    stretches
        Stretches that are not used.
    findings
        Findings about the log.
    used_s, segments, left_out
        Time in use, number of used segments and of left-out segments; 0 until the flight is cut.
    """

    log: str
    rates: tuple[Rate, ...]
    largest_gap_s: float
    stretches: tuple[UnusedStretch, ...]
    findings: tuple[Finding, ...]
    used_s: float = 0.0
    segments: int = 0
    left_out: int = 0

    def first_overlap(self, start_s: float, end_s: float) -> UnusedStretch | None:
        """Return the first stretch that overlaps start_s to end_s, in s since tracking began, or None."""
        return next((s for s in self.stretches if s.start_s < end_s and s.end_s > start_s), None)


def audit(data: FlightData) -> Audit:
    """Return the audit of the tracking phase of a flight."""
    flight, s = data.flight, data.signals
    rates = _rates(flight, s.span_s)
    landed = [clipped_stretch(s, a * 1e-6, b * 1e-6, Code.GROUND_CONTACT) for a, b in flight.unused]
    measured = [
        *_gaps(s),
        *([] if is_too_late(flight) else [*_jumps(flight, s), *_late(flight, s)]),
        *_attitudes(s),
        *_saturation(s),
        *ground_contact(data),
    ]
    stretches = [*landed, *(each for each in measured if not _is_inside(each, landed))]
    inside = within(s.pose_s, s.span_s)
    return Audit(
        log=flight.path.name,
        rates=rates,
        largest_gap_s=float(np.diff(s.pose_s[inside]).max()),
        stretches=tuple(
            sorted(stretches, key=lambda stretch: (stretch.start_s, STRETCH_ORDER.index(stretch.code)))
        ),
        findings=(*_sampling(flight, rates), *_clocks(flight, s), *_saturated_share(flight, s)),
    )


def _is_inside(stretch: UnusedStretch, others: Sequence[UnusedStretch]) -> bool:
    """Return whether one of the others covers the stretch."""
    return any(each.start_s <= stretch.start_s and stretch.end_s <= each.end_s for each in others)


def with_missing_repeats(
    audits: Sequence[Audit], repeat_flights: Sequence[tuple[int, int]]
) -> tuple[Audit, ...]:
    """Return the audits with a finding for each flight that has no repeat flight.

    repeat_flights: pairs of indices into `audits`.
    """
    paired = {index for pair in repeat_flights for index in pair}
    return tuple(
        each
        if index in paired
        else replace(each, findings=(*each.findings, Finding(code=Code.NO_REPEAT, log=each.log)))
        for index, each in enumerate(audits)
    )


def _rates(flight: Flight, span_s: tuple[float, float]) -> tuple[Rate, ...]:
    """Return the rate of every topic that tracing uses, over the tracking phase."""
    c = flight.control
    tracks = {
        topics.MOCAP_POSE: None if flight.mocap is None else flight.mocap.t_us,
        topics.FC_CONTROL: None if c is None else c.t1_us,
        topics.FC_ESTIMATE: None if flight.estimate is None else flight.estimate.t_us,
        topics.FC_STATUS: None if flight.status is None else flight.status.t_us,
        topics.RECORDED_INPUTS: None if flight.recorded_inputs is None else flight.recorded_inputs.t_us,
        topics.RECORDED_IMU: None if flight.recorded_imu is None else flight.recorded_imu.t_us,
        topics.RECORDED_BATTERY: None
        if flight.battery is None or flight.status is not None
        else flight.battery.t_us,
    }
    known = {topic.name: topic.sampling for topic in (*topics.FLIGHT_TOPICS, *topics.IMPORTED_TOPICS)}
    out = []
    for name, t_us in tracks.items():
        t = np.zeros(0) if t_us is None else t_us[within(t_us * 1e-6, span_s)] * 1e-6
        if len(t) < 2:
            continue
        step = max(float(np.median(np.diff(t))), 1e-6)
        starts = np.arange(span_s[0], max(span_s[1] - 1.0, span_s[0] + 1e-6), 0.25)
        length = min(1.0, span_s[1] - span_s[0])
        counts = np.searchsorted(t, starts + length) - np.searchsorted(t, starts)
        worst = min(float(counts.min()) / length, 1.0 / step)
        out.append(Rate(topic=name, median_hz=1.0 / step, worst_hz=worst, sampling=known[name]))
    return tuple(out)


def _gaps(s: Signals) -> list[UnusedStretch]:
    """Return the stretches without poses or without commands.

    A command interval longer than RULES.gap_s counts as a gap.
    """
    inside = s.pose_s[within(s.pose_s, s.span_s)]
    t = np.r_[s.span_s[0], inside, s.span_s[1]]
    pose_gaps = [
        clipped_stretch(s, t[k], t[k + 1], Code.GAP_IN_POSES)
        for k in np.flatnonzero(np.diff(t) > RULES.gap_s)
    ]
    begin, end = s.input_s.T
    if len(begin) == 1:  # without recorded commands, a single constant stands for them
        return pose_gaps
    gaps = [(end[k], begin[k + 1]) for k in np.flatnonzero(begin[1:] - end[:-1] > RULES.gap_s)]
    gaps += [(begin[k], end[k]) for k in np.flatnonzero(end - begin > RULES.gap_s)]
    gaps += [(s.span_s[0], begin[0]), (end[-1], s.span_s[1])]
    inside_span = [gap for gap in gaps if min(gap[1], s.span_s[1]) - max(gap[0], s.span_s[0]) > RULES.gap_s]
    return pose_gaps + [clipped_stretch(s, a, b, Code.GAP_IN_COMMANDS) for a, b in inside_span]


def _jumps(flight: Flight, s: Signals) -> list[UnusedStretch]:
    """Return the stretches around clock jumps.

    The smallest pose delay (arrival minus time stamp) jumps there, or command intervals overlap.
    """
    jumps = []
    assert flight.mocap is not None
    t, delay = s.pose_s, (flight.mocap.t_arrival_us - flight.mocap.t_us) * 1e-6
    edges = np.arange(s.span_s[0], s.span_s[1], 0.25)
    parts = np.searchsorted(t, edges)
    least_delay = np.array([delay[a:b].min() if b > a else np.inf for a, b in pairwise(parts)])
    for k in range(4, len(least_delay) - 3):
        # Late arrivals only increase a delay, so the least delay over a second shows the clock offset.
        before, after = least_delay[k - 4 : k].min(), least_delay[k : k + 4].min()
        if np.isfinite(before) and np.isfinite(after) and abs(after - before) > RULES.clock_jump_s:
            jumps.append((edges[k] - 0.25, edges[k] + 0.25))
    if flight.control is not None:
        begin, end = s.input_s.T
        overlaps = np.flatnonzero(begin[1:] - end[:-1] < -1e-3)
        jumps += [(end[k] - 0.1, end[k] + 0.1) for k in overlaps if s.span_s[0] <= end[k] <= s.span_s[1]]
    return [clipped_stretch(s, a, b, Code.CLOCK_JUMP) for a, b in merged_spans(jumps)]


def _late(flight: Flight, s: Signals) -> list[UnusedStretch]:
    """Return the stretches in which time ran late."""
    a, b = s.span_s
    inside = [span for span in late_spans(flight) if span[0] < b and span[1] > a]
    return [clipped_stretch(s, *span, Code.LATE_POSES) for span in inside]


def _attitudes(s: Signals) -> list[UnusedStretch]:
    """Return the stretches in which Euler angles are singular or the tilt is too large for the model."""
    tracking = within(s.pose_s, s.span_s)
    t, R = s.pose_s[tracking], s.R_ned_frd[tracking]
    singular = np.abs(R[:, 2, 0]) > np.sin(RULES.pitch_max_rad)
    tilted = (R[:, 2, 2] < np.cos(RULES.tilt_max_rad)) & ~singular
    return [
        clipped_stretch(s, a - 0.01, b + 0.01, code)
        for code, bad in ((Code.PITCH_SINGULAR, singular), (Code.TILTED, tilted))
        for a, b in runs_of(t, bad)
    ]


def _saturation(s: Signals) -> list[UnusedStretch]:
    """Return the stretches longer than RULES.saturation_s with a motor command at 0 or at 1."""
    if s.in_newton:
        return []
    limit = np.any((s.command < RULES.saturation_low) | (s.command > RULES.saturation_high), axis=1)
    begin, end = s.input_s.T
    tracking = (end > s.span_s[0]) & (begin < s.span_s[1])
    at_limit = limit[tracking]
    runs = zip(runs_of(begin[tracking], at_limit), runs_of(end[tracking], at_limit), strict=True)
    return [
        clipped_stretch(s, a, b, Code.MOTOR_AT_LIMIT) for (a, _), (_, b) in runs if b - a > RULES.saturation_s
    ]


def _obstacle(flight: Flight) -> str:
    """Return why reference and law on board do not explain a flight, a key of NO_REFERENCE's words."""
    if flight.host_control is not None:
        return "host-control"
    return "reference" if flight.reference is None else "control-law"


def _sampling(flight: Flight, rates: Sequence[Rate]) -> list[Finding]:
    """Return findings on missing topics and on their sampling and rates."""
    log = flight.path.name
    findings = []
    has_inputs = not without_inputs(flight)
    if not has_inputs:
        findings.append(Finding(code=Code.NO_INPUTS, log=log))
    if not flight.flown_by_own_law:
        findings.append(Finding(code=Code.NO_REFERENCE, subject=(_obstacle(flight),), log=log))
    if flight.control is None and (flight.recorded_imu is None or flight.recorded_imu.gyro is None):
        findings.append(Finding(code=Code.NO_GYRO, log=log))
    lag_s = flight.vehicle.motor_lag_s
    for rate in rates:
        if rate.topic == topics.RECORDED_INPUTS and has_inputs:
            findings.append(Finding(code=Code.SAMPLED_COMMANDS, log=log))
        commands = rate.topic in (topics.RECORDED_INPUTS, topics.FC_CONTROL) and has_inputs
        if commands and rate.median_hz * lag_s < 1.0:
            findings.append(
                Finding(
                    code=Code.SLOW_COMMANDS,
                    value=rate.median_hz,
                    bound=1.0 / lag_s,
                    unit="Hz",
                    subject=(rate.topic,),
                    log=log,
                    details={"motor_lag_s": lag_s},
                )
            )
        if (
            rate.sampling == "sampled"
            and rate.median_hz > RULES.sparse_rate_hz
            and rate.worst_hz < RULES.rate_drop_share * rate.median_hz
        ):
            findings.append(
                Finding(
                    code=Code.RATE_DROPS,
                    value=rate.worst_hz,
                    bound=RULES.rate_drop_share * rate.median_hz,
                    unit="Hz",
                    subject=(rate.topic,),
                    log=log,
                    details={"median_hz": rate.median_hz},
                )
            )
    return findings


def _clocks(flight: Flight, s: Signals) -> list[Finding]:
    """Return findings on repeated time stamps and on clock drift."""
    log = flight.path.name
    findings = []
    recorded = flight.recorded_inputs
    stamps = {
        topics.MOCAP_POSE: s.pose_s,
        topics.RECORDED_INPUTS: np.zeros(0) if recorded is None else recorded.t_us * 1e-6,
    }
    for topic, t in stamps.items():
        repeated = int(np.count_nonzero(np.diff(t[within(t, s.span_s)]) == 0.0))
        if repeated:
            findings.append(
                Finding(
                    code=Code.REPEATED_STAMPS,
                    value=repeated,
                    bound=0,
                    unit="stamps",
                    subject=(topic,),
                    log=log,
                )
            )
    link = flight.link
    if link is not None:
        tracking = within(link.t_us * 1e-6, s.span_s)
        offset_s = (link.clock_offset_us - link.camera_offset_us)[tracking] * 1e-6
        if len(offset_s) > 4:
            t = link.t_us[tracking] * 1e-6
            drift = float(np.polyfit(t - t[0], offset_s, 1)[0] * (t[-1] - t[0]))
            if abs(drift) > RULES.clock_drift_s:
                findings.append(
                    Finding(code=Code.CLOCK_DRIFT, value=drift, bound=RULES.clock_drift_s, unit="s", log=log)
                )
    return findings


def _saturated_share(flight: Flight, s: Signals) -> list[Finding]:
    """Return a finding if the rotors saturated in a considerable share of the control ticks."""
    if flight.status is None:
        return []
    tracking = within(flight.status.t_us * 1e-6, s.span_s)
    ticks = flight.status.flight_ticks[tracking]
    if len(ticks) < 2 or ticks[-1] == ticks[0]:
        return []
    share = float(np.ptp(flight.status.saturated_ticks[tracking]) / np.ptp(ticks))
    if share < RULES.saturation_share:
        return []
    bound = RULES.saturation_share
    return [Finding(code=Code.ROTORS_SATURATED, value=share, bound=bound, log=flight.path.name)]
