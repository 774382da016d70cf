"""Segments of flights on a regular grid: what was measured and commanded in each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

BIN_S = 0.1


PATH_S = 0.02
"""Step of the measured paths along which the effects' own states are found."""


@dataclass(frozen=True, kw_only=True)
class Segments:
    """S segments of H steps with what was measured and commanded in them.

    flight (S,); start_s (S,) since arm; x0 (S, 12) p, v, Theta, rate; p_ned (S, H, 3);
    R_ned_frd (S, H, 9); shift_s (S, H) time of the pose after its grid point; pose_weight and rate_weight
    (S, H) 0 or 1; rate_frd and force_frd (S, H, 3) means over the step, force_weight (S, H); command (S, pre
    + H, 4) motor command, or rotor thrust in N where `in_newton`; voltage_ratio (S, H). sigma (S, 4):
    position m, attitude rad, body rate rad/s, specific force m/s^2. `rate_driven`: the measured body rate is
    an input instead of the commanded torque, for logs that declare the torque unknown. disturbance_frd (S,
    bins, 6): that the roll-outs are linearised at, so that they stay near what was measured whatever the
    parameters lack. paths (flights, n, 12): measured state of whole flights each PATH_S, from rest;
    path_start_s (S,) into them.
    """

    dt_s: float
    flight: np.ndarray
    start_s: np.ndarray
    x0: np.ndarray
    p_ned: np.ndarray
    R_ned_frd: np.ndarray
    shift_s: np.ndarray
    pose_weight: np.ndarray
    rate_frd: np.ndarray
    rate_weight: np.ndarray
    force_frd: np.ndarray
    force_weight: np.ndarray
    command: np.ndarray
    voltage_ratio: np.ndarray
    sigma: np.ndarray
    disturbance_frd: np.ndarray
    path_start_s: np.ndarray
    paths: np.ndarray
    in_newton: bool
    rate_driven: bool

    def __post_init__(self) -> None:
        steps = self.p_ned.shape[1]
        per_bin = BIN_S / self.dt_s
        if abs(per_bin - round(per_bin)) > 1e-9 or steps % round(per_bin):
            raise ValueError(f"{steps} steps of {self.dt_s} s do not fill whole bins of {BIN_S} s")
        if self.command.shape[1] <= steps:
            raise ValueError("the command must begin before the segment: the rotors' lag needs a run-up")

    @property
    def steps(self) -> int:
        """Steps H of a segment."""
        return self.p_ned.shape[1]

    @property
    def bins(self) -> int:
        """Disturbance bins of a segment."""
        return round(self.steps * self.dt_s / BIN_S)

    def with_x0(self, x0: np.ndarray) -> Segments:
        """Return the same segments starting from other initial states (S, 12)."""
        return replace(self, x0=x0)

    def with_w(self, w: np.ndarray) -> Segments:
        """Return the same segments linearised at another disturbance (S, bins, 6)."""
        return replace(self, disturbance_frd=w)

    def take(self, index: Any) -> Segments:
        """Return the segments at `index` (slice, mask or integers)."""
        shared = ("dt_s", "paths", "in_newton", "rate_driven")
        return replace(self, **{k: v[index] for k, v in vars(self).items() if k not in shared})
