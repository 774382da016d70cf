"""Consistency checks of a recording, which detect wrong axes and units.

Tracing would explain a log that was read in a wrong frame by effects that do not exist. These checks compare
the attitude with gyro, accelerometer and position. The bounds are wide: errors of a bad sensor pass, but a
swapped axis, a wrong sign or a wrong unit does not.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.imports.recording import ImportFormatError, Recording

_STEP_S = 0.1
_CORRELATION_MIN = 0.3
"""Least correlation of two measurements of the same quantity."""

_SLOPE_MAX = 3.0
"""Greatest slope between two measurements of the same quantity.

Noise makes the standard deviation of one larger, so the regression that allows for it is taken.
"""

_MOVING = {"rate": 0.15, "acceleration": 0.4}
"""Standard deviation, rad/s and m/s^2, from which two measurements can be compared."""


def check(recording: Recording, span_us: tuple[int, int]) -> None:
    """Raise ImportFormatError with every inconsistency during the time in the air."""
    begin_s, end_s = span_us[0] * 1e-6, span_us[1] * 1e-6
    pose_s = recording.pose_us * 1e-6
    t_s = np.arange(begin_s, end_s - 1e-9, _STEP_S)
    near = np.clip(np.searchsorted(pose_s, t_s), 0, len(pose_s) - 1)
    R = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True).as_matrix()
    problems = []
    if np.median(R[:, 2, 2]) < 0.0:
        problems.append("the vehicle flies upside down: check the attitude, world and body axes")
    else:
        problems += _accelerations(recording, pose_s, t_s, R)
    problems += _rates(recording, pose_s, t_s)
    problems += _forces(recording, pose_s, t_s)
    if problems:
        raise ImportFormatError("\n".join(f"{recording.source}: {line}" for line in problems))


def _rates(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray) -> list[str]:
    """Return inconsistencies between the gyro and the change of the attitude, for each axis."""
    if recording.gyro is None or recording.imu_us is None:
        return []
    near = np.unique(np.clip(np.searchsorted(pose_s, t_s), 0, len(pose_s) - 1))
    turn = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True)
    edges_s = pose_s[near]
    turned = (turn[:-1].inv() * turn[1:]).as_rotvec() / np.diff(edges_s)[:, None]
    measured = _means(edges_s, recording.imu_us * 1e-6, recording.gyro)
    return [
        f"the gyro's {axis} axis does not match the attitude ({why}): check body axes and units"
        for i, axis in enumerate("xyz")
        if (why := _differ(turned[:, i], measured[:, i], _MOVING["rate"]))
    ]


def _forces(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray) -> list[str]:
    """Return an inconsistency of the mean specific force with gravity; its mean is weight over a flight."""
    if recording.specific_force is None or recording.imu_us is None:
        return []
    imu_s = recording.imu_us * 1e-6
    inside = (imu_s >= t_s[0]) & (imu_s <= t_s[-1])
    near = np.clip(np.searchsorted(pose_s, imu_s[inside]), 0, len(pose_s) - 1)
    R = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True).as_matrix()
    mean = np.einsum("nij,nj->i", R, recording.specific_force[inside]) / max(1, inside.sum())
    if np.linalg.norm(mean + np.array([0.0, 0.0, GRAVITY])) < GRAVITY / 3.0:
        return []
    north, east, down = mean
    return [
        f"the accelerometer averages {north:.2f} north, {east:.2f} east, {-down:.2f} up in m/s^2 instead of "
        "9.81 up: check its unit and the body axes"
    ]


def _accelerations(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray, R: np.ndarray) -> list[str]:
    """Return inconsistencies between horizontal acceleration and the tilt of the thrust, north and east."""
    problems = []
    for i, axis in enumerate(("north", "east")):
        p = _means(t_s, pose_s, recording.p_ned[:, i : i + 1])[:, 0]
        second = (p[2:] - 2.0 * p[1:-1] + p[:-2]) / _STEP_S**2
        lean = -GRAVITY * R[:, i, 2] / np.maximum(R[:, 2, 2], 0.2)
        # Both are filtered with the same triangle, so that fast changes look the same.
        middle = 0.25 * lean[:-3] + 0.5 * lean[1:-2] + 0.25 * lean[2:-1]
        even = 0.25 * lean[1:-2] + 0.5 * lean[2:-1] + 0.25 * lean[3:]
        why = _differ(0.5 * (middle + even), second, _MOVING["acceleration"])
        if why:
            problems.append(
                f"the acceleration {axis} does not match the tilt of the attitude ({why}): "
                "check world axes and units"
            )
    return problems


def _means(edges_s: np.ndarray, t_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return means (n, k) of sampled values between edges (n + 1,), by the trapezoid rule."""
    out = np.empty((len(edges_s) - 1, values.shape[1]))
    for i in range(values.shape[1]):
        area = np.r_[0.0, np.cumsum(0.5 * (values[1:, i] + values[:-1, i]) * np.diff(t_s))]
        out[:, i] = np.diff(np.interp(edges_s, t_s, area)) / np.diff(edges_s)
    return out


def _differ(a: np.ndarray, b: np.ndarray, moving: float) -> str:
    """Return how two measurements of the same quantity differ; empty if they agree or hardly change."""
    spread = float(np.std(a)), float(np.std(b))
    if len(a) < 10 or max(spread) < moving:
        return ""
    if not 0.0 < min(spread) <= max(spread) < np.inf:
        return f"{spread[1]:.3g} against {spread[0]:.3g}"
    correlation = float(np.mean((a - a.mean()) * (b - b.mean())) / (spread[0] * spread[1]))
    if not correlation > _CORRELATION_MIN:
        return f"correlation {correlation:.2f}"
    slope = correlation * max(spread) / min(spread)
    return "" if slope < _SLOPE_MAX else f"{spread[1]:.3g} against {spread[0]:.3g}"
