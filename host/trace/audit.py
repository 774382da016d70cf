"""What a log is worth before anything is fitted to it: rates, sampling, clocks, stretches to leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.log import Flight, topics
from trimtab.host.trace.signals import Signals, averaged, signals, without_inputs
from trimtab.host.vehicle import Vehicle

TILT_LIMIT = np.deg2rad(75.0)
"""The lateral forces of such attitudes are not what a hovering vehicle's model is asked for."""

PITCH_LIMIT = np.deg2rad(80.0)
"""Euler ZYX loses a sixth of its digits there and all of them at 90 deg."""

GAP_S = 0.2
"""Two bins of the process disturbance without a measurement; a burst of lost frames is shorter."""

HELD_S = 0.1
"""A rotor at its limit for so long no longer follows the thrust curve's middle: three lags and more."""

AT_LIMIT = (0.01, 0.99)
"""Motor commands that count as 0 and 1: they are means over an interval."""

CLIPPED_SHARE = 0.01
"""Share of ticks with clipped rotors from which on it is said."""

JUMP_S = 0.003
"""Step of the poses' least delay that counts as a jump of a clock: five tolerances of a latency."""

DRIFT_S = 0.002
"""Change between camera and vehicle clock over a flight that is said; offsets are known to 0.5 ms."""

CLEAR_M = 0.05
"""Height over where the vehicle rested, below which it may touch: a tilt of 20 deg of an arm of 0.15 m."""

LOW_M = 0.1
"""Height over the lowest place of a log that never shows the floor, below which support counts."""

SUPPORTED = 1.3
"""Specific force over what the rotors give, in units of the same clear of the ground: ground effect at a
height of a rotor's diameter, a battery's sag and a tether stay below."""

LEVEL_M_S = 0.15
"""Vertical speed below which a vehicle does not fall."""

IMPACT_M_S2 = 2.0 * GRAVITY
"""Difference of specific force and thrust that no air makes."""

_SHOWN = 5
_SPARSE_HZ = 20.0
_FREE_M = 0.3
_STILL_M = 0.02
_RESTING = 0.3
_WINDOW_S = 0.3
_STEP_S = 0.1

NO_POSES, NO_COMMANDS = "gaps in the poses", "gaps in the commands"
JUMP, CONTACT, IMPACT = "a clock that jumps", "ground contact", "an impact"
SATURATED = "a motor at its limit"
TILTED = f"more than {np.rad2deg(TILT_LIMIT):.0f} deg of tilt"
SINGULAR = "a pitch near 90 deg, where Euler angles are singular"


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
    reason: str

    def __str__(self) -> str:
        return f"{self.start_s:.2f} to {self.end_s:.2f} s: {self.reason}"


@dataclass(frozen=True, kw_only=True)
class Audit:
    """The health of one flight: rates by topic, largest gap between poses, stretches left out, remarks.

    segments, left_out and used_s say what the cutting made of it: 0 until then.
    """

    log: str
    rates: tuple[Rate, ...]
    largest_gap_s: float
    stretches: tuple[Stretch, ...]
    remarks: tuple[str, ...]
    used_s: float = 0.0
    segments: int = 0
    left_out: int = 0

    def overlaps(self, start_s: float, end_s: float) -> Stretch | None:
        """The first stretch that takes part of the time from start_s to end_s since tracking began."""
        return next((s for s in self.stretches if s.start_s < end_s and s.end_s > start_s), None)

    def to_json(self) -> dict[str, Any]:
        """The entry of the flight under `audit`."""
        return {
            "log": self.log,
            "used_s": round(self.used_s, 3),
            "segments": self.segments,
            "left_out": self.left_out,
            "largest_gap_s": round(self.largest_gap_s, 4),
            "rates": [
                {
                    "topic": rate.topic,
                    "median_hz": round(rate.median_hz, 2),
                    "worst_hz": round(rate.worst_hz, 2),
                    "sampling": rate.sampling,
                }
                for rate in self.rates
            ],
            "stretches": [
                {"start_s": round(s.start_s, 3), "end_s": round(s.end_s, 3), "reason": s.reason}
                for s in self.stretches
            ],
            "remarks": list(self.remarks),
        }


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
        stretches=tuple(sorted(stretches, key=lambda stretch: (stretch.start_s, stretch.reason))),
        remarks=(*_sampling(flight, rates), *_clocks(flight, s), *_clipped(flight, s)),
    )


