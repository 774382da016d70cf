"""Pitch of a foreign log that leaves it out, rebuilt from the direction of the thrust.

The thrust points along acceleration less gravity. Drag is neglected, so the rebuilt pitch is off by drag over
weight: such a log does not show drag along the nose.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy.signal import savgol_filter

from trimtab.firmware_model.law.constants import GRAVITY

POSITIONS_WINDOW_S = 0.3
"""Time over which the acceleration of positions is estimated: a parabola is fitted to it."""

ACCELERATION_WINDOW_S = 0.15
"""Time over which logged accelerations are averaged.

On ten flights of a Crazyflie whose roll is logged, roll rebuilt with 0.09 to 0.15 s is closest to it.
"""


def acceleration_of_positions(
    t_s: Annotated[np.ndarray, "poses"], p: Annotated[np.ndarray, "poses 3"]
) -> Annotated[np.ndarray, "poses 3"]:
    """Return the acceleration, m/s^2, of positions, m, in their frame, at their times."""
    return _filtered(t_s, p, POSITIONS_WINDOW_S, order=2, derivative=2)


def averaged_acceleration(
    t_s: Annotated[np.ndarray, "times"], a: Annotated[np.ndarray, "times 3"]
) -> Annotated[np.ndarray, "times 3"]:
    """Return logged accelerations without the vibration of the rotors."""
    return _filtered(t_s, a, ACCELERATION_WINDOW_S, order=0, derivative=0)


def pitch_from_acceleration(
    a_nwu: Annotated[np.ndarray, "times 3"],
    roll: Annotated[np.ndarray, "times"],
    yaw: Annotated[np.ndarray, "times"],
    flying: Annotated[np.ndarray, "times"],
) -> tuple[Annotated[np.ndarray, "times"], float]:
    """Return the pitch, rad, with which the thrust points along acceleration and gravity, and its error.

    The error is a standard deviation, rad: that of roll, rebuilt in the same way, from the roll that was
    logged, about their mean.

    Parameters
    ----------
    a_nwu
        Acceleration without gravity, m/s^2.
    roll, yaw
        Logged angles, rad, ZYX, from FLU to NWU.
    flying
        Mask of the times in the air. Flights begin and end at rest, so the mean acceleration ahead over them
        is the bias of an accelerometer and is subtracted.
    """
    ahead = a_nwu[:, 0] * np.cos(yaw) + a_nwu[:, 1] * np.sin(yaw)
    left = a_nwu[:, 1] * np.cos(yaw) - a_nwu[:, 0] * np.sin(yaw)
    up = np.maximum(GRAVITY + a_nwu[:, 2], 0.1 * GRAVITY)
    used = flying if flying.any() else np.ones(len(roll), dtype=bool)
    ahead = ahead - ahead[used].mean()
    error = -np.arctan2(left, np.hypot(ahead, up)) - roll
    return np.arctan2(ahead, up), float(np.std(error[used]))


def _filtered(
    t_s: np.ndarray, values: np.ndarray, window_s: float, *, order: int, derivative: int
) -> np.ndarray:
    """Return the derivative of a polynomial fitted to each window of `values` (times, k), at their times."""
    step_s = float(np.median(np.diff(t_s)))
    grid_s = np.arange(t_s[0], t_s[-1] + 0.5 * step_s, step_s)
    even = np.column_stack([np.interp(grid_s, t_s, column) for column in values.T])
    window = min(max(2 * order + 1, 2 * round(0.5 * window_s / step_s) + 1), (len(grid_s) - 1) // 2 * 2 + 1)
    if window <= order:
        return np.zeros_like(values, dtype=float)
    smooth = np.asarray(savgol_filter(even, window, order, deriv=derivative, delta=step_s, axis=0))
    return np.column_stack([np.interp(t_s, grid_s, column) for column in smooth.T])
