"""Consistency checks of a recording, which detect wrong axes and units.

Tracing would explain a log that was read in a wrong frame by effects that do not exist. These checks compare
the attitude with gyro, accelerometer and position. The bounds are wide: errors of a bad sensor pass, but a
swapped axis, a wrong sign or a wrong unit does not. A gap in the poses is left out of every comparison. If
only a part of the log contradicts itself, and the rest shows that axes and units are right, the rest is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.imports.airborne import SHORTEST_US
from trimtab.host.imports.recording import Cut, ImportFormatError, Recording

_STEP_S = 0.1
_FEWEST = 10
"""Number of steps from which two measurements can be compared."""

_CORRELATION_MIN = 0.3
"""Least correlation of two measurements of the same quantity."""

_SLOPE_MAX = 3.0
"""Greatest slope between two measurements of the same quantity.

Noise makes the standard deviation of one larger, so the regression that allows for it is taken.
"""

_MOVING = {"rate": 0.15, "acceleration": 0.4}
"""Standard deviation, rad/s and m/s^2, from which two measurements can be compared."""

_WINDOW_S = 2.0
"""Length of the parts that are judged alone if a whole recording contradicts itself."""

Answer = Literal["silent", "agree", "contradict"]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What two measurements of one quantity say of each other, and the line for a user if they contradict."""

    quantity: str
    answer: Answer
    line: str = ""


Span = tuple[int, int]
"""Begin and end, us."""


def consistent_parts(
    recording: Recording, spans_us: Sequence[Span]
) -> tuple[tuple[Span, ...], tuple[Cut, ...]]:
    """Return the consistent part of each span, and what was cut from them.

    Raises ImportFormatError with every inconsistency if no part of two seconds shows that what contradicts
    elsewhere is right.
    """
    parts: list[Span] = []
    cut: list[Cut] = []
    wrong: dict[str, Comparison] = {}
    for span_us in spans_us:
        contradictions = [found for found in compare(recording, span_us) if found.answer == "contradict"]
        wrong |= {found.quantity: found for found in contradictions if found.quantity not in wrong}
        part = _sound_part(recording, span_us, contradictions)
        if part is not None:
            parts.append(part)
        left_out = (span_us,) if part is None else ((span_us[0], part[0]), (part[1], span_us[1]))
        reason = "; ".join(found.line for found in contradictions)
        cut += [Cut(begin_us=a, end_us=b, reason=reason) for a, b in left_out if a < b]
    answers = [{found.quantity: found.answer for found in compare(recording, part)} for part in parts]
    if all(any(each.get(quantity) == "agree" for each in answers) for quantity in wrong):
        return tuple(parts), tuple(cut)
    raise ImportFormatError(*(f"{recording.source}: {found.line}" for found in wrong.values()))


def _sound_part(recording: Recording, span_us: Span, wrong: Sequence[Comparison]) -> Span | None:
    """Return the span, or its longest part in which what is wrong elsewhere agrees; None without one."""
    if not wrong:
        return span_us
    for part in _sound_parts(recording, span_us):
        answers = {found.quantity: found.answer for found in compare(recording, part)}
        if "contradict" not in answers.values() and all(
            answers.get(found.quantity) == "agree" for found in wrong
        ):
            return part
    return None


def _sound_parts(recording: Recording, span_us: Span) -> list[Span]:
    """Return the parts of at least two seconds in which no window contradicts itself, longest first."""
    step_us = round(_WINDOW_S * 1e6)
    edges = [*range(span_us[0], span_us[1] - step_us, step_us), span_us[1]]
    sound = [
        all(found.answer != "contradict" for found in compare(recording, window))
        for window in pairwise(edges)
    ]
    ends = np.flatnonzero(np.diff(np.r_[False, sound, False].astype(int))).tolist()
    parts = [(edges[a], edges[b]) for a, b in zip(ends[::2], ends[1::2], strict=True)]
    return sorted((p for p in parts if p[1] - p[0] >= SHORTEST_US), key=lambda p: p[0] - p[1])


def compare(recording: Recording, span_us: Span) -> list[Comparison]:
    """Return the comparisons that the recording allows between two times."""
    begin_s, end_s = span_us[0] * 1e-6, span_us[1] * 1e-6
    pose_s = recording.pose_us * 1e-6
    t_s = np.arange(begin_s, end_s - 1e-9, _STEP_S)
    near = np.clip(np.searchsorted(pose_s, t_s), 0, len(pose_s) - 1)
    R = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True).as_matrix()
    rates_and_forces = [*_rates(recording, pose_s, t_s), *_forces(recording, pose_s, t_s)]
    if np.median(R[:, 2, 2]) < 0.0:
        line = "the vehicle flies upside down: check the attitude, world and body axes"
        return [Comparison(quantity="up", answer="contradict", line=line), *rates_and_forces]
    return [
        Comparison(quantity="up", answer="agree"),
        *_accelerations(recording, pose_s, t_s, R),
        *rates_and_forces,
    ]


def _rates(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray) -> list[Comparison]:
    """Compare the gyro with the change of the attitude, for each axis."""
    if recording.gyro is None or recording.imu_us is None:
        return []
    near = np.unique(np.clip(np.searchsorted(pose_s, t_s), 0, len(pose_s) - 1))
    turn = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True)
    edges_s, imu_s = pose_s[near], recording.imu_us * 1e-6
    turned = (turn[:-1].inv() * turn[1:]).as_rotvec() / np.diff(edges_s)[:, None]
    measured = _means(edges_s, imu_s, recording.gyro)
    whole = _without_gap(edges_s, pose_s) & _without_gap(edges_s, imu_s)
    return [
        _judge(
            f"rate {axis}",
            turned[whole, i],
            measured[whole, i],
            _MOVING["rate"],
            f"the gyro's {axis} axis does not match the attitude ({{why}}): check body axes and units",
        )
        for i, axis in enumerate("xyz")
    ]