def without_twins(audits: Sequence[Audit], twins: Sequence[tuple[int, int]]) -> tuple[Audit, ...]:
    """The audits, with a remark for each flight that has no twin; `twins` pair their indices."""
    paired = {index for pair in twins for index in pair}
    remark = (
        "no twin: fly its reference once more; without, physics outside the library passes for turbulence"
    )
    return tuple(
        one if index in paired else replace(one, remarks=(*one.remarks, remark))
        for index, one in enumerate(audits)
    )


def lines(audits: Sequence[Audit]) -> list[str]:
    """For people: what is not used of each log and why, and every remark once with the logs it is of."""
    out = []
    for one in audits:
        shown = [str(stretch) for stretch in one.stretches[:_SHOWN]]
        more = len(one.stretches) - len(shown)
        if shown:
            tail = f", and {more} more" if more else ""
            out.append(f"{one.log}: not used from {'; '.join(shown)}{tail}")
    remarks: dict[str, list[str]] = {}
    for one in audits:
        for remark in one.remarks:
            remarks.setdefault(remark, []).append(one.log)
    for remark, logs in remarks.items():
        others = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        out.append(f"{logs[0]}{others}: {remark}")
    return out


def _within(t: np.ndarray, span_s: tuple[float, float]) -> np.ndarray:
    return (t >= span_s[0]) & (t <= span_s[1])


def _stretch(s: Signals, start_s: float, end_s: float, reason: str) -> Stretch:
    """From times since arm, cut to the tracking phase."""
    a, b = s.span_s
    return Stretch(start_s=max(start_s, a) - a, end_s=min(end_s, b) - a, reason=reason)


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
    found = [_stretch(s, at[k], at[k + 1], NO_POSES) for k in np.flatnonzero(np.diff(at) > GAP_S)]
    begin, end = s.input_s.T
    if len(begin) == 1:  # one constant stands for commands that nobody recorded
        return found
    holes = [(end[k], begin[k + 1]) for k in np.flatnonzero(begin[1:] - end[:-1] > GAP_S)]
    holes += [(begin[k], end[k]) for k in np.flatnonzero(end - begin > GAP_S)]
    holes += [(s.span_s[0], begin[0]), (end[-1], s.span_s[1])]
    seen = [hole for hole in holes if min(hole[1], s.span_s[1]) - max(hole[0], s.span_s[0]) > GAP_S]
    return found + [_stretch(s, a, b, NO_COMMANDS) for a, b in seen]


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
        if np.isfinite(before) and np.isfinite(after) and abs(after - before) > JUMP_S:
            found.append((edges[k] - 0.25, edges[k] + 0.25))
    if flight.control is not None:
        begin, end = s.input_s.T
        back = np.flatnonzero(begin[1:] - end[:-1] < -1e-3)
        found += [(end[k] - 0.1, end[k] + 0.1) for k in back if s.span_s[0] <= end[k] <= s.span_s[1]]
    return [_stretch(s, a, b, JUMP) for a, b in _merged(found)]


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
    singular = np.abs(R[:, 2, 0]) > np.sin(PITCH_LIMIT)
    tilted = (R[:, 2, 2] < np.cos(TILT_LIMIT)) & ~singular
    return [
        _stretch(s, a - 0.01, b + 0.01, reason)
        for reason, bad in ((SINGULAR, singular), (TILTED, tilted))
        for a, b in _runs(t, bad)
    ]


def _saturation(s: Signals) -> list[Stretch]:
    """Times over HELD_S with a motor command at 0 or at 1."""
    if s.in_newton:
        return []
    limit = np.any((s.command < AT_LIMIT[0]) | (s.command > AT_LIMIT[1]), axis=1)
    begin, end = s.input_s.T
    keep = (end > s.span_s[0]) & (begin < s.span_s[1])
    runs = zip(_runs(begin[keep], limit[keep]), _runs(end[keep], limit[keep]), strict=True)
    return [_stretch(s, a, b, SATURATED) for (a, _), (_, b) in runs if b - a > HELD_S]


