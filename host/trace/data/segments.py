"""Segments of flights on a regular grid, with their measurements and commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

BIN_S = 0.1
"""Length of a bin of the disturbance."""

PATH_S = 0.02
"""Step of the measured paths. States that effects add (`Effect.memory`) are integrated along them."""


@dataclass(frozen=True, kw_only=True)
class Segments:
    """Segments of equal length, with their measurements and commands.

    Attributes
    ----------
    dt_s
        Step of the grid.
    flight
        Index of the flight of each segment.
    start_s
        Start since tracking began.
    x0
        Initial states: p, v NED, Euler angles Theta, body rate FRD.
    p_ned, R_ned_frd
        Position in m and attitude, row-major, of the pose nearest to each grid point. Where no pose is within
        half a step, the position is interpolated, and the attitude is that of the nearest pose.
    shift_s
        Time from the grid point to that pose; 0 where there is none.
    pose_weight, rate_weight, force_weight
        Weights of pose, body rate and specific force; 0 where there is no measurement.
    rate_frd, force_frd
        Body rate in rad/s and specific force in m/s^2, means over each step.
    command
        Motor commands, or rotor thrusts in N if `in_newton`, means over each step. Those before the last
        `steps` are the run-up of the rotors.
    voltage_ratio
        Battery voltage over full voltage.
    sigma
        Standard deviations: position m, attitude rad, body rate rad/s, specific force m/s^2.
    disturbance_frd
        Disturbance about which roll-outs are linearised: specific force m/s^2, then angular
        acceleration rad/s^2. It keeps roll-outs close to the measurements whatever the model lacks.
    path_start_s
        Start of each segment on the measured path of its flight.
    paths
        Measured states of whole flights every PATH_S, with body rate 0.
    in_newton
        Whether commands are rotor thrusts in N.
    rate_driven
        Whether the measured body rate drives the attitude instead of the commanded torque, for logs that
        declare the torque unknown.
    """

    dt_s: float
    flight: Annotated[np.ndarray, "segments"]
    start_s: Annotated[np.ndarray, "segments"]
    x0: Annotated[np.ndarray, "segments 12"]
    p_ned: Annotated[np.ndarray, "segments steps 3"]
    R_ned_frd: Annotated[np.ndarray, "segments steps 9"]
    shift_s: Annotated[np.ndarray, "segments steps"]
    pose_weight: Annotated[np.ndarray, "segments steps"]
    rate_frd: Annotated[np.ndarray, "segments steps 3"]
    rate_weight: Annotated[np.ndarray, "segments steps"]
    force_frd: Annotated[np.ndarray, "segments steps 3"]
    force_weight: Annotated[np.ndarray, "segments steps"]
    command: Annotated[np.ndarray, "segments commands 4"]
    voltage_ratio: Annotated[np.ndarray, "segments steps"]
    sigma: Annotated[np.ndarray, "segments 4"]
    disturbance_frd: Annotated[np.ndarray, "segments bins 6"]
    path_start_s: Annotated[np.ndarray, "segments"]
    paths: Annotated[np.ndarray, "flights samples 12"]
    in_newton: bool
    rate_driven: bool

    def __post_init__(self) -> None:
        steps = self.p_ned.shape[1]
        per_bin = BIN_S / self.dt_s
        if abs(per_bin - round(per_bin)) > 1e-9 or steps % round(per_bin):
            raise ValueError(f"{steps} steps of {self.dt_s} s do not fill whole bins of {BIN_S} s")
        if self.command.shape[1] <= steps:
            raise ValueError("commands must begin before the segment: the motor lag needs a run-up")

    @property
    def steps(self) -> int:
        """Number of steps in a segment."""
        return self.p_ned.shape[1]

    @property
    def bins(self) -> int:
        """Number of disturbance bins in a segment."""
        return round(self.steps * self.dt_s / BIN_S)

    @property
    def measured_values(self) -> int:
        """Number of measured values: three for each position, attitude, body rate and specific force."""
        weights = (self.pose_weight, self.pose_weight, self.rate_weight, self.force_weight)
        return 3 * sum(int(np.count_nonzero(weight)) for weight in weights)

    def with_x0(self, x0: Annotated[np.ndarray, "segments 12"]) -> Segments:
        """Return the same segments with other initial states."""
        return replace(self, x0=x0)

    def with_w(self, w: Annotated[np.ndarray, "segments bins 6"]) -> Segments:
        """Return the same segments, linearised about another disturbance w, FRD."""
        return replace(self, disturbance_frd=w)

    def take(self, index: Any) -> Segments:
        """Return the segments at `index` (slice, mask or integers)."""
        shared = ("dt_s", "paths", "in_newton", "rate_driven")
        return replace(self, **{k: v[index] for k, v in vars(self).items() if k not in shared})

    def of_flight(self, flight: int, segments: Annotated[np.ndarray, "part"]) -> Segments:
        """Return segments of one flight, given by their indices, alone with its measured path."""
        part = self.take(segments)
        return replace(part, flight=np.zeros_like(part.flight), paths=self.paths[flight : flight + 1])
