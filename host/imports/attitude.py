"""Parts of the attitude that a foreign log leaves out, rebuilt from its positions."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy.signal import savgol_filter

from trimtab.firmware_model.law.constants import GRAVITY

WINDOW_S = 0.3
"""Time over which the acceleration of positions is estimated: a parabola is fitted to it."""


def pitch_from_positions(
    t_s: Annotated[np.ndarray, "poses"],
    p_nwu: Annotated[np.ndarray, "poses 3"],
    yaw: Annotated[np.ndarray, "poses"],
) -> Annotated[np.ndarray, "poses"]:
    """Return the pitch, rad, with which the thrust points along acceleration and gravity.

    Angles are ZYX, from FLU to NWU. Drag is neglected, so the pitch is off by drag over weight, and motions
    faster than the window are smoothed. Angles and times belong to the positions `p_nwu`, m.
    """
    step_s = float(np.median(np.diff(t_s)))
    grid_s = np.arange(t_s[0], t_s[-1] + 0.5 * step_s, step_s)
    even = np.column_stack([np.interp(grid_s, t_s, p_nwu[:, i]) for i in range(3)])
    window = min(max(5, 2 * round(0.5 * WINDOW_S / step_s) + 1), (len(grid_s) - 1) // 2 * 2 + 1)
    if window < 3:
        return np.zeros(len(t_s))
    a = np.asarray(savgol_filter(even, window, 2, deriv=2, delta=step_s, axis=0))
    a_t = np.column_stack([np.interp(t_s, grid_s, a[:, i]) for i in range(3)])
    ahead = a_t[:, 0] * np.cos(yaw) + a_t[:, 1] * np.sin(yaw)
    return np.arctan2(ahead, np.maximum(GRAVITY + a_t[:, 2], 0.1 * GRAVITY))