def _contact(flight: Flight, s: Signals) -> list[Stretch]:
    """Where the floor carries the vehicle, or something hits it.

    Either low over where it stood, or low in the log, not falling, with rotors that give less than the
    specific force by more than what they give less in free flight.
    """
    t = np.arange(s.pose_s[0], s.pose_s[-1] - _WINDOW_S, _STEP_S)
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
    still = np.array([np.ptp(s.p[a:b], axis=0).max() < _STILL_M for a, b in spans])
    if flight.kind == "flight":  # the log begins as it is armed, on the floor
        touching = np.median(s.p[s.pose_s < s.pose_s[0] + 0.1, 2]) - down < CLEAR_M
    elif (rest := still & (thrust < _RESTING * GRAVITY)).any():
        touching = np.median(down[rest]) - down < CLEAR_M
    height = down.max() - down
    ratio = force / np.maximum(thrust, 0.1)
    powered = thrust > 0.5 * np.nanmedian(thrust[flying])
    free = ratio[powered & (height > _FREE_M)]
    if len(free) <= 5:
        free = np.sort(ratio[powered])[: powered.sum() // 2 + 1]
    carried = (ratio > SUPPORTED * np.median(free)) & (np.abs(speed) < LEVEL_M_S) & (height < LOW_M)
    bad = (touching | carried) & flying
    return [_stretch(s, a, b + _WINDOW_S, CONTACT) for a, b in _runs(t, bad)] + _impacts(flight, s)


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
    x, y, z = s.force.T
    hit = (np.hypot(x, y) > IMPACT_M_S2) | (z > IMPACT_M_S2) | (z < -strongest - IMPACT_M_S2)
    middle = s.imu_s.mean(axis=1)
    keep = _within(middle, s.span_s)
    spans = _merged([(a - 0.1, b + 0.1) for a, b in _runs(middle[keep], hit[keep])])
    return [_stretch(s, a, b, IMPACT) for a, b in spans]


def _sampling(flight: Flight, rates: Sequence[Rate]) -> list[str]:
    """Remarks on what the channels hold, and how often."""
    out = []
    driven = not without_inputs(flight)
    if not driven:
        out.append("no inputs recorded: only forces across the thrust show")
    if flight.reference is None or flight.firmware_parameters is None:
        out.append("no reference with the law that flew it: read in segments, which know timing less well")
    if flight.control is None and (flight.recorded_imu is None or flight.recorded_imu.gyro is None):
        out.append("no gyro: delay and latency are hard to tell apart")
    lag_s = flight.vehicle.motor_lag_s
    for rate in rates:
        told = f"{rate.topic} at {rate.median_hz:.0f} Hz"
        if rate.topic == topics.RECORDED_INPUTS and driven:
            out.append(
                "sampled commands make false lag and inertia: what the motors did between two is unknown"
            )
        commands = rate.topic in (topics.RECORDED_INPUTS, topics.FC_CONTROL) and driven
        if commands and rate.median_hz * lag_s < 1.0:
            out.append(f"{told}: too slow to show the motors' lag of {1e3 * lag_s:.0f} ms")
        if (
            rate.sampling == "sampled"
            and rate.median_hz > _SPARSE_HZ
            and rate.worst_hz < 0.5 * rate.median_hz
        ):
            out.append(f"{told} falls to {rate.worst_hz:.0f} Hz in its leanest second")
    return out


def _clocks(flight: Flight, s: Signals) -> list[str]:
    """Remarks on time stamps."""
    out = []
    recorded = flight.recorded_inputs
    stamps = {
        topics.MOCAP_POSE: s.pose_s,
        topics.RECORDED_INPUTS: np.zeros(0) if recorded is None else recorded.t_us * 1e-6,
    }
    for topic, t in stamps.items():
        repeated = int(np.count_nonzero(np.diff(t[_within(t, s.span_s)]) == 0.0))
        if repeated:
            out.append(f"{topic}: {repeated} time stamps are repeated; one sample of each pair is misplaced")
    link = flight.link
    if link is not None:
        keep = _within(link.t_us * 1e-6, s.span_s)
        apart = (link.clock_offset_us - link.camera_offset_us)[keep] * 1e-6
        if len(apart) > 4:
            t = link.t_us[keep] * 1e-6
            drift = float(np.polyfit(t - t[0], apart, 1)[0] * (t[-1] - t[0]))
            if abs(drift) > DRIFT_S:
                out.append(
                    f"camera and vehicle clocks drift apart by {1e3 * drift:.1f} ms while tracking: "
                    "it reads as a latency that changes"
                )
    return out


def _clipped(flight: Flight, s: Signals) -> list[str]:
    """A remark where rotors could not give what was commanded for a share of the ticks."""
    if flight.status is None:
        return []
    keep = _within(flight.status.t_us * 1e-6, s.span_s)
    ticks = flight.status.flight_ticks[keep]
    if len(ticks) < 2 or ticks[-1] == ticks[0]:
        return []
    share = float(np.ptp(flight.status.saturated_ticks[keep]) / np.ptp(ticks))
    if share < CLIPPED_SHARE:
        return []
    return [f"rotors clipped on {100 * share:.0f} % of the ticks: the reference asks for more than they have"]
