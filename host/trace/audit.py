"""What a log is worth before anything is fitted to it: rates, sampling, clocks, stretches to leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.log import Flight, topics
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.signals import Signals, averaged, signals, without_inputs
from trimtab.host.vehicle import Vehicle

_WINDOW_S = 0.3
"""Length of the windows that support by the floor is looked for in."""

_WINDOW_STEP_S = 0.1

_STRETCH_CODES = (
    Code.CLOCK_JUMP,
    Code.MOTOR_AT_LIMIT,
    Code.PITCH_SINGULAR,
    Code.IMPACT,
    Code.GAP_IN_COMMANDS,
    Code.GAP_IN_POSES,
    Code.GROUND_CONTACT,
    Code.TILTED,
)
"""Why a stretch is not used; of several that begin at one time, the first of these comes first."""


@dataclass(frozen=True, kw_only=True)
class Rate:
    """How often a topic came: median, and in its leanest second; "averaged" over intervals or "sampled"."""

    topic: str
    median_hz: float
    worst_hz: float
    sampling: str


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """A part of a flight that is not used, seconds since tracking began, and why."""

    start_s: float
    end_s: float
    code: Code


@dataclass(frozen=True, kw_only=True)
class Audit:
    """The health of one flight: rates by topic, largest gap between poses, stretches left out, findings.

    segments, left_out and used_s say what the cutting made of it: 0 until then.
    """

    log: str
    rates: tuple[Rate, ...]
    largest_gap_s: float
    stretches: tuple[Stretch, ...]
    findings: tuple[Finding, ...]
    used_s: float = 0.0
    segments: int = 0
    left_out: int = 0

    def overlaps(self, start_s: float, end_s: float) -> Stretch | None:
        """The first stretch that takes part of the time from start_s to end_s since tracking began."""
        return next((s for s in self.stretches if s.start_s < end_s and s.end_s > start_s), None)


def audit(flight: Flight) -> Audit:
    """The health of a flight's tracking phase. Raises TooLittleData as `signals` does."""
    s = signals(flight)
    rates = _rates(flight, s.span_s)
    stretches = [*_gaps(s), *_jumps(flight, s), *_attitudes(s), *_saturation(s), *_contact(flight, s)]
    inside = _within(s.pose_s, s.span_s)
    return Audit(
        log=flight.path.name,
        rates=rates,
        largest_gap_s=float(np.diff(s.pose_s[inside]).max()),
        stretches=tuple(
            sorted(stretches, key=lambda stretch: (stretch.start_s, _STRETCH_CODES.index(stretch.code)))
        ),
        findings=(*_sampling(flight, rates), *_clocks(flight, s), *_saturated_share(flight, s)),
    )


def with_missing_twins(audits: Sequence[Audit], twins: Sequence[tuple[int, int]]) -> tuple[Audit, ...]:
    """Return the audits with a finding for each flight without a twin; `twins` pair their indices."""
    paired = {index for pair in twins for index in pair}
    return tuple(
        one
        if index in paired
        else replace(one, findings=(*one.findings, Finding(code=Code.NO_TWIN, log=one.log)))
        for index, one in enumerate(audits)
    )


def _within(t: np.ndarray, span_s: tuple[float, float]) -> np.ndarray:
    return (t >= span_s[0]) & (t <= span_s[1])


def _stretch(s: Signals, start_s: float, end_s: float, code: Code) -> Stretch:
    """From times since arm, cut to the tracking phase."""
    a, b = s.span_s
    return Stretch(start_s=max(start_s, a) - a, end_s=min(end_s, b) - a, code=code)


