"""Whether a recording's parts agree with each other as one flight: wrong axes and units show here.

A log read in the wrong frame still holds numbers, and tracing would name an effect for each. Here attitude is
held against gyro, accelerometer and position. The bounds are wide: what a bad sensor does passes, what a
swapped axis, a wrong sign or a wrong unit does not.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.imports.recording import ImportFormatError, Recording

_STEP_S = 0.1
_ALIKE = 0.3
"""Least correlation of two measurements of one thing."""

_SCALE = 3.0
"""Largest factor between the sizes of two measurements of one thing."""

_MOVING = {"rate": 0.15, "acceleration": 0.4}
"""Standard deviation in rad/s and m/s^2 from which two measurements can be told alike."""


def check(recording: Recording, span_us: tuple[int, int]) -> None:
    """Raise ImportFormatError with every contradiction within the time in the air."""
    begin_s, end_s = span_us[0] * 1e-6, span_us[1] * 1e-6
    pose_s = recording.pose_us * 1e-6
    t_s = np.arange(begin_s, end_s - 1e-9, _STEP_S)
    near = np.clip(np.searchsorted(pose_s, t_s), 0, len(pose_s) - 1)
    R = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True).as_matrix()
    found = []
    if np.median(R[:, 2, 2]) < 0.0:
        found.append("the vehicle flies upside down: check the attitude, world and body axes")
    else:
        found += _accelerations(recording, pose_s, t_s, R)
    found += _rates(recording, pose_s, t_s)
    found += _forces(recording, pose_s, t_s)
    if found:
        raise ImportFormatError("\n".join(f"{recording.source}: {line}" for line in found))


def _rates(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray) -> list[str]:
    """Gyro against the turning of the attitude, each axis."""
    if recording.gyro is None or recording.imu_us is None:
        return []
    near = np.unique(np.clip(np.searchsorted(pose_s, t_s), 0, len(pose_s) - 1))
    turn = Rotation.from_quat(recording.q_ned_frd[near], scalar_first=True)
    edges_s = pose_s[near]
    turned = (turn[:-1].inv() * turn[1:]).as_rotvec() / np.diff(edges_s)[:, None]
    felt = _means(edges_s, recording.imu_us * 1e-6, recording.gyro)
    return [
        f"the gyro's {axis} axis does not turn as the attitude does ({why}): check body axes and units"
        for i, axis in enumerate("xyz")
        if (why := _differ(turned[:, i], felt[:, i], _MOVING["rate"]))
    ]


def _forces(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray) -> list[str]:
    """Return the accelerometer's mean in the world against weight: over a flight, velocity hardly changes."""
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
        f"the accelerometer averages {north:.2f} north, {east:.2f} east, {-down:.2f} up in m/s^2 where "
        "9.81 up is due: check its unit and the body axes"
    ]


def _accelerations(recording: Recording, pose_s: np.ndarray, t_s: np.ndarray, R: np.ndarray) -> list[str]:
    """Horizontal acceleration of the positions against the tilt of the thrust, north and east."""
    found = []
    for i, axis in enumerate(("north", "east")):
        p = _means(t_s, pose_s, recording.p_ned[:, i : i + 1])[:, 0]
        second = (p[2:] - 2.0 * p[1:-1] + p[:-2]) / _STEP_S**2
        lean = -GRAVITY * R[:, i, 2] / np.maximum(R[:, 2, 2], 0.2)
        # Both pass the same triangle in time, so that a quick change looks alike in both.
        middle = 0.25 * lean[:-3] + 0.5 * lean[1:-2] + 0.25 * lean[2:-1]
        even = 0.25 * lean[1:-2] + 0.5 * lean[2:-1] + 0.25 * lean[3:]
        why = _differ(0.5 * (middle + even), second, _MOVING["acceleration"])
        if why:
            found.append(
                f"positions do not accelerate {axis} as the attitude leans ({why}): "
                "check world axes and units"
            )
    return found


def _means(edges_s: np.ndarray, t_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Means (n, k) of sampled values between edges (n + 1,), by the trapezoid rule."""
    out = np.empty((len(edges_s) - 1, values.shape[1]))
    for i in range(values.shape[1]):
        area = np.r_[0.0, np.cumsum(0.5 * (values[1:, i] + values[:-1, i]) * np.diff(t_s))]
        out[:, i] = np.diff(np.interp(edges_s, t_s, area)) / np.diff(edges_s)
    return out


def _differ(a: np.ndarray, b: np.ndarray, moving: float) -> str:
    """Why two measurements of one thing are not alike, empty where they are or hardly move."""
    spread = float(np.std(a)), float(np.std(b))
    if len(a) < 10 or max(spread) < moving:
        return ""
    if not max(spread) < _SCALE * min(spread):
        return f"{spread[1]:.3g} against {spread[0]:.3g}"
    alike = float(np.mean((a - a.mean()) * (b - b.mean())) / (spread[0] * spread[1]))
    return "" if alike > _ALIKE else f"correlation {alike:.2f}"