def _forces(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray) -> list[Comparison]:
    """Compare the mean specific force with gravity; its mean is weight over a flight."""
    if recording.specific_force is None or recording.imu_us is None:
        return []
    imu_s = recording.imu_us * 1e-6
    inside = (imu_s >= t_s[0]) & (imu_s <= t_s[-1])
    near = np.clip(np.searchsorted(pose_s, imu_s[inside]), 0, len(pose_s) - 1)
    R = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True).as_matrix()
    mean = np.einsum("nij,nj->i", R, recording.specific_force[inside]) / max(1, inside.sum())
    if np.linalg.norm(mean + np.array([0.0, 0.0, GRAVITY])) < GRAVITY / 3.0:
        return [Comparison(quantity="weight", answer="agree")]
    north, east, down = mean
    line = (
        f"the accelerometer averages {north:.2f} north, {east:.2f} east, {-down:.2f} up in m/s^2 instead of "
        "9.81 up: check its unit and the body axes"
    )
    return [Comparison(quantity="weight", answer="contradict", line=line)]


def _accelerations(
    recording: Recording, pose_s: np.ndarray, t_s: np.ndarray, R: np.ndarray
) -> list[Comparison]:
    """Compare horizontal acceleration with the tilt of the thrust, north and east.

    The second difference of positions over twice the step has a fourth of their noise. Noise alone is no
    contradiction, so one must stand there too.
    """
    found = []
    for i in range(2):
        fast = _acceleration(recording, pose_s, t_s, R, i, _MOVING["acceleration"])
        if fast.answer == "contradict" and len(t_s) >= 2 * (_FEWEST + 3):
            slow = _acceleration(recording, pose_s, t_s[::2], R[::2], i, _MOVING["acceleration"] / 4.0)
            fast = fast if slow.answer == "contradict" else slow
        found.append(fast)
    return found


def _acceleration(
    recording: Recording, pose_s: np.ndarray, t_s: np.ndarray, R: np.ndarray, i: int, moving: float
) -> Comparison:
    """Compare acceleration along world axis i with the tilt of the thrust at times t_s of one step."""
    step_s = float(t_s[1] - t_s[0]) if len(t_s) > 1 else _STEP_S
    steps = _without_gap(t_s, pose_s)
    whole = steps[:-2] & steps[1:-1] & steps[2:]
    p = _means(t_s, pose_s, recording.p_ned[:, i : i + 1])[:, 0]
    second = (p[2:] - 2.0 * p[1:-1] + p[:-2]) / step_s**2
    lean = -GRAVITY * R[:, i, 2] / np.maximum(R[:, 2, 2], 0.2)
    # Both are filtered with the same triangle, so that fast changes look the same.
    middle = 0.25 * lean[:-3] + 0.5 * lean[1:-2] + 0.25 * lean[2:-1]
    even = 0.25 * lean[1:-2] + 0.5 * lean[2:-1] + 0.25 * lean[3:]
    axis = ("north", "east")[i]
    line = f"the acceleration {axis} does not match the tilt of the attitude ({{why}})"
    tilted = 0.5 * (middle + even)
    return _judge(
        f"acceleration {axis}",
        tilted[whole],
        second[whole],
        moving,
        f"{line}: check world axes and units",
    )


def _without_gap(edges_s: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Return whether each step between edges (n + 1,) lies in no gap between samples longer than a step."""
    gaps = np.flatnonzero(np.diff(t_s) > _STEP_S)
    begin, end = t_s[gaps], t_s[gaps + 1]
    touched = np.searchsorted(begin, edges_s[1:], side="left") - np.searchsorted(
        end, edges_s[:-1], side="right"
    )
    return touched <= 0


def _means(edges_s: np.ndarray, t_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return means (n, k) of sampled values between edges (n + 1,), by the trapezoid rule."""
    out = np.empty((len(edges_s) - 1, values.shape[1]))
    for i in range(values.shape[1]):
        area = np.r_[0.0, np.cumsum(0.5 * (values[1:, i] + values[:-1, i]) * np.diff(t_s))]
        out[:, i] = np.diff(np.interp(edges_s, t_s, area)) / np.diff(edges_s)
    return out


def _judge(quantity: str, a: np.ndarray, b: np.ndarray, moving: float, line: str) -> Comparison:
    """Compare two measurements of one quantity; `line` has a place for why they contradict."""
    spread = (float(np.std(a)), float(np.std(b))) if len(a) else (0.0, 0.0)
    if len(a) < _FEWEST or max(spread) < moving:
        return Comparison(quantity=quantity, answer="silent")
    why = f"{spread[1]:.3g} against {spread[0]:.3g}"
    if 0.0 < min(spread) <= max(spread) < np.inf:
        correlation = float(np.mean((a - a.mean()) * (b - b.mean())) / (spread[0] * spread[1]))
        if not correlation > _CORRELATION_MIN:
            why = f"correlation {correlation:.2f}"
        elif correlation * max(spread) / min(spread) < _SLOPE_MAX:
            return Comparison(quantity=quantity, answer="agree")
    return Comparison(quantity=quantity, answer="contradict", line=line.format(why=why))