def _runs(t: np.ndarray, bad: np.ndarray) -> list[tuple[float, float]]:
    """First and last time of each unbroken run of `bad` samples."""
    edges = np.flatnonzero(np.diff(np.r_[False, bad, False].astype(int)))
    return [(float(t[a]), float(t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _rates(flight: Flight, span_s: tuple[float, float]) -> tuple[Rate, ...]:
    """The rate of every topic that tracing uses, over the tracking phase."""
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
        t = np.zeros(0) if t_us is None else t_us[_within(t_us * 1e-6, span_s)] * 1e-6
        if len(t) < 2:
            continue
        step = max(float(np.median(np.diff(t))), 1e-6)
        starts = np.arange(span_s[0], max(span_s[1] - 1.0, span_s[0] + 1e-6), 0.25)
        length = min(1.0, span_s[1] - span_s[0])
        counts = np.searchsorted(t, starts + length) - np.searchsorted(t, starts)
        worst = min(float(counts.min()) / length, 1.0 / step)
        out.append(Rate(topic=name, median_hz=1.0 / step, worst_hz=worst, sampling=known[name]))
    return tuple(out)


def _gaps(s: Signals) -> list[Stretch]:
    """Times without poses and without commands; a mean over so long an interval is no command either."""
    inside = s.pose_s[_within(s.pose_s, s.span_s)]
    at = np.r_[s.span_s[0], inside, s.span_s[1]]
    found = [
        _stretch(s, at[k], at[k + 1], Code.GAP_IN_POSES) for k in np.flatnonzero(np.diff(at) > RULES.gap_s)
    ]
    begin, end = s.input_s.T
    if len(begin) == 1:  # one constant stands for commands that nobody recorded
        return found
    holes = [(end[k], begin[k + 1]) for k in np.flatnonzero(begin[1:] - end[:-1] > RULES.gap_s)]
    holes += [(begin[k], end[k]) for k in np.flatnonzero(end - begin > RULES.gap_s)]
    holes += [(s.span_s[0], begin[0]), (end[-1], s.span_s[1])]
    seen = [hole for hole in holes if min(hole[1], s.span_s[1]) - max(hole[0], s.span_s[0]) > RULES.gap_s]
    return found + [_stretch(s, a, b, Code.GAP_IN_COMMANDS) for a, b in seen]


def _jumps(flight: Flight, s: Signals) -> list[Stretch]:
    """Where the poses' least delay steps, or intervals of the vehicle's clock overlap."""
    found = []
    assert flight.mocap is not None
    t, delay = s.pose_s, (flight.mocap.t_arrival_us - flight.mocap.t_us) * 1e-6
    edges = np.arange(s.span_s[0], s.span_s[1], 0.25)
    parts = np.searchsorted(t, edges)
    least = np.array([delay[a:b].min() if b > a else np.inf for a, b in pairwise(parts)])
    for k in range(4, len(least) - 3):
        # Late arrivals only add to a delay: its least over a second is the clocks' affair.
        before, after = least[k - 4 : k].min(), least[k : k + 4].min()
        if np.isfinite(before) and np.isfinite(after) and abs(after - before) > RULES.clock_jump_s:
            found.append((edges[k] - 0.25, edges[k] + 0.25))
    if flight.control is not None:
        begin, end = s.input_s.T
        back = np.flatnonzero(begin[1:] - end[:-1] < -1e-3)
        found += [(end[k] - 0.1, end[k] + 0.1) for k in back if s.span_s[0] <= end[k] <= s.span_s[1]]
    return [_stretch(s, a, b, Code.CLOCK_JUMP) for a, b in _merged(found)]


def _merged(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Spans in order, those that touch as one."""
    out: list[tuple[float, float]] = []
    for a, b in sorted(spans):
        if out and a <= out[-1][1]:
            out[-1] = (out[-1][0], max(b, out[-1][1]))
        else:
            out.append((a, b))
    return out


def _attitudes(s: Signals) -> list[Stretch]:
    """Attitudes that the model or its coordinates cannot hold."""
    keep = _within(s.pose_s, s.span_s)
    t, R = s.pose_s[keep], s.R[keep]
    singular = np.abs(R[:, 2, 0]) > np.sin(RULES.pitch_max_rad)
    tilted = (R[:, 2, 2] < np.cos(RULES.tilt_max_rad)) & ~singular
    return [
        _stretch(s, a - 0.01, b + 0.01, code)
        for code, bad in ((Code.PITCH_SINGULAR, singular), (Code.TILTED, tilted))
        for a, b in _runs(t, bad)
    ]


def _saturation(s: Signals) -> list[Stretch]:
    """Times over RULES.saturation_s with a motor command at 0 or at 1."""
    if s.in_newton:
        return []
    limit = np.any((s.command < RULES.saturation_low) | (s.command > RULES.saturation_high), axis=1)
    begin, end = s.input_s.T
    keep = (end > s.span_s[0]) & (begin < s.span_s[1])
    runs = zip(_runs(begin[keep], limit[keep]), _runs(end[keep], limit[keep]), strict=True)
    return [_stretch(s, a, b, Code.MOTOR_AT_LIMIT) for (a, _), (_, b) in runs if b - a > RULES.saturation_s]


def _contact(flight: Flight, s: Signals) -> list[Stretch]:
    """Where the floor carries the vehicle, or something hits it.

    Either low over where it stood, or low in the log, not falling, with rotors that give less than the
    specific force by more than what they give less in free flight.
    """
    t = np.arange(s.pose_s[0], s.pose_s[-1] - _WINDOW_S, _WINDOW_STEP_S)
    low, high = np.searchsorted(s.pose_s, t), np.searchsorted(s.pose_s, t + _WINDOW_S)
    known = high - low >= 4
    t, low, high = t[known], low[known], high[known]
    flying = (t + _WINDOW_S > s.span_s[0]) & (t < s.span_s[1])
    if without_inputs(flight) or not flying.any():
        return _impacts(flight, s)
    spans = list(zip(low, high, strict=True))
    down = np.array([np.median(s.p[a:b, 2]) for a, b in spans])
    thrust, force, speed = _carried(flight.vehicle, s, t, low, high)
    touching = np.zeros(len(t), dtype=bool)
    still = np.array([np.ptp(s.p[a:b], axis=0).max() < RULES.still_m for a, b in spans])
    if flight.kind == "flight":  # the log begins as it is armed, on the floor
        touching = np.median(s.p[s.pose_s < s.pose_s[0] + 0.1, 2]) - down < RULES.clear_m
    elif (rest := still & (thrust < RULES.resting_thrust_g * GRAVITY)).any():
        touching = np.median(down[rest]) - down < RULES.clear_m
    height = down.max() - down
    ratio = force / np.maximum(thrust, 0.1)
    powered = thrust > 0.5 * np.nanmedian(thrust[flying])
    free = ratio[powered & (height > RULES.free_height_m)]
    if len(free) <= 5:
        free = np.sort(ratio[powered])[: powered.sum() // 2 + 1]
    carried = (
        (ratio > RULES.support_ratio * np.median(free))
        & (np.abs(speed) < RULES.level_speed_m_s)
        & (height < RULES.low_m)
    )
    bad = (touching | carried) & flying
    return [_stretch(s, a, b + _WINDOW_S, Code.GROUND_CONTACT) for a, b in _runs(t, bad)] + _impacts(
        flight, s
    )


def _carried(
    vehicle: Vehicle, s: Signals, t: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nominal specific thrust, specific force along it (m/s^2), and vertical speed, in windows from t (n,).

    The accelerometer says the force, without one the poses' curvature does. NaN without commands.
    """
    knots = np.ravel(np.column_stack([t, t + _WINDOW_S]))
    order = np.argsort(knots, kind="stable")
    each = s.command if s.in_newton else _thrust(vehicle, s.command)
    edges = np.unique(knots[order])
    first, last = np.searchsorted(edges, t), np.searchsorted(edges, t + _WINDOW_S)

    def means(interval_s: np.ndarray, value: np.ndarray) -> np.ndarray:
        mean, share = averaged(edges, interval_s, value[:, None])
        weight = np.r_[0.0, np.cumsum(share * np.diff(edges))]
        area = np.r_[0.0, np.cumsum(mean[:, 0] * share * np.diff(edges))]
        length = weight[last] - weight[first]
        return np.where(
            length > 0.5 * _WINDOW_S, (area[last] - area[first]) / np.maximum(length, 1e-9), np.nan
        )

    thrust = means(s.input_s, each.sum(axis=1) / vehicle.mass_kg)
    curve = [
        np.polynomial.polynomial.polyfit(s.pose_s[a:b] - s.pose_s[a], s.p[a:b], 2)
        for a, b in zip(low, high, strict=True)
    ]
    speed = np.array([c[1, 2] + c[2, 2] * _WINDOW_S for c in curve])
    if len(s.force):
        force = -means(s.imu_s, s.force[:, 2])
    else:
        acceleration = np.array([2.0 * c[2] for c in curve])
        axis = s.R[(low + high) // 2, :, 2]
        force = -np.einsum("ni,ni->n", axis, acceleration - np.array([0.0, 0.0, GRAVITY]))
    return thrust, force, speed


def _thrust(vehicle: Vehicle, command: np.ndarray) -> np.ndarray:
    c1, c2 = vehicle.thrust_curve
    return vehicle.thrust_max_n * command * (c1 + c2 * command)


def _impacts(flight: Flight, s: Signals) -> list[Stretch]:
    """Times at which the accelerometer shows what no rotor can give and no air makes."""
    if not len(s.force):
        return []
    strongest = 4.0 * flight.vehicle.thrust_max_n / flight.vehicle.mass_kg
    beyond = RULES.impact_g * GRAVITY
    x, y, z = s.force.T
    hit = (np.hypot(x, y) > beyond) | (z > beyond) | (z < -strongest - beyond)
    middle = s.imu_s.mean(axis=1)
    keep = _within(middle, s.span_s)
    spans = _merged([(a - 0.1, b + 0.1) for a, b in _runs(middle[keep], hit[keep])])
    return [_stretch(s, a, b, Code.IMPACT) for a, b in spans]


def _sampling(flight: Flight, rates: Sequence[Rate]) -> list[Finding]:
    """Return findings on what the channels hold, and how often."""
    log = flight.path.name
    findings = []
    driven = not without_inputs(flight)
    if not driven:
        findings.append(Finding(code=Code.NO_INPUTS, log=log))
    if flight.reference is None or flight.firmware_parameters is None:
        findings.append(Finding(code=Code.NO_REFERENCE, log=log))
    if flight.control is None and (flight.recorded_imu is None or flight.recorded_imu.gyro is None):
        findings.append(Finding(code=Code.NO_GYRO, log=log))
    lag_s = flight.vehicle.motor_lag_s
    for rate in rates:
        if rate.topic == topics.RECORDED_INPUTS and driven:
            findings.append(Finding(code=Code.SAMPLED_COMMANDS, log=log))
        commands = rate.topic in (topics.RECORDED_INPUTS, topics.FC_CONTROL) and driven
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
    """Return findings on time stamps."""
    log = flight.path.name
    findings = []
    recorded = flight.recorded_inputs
    stamps = {
        topics.MOCAP_POSE: s.pose_s,
        topics.RECORDED_INPUTS: np.zeros(0) if recorded is None else recorded.t_us * 1e-6,
    }
    for topic, t in stamps.items():
        repeated = int(np.count_nonzero(np.diff(t[_within(t, s.span_s)]) == 0.0))
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
        keep = _within(link.t_us * 1e-6, s.span_s)
        apart = (link.clock_offset_us - link.camera_offset_us)[keep] * 1e-6
        if len(apart) > 4:
            t = link.t_us[keep] * 1e-6
            drift = float(np.polyfit(t - t[0], apart, 1)[0] * (t[-1] - t[0]))
            if abs(drift) > RULES.clock_drift_s:
                findings.append(
                    Finding(code=Code.CLOCK_DRIFT, value=drift, bound=RULES.clock_drift_s, unit="s", log=log)
                )
    return findings


def _saturated_share(flight: Flight, s: Signals) -> list[Finding]:
    """Return a finding where rotors could not give what was commanded for a share of the ticks."""
    if flight.status is None:
        return []
    keep = _within(flight.status.t_us * 1e-6, s.span_s)
    ticks = flight.status.flight_ticks[keep]
    if len(ticks) < 2 or ticks[-1] == ticks[0]:
        return []
    share = float(np.ptp(flight.status.saturated_ticks[keep]) / np.ptp(ticks))
    if share < RULES.saturation_share:
        return []
    bound = RULES.saturation_share
    return [Finding(code=Code.ROTORS_SATURATED, value=share, bound=bound, log=flight.path.name)]
