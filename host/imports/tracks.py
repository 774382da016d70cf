"""Streams of foreign logs at their own rates, brought to common times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from trimtab.host.imports.recording import READABLE


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Values of one quantity in SI at increasing times, us since the log's first record."""

    t_us: Annotated[np.ndarray, "rows"]
    values: Annotated[np.ndarray, "rows columns"]

    def at(self, t_us: Annotated[np.ndarray, "times"]) -> Annotated[np.ndarray, "times columns"]:
        """Return the last values at or before each time; the first values before them all."""
        return self.values[np.maximum(np.searchsorted(self.t_us, t_us, side="right") - 1, 0)]


def sound_track(t_us: Annotated[np.ndarray, "rows"], values: Annotated[np.ndarray, "rows columns"]) -> Track:
    """Return the rows of finite numbers in the order of their times, the first one of each time."""
    sound = (np.abs(values) < READABLE).all(axis=1)
    t_us, values = t_us[sound], values[sound]
    order = np.argsort(t_us, kind="stable")
    t_us, values = t_us[order], values[order]
    keep = np.diff(t_us, prepend=t_us[:1] - 1) > 0
    return Track(t_us=t_us[keep], values=values[keep])


def command_shares(
    values: Annotated[np.ndarray, "rows 4"], zero: float, full: float
) -> Annotated[np.ndarray, "rows 4"]:
    """Return motor commands as shares of the full command. A stopped motor may be commanded below zero."""
    with np.errstate(over="ignore"):  # a recording refuses infinite commands
        return np.maximum((values - zero) / (full - zero), 0.0)


def turns_at(
    track_us: Annotated[np.ndarray, "rows"], turn: Rotation, t_us: Annotated[np.ndarray, "times"]
) -> Rotation:
    """Return rotations at times between those of a track; before and after them, the first and the last."""
    if len(track_us) < 2:
        return Rotation.from_quat(np.repeat(turn.as_quat(), len(t_us), axis=0))
    return Slerp(track_us, turn)(np.clip(t_us, track_us[0], track_us[-1]))
