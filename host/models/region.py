"""The trained region of a model: speed, tilt and collective thrust. Outside it the model extrapolates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Region:
    """Greatest speed and tilt of the data, and its range of collective thrust."""

    speed_max_m_s: float
    tilt_max_deg: float
    thrust_min_n: float
    """Least and greatest collective thrust."""
    thrust_max_n: float

    def __post_init__(self) -> None:
        numbers = (self.speed_max_m_s, self.tilt_max_deg, self.thrust_min_n, self.thrust_max_n)
        if not all(math.isfinite(number) and number >= 0.0 for number in numbers):
            raise ValueError(f"a region's numbers must be finite and >= 0, got {numbers}")
        if self.thrust_min_n > self.thrust_max_n:
            raise ValueError(f"thrust range {self.thrust_min_n}..{self.thrust_max_n} N is empty")

    @classmethod
    def of(cls, x: Annotated[np.ndarray, "samples _"], thrust: Annotated[np.ndarray, "samples"]) -> Region:
        """Return the region of states, 12 columns or more, with collective thrusts, N."""
        return cls(
            speed_max_m_s=float(_speed(x).max()),
            tilt_max_deg=float(_tilt_deg(x).max()),
            thrust_min_n=float(thrust.min()),
            thrust_max_n=float(thrust.max()),
        )

    @classmethod
    def measured(
        cls,
        speed_m_s: Annotated[np.ndarray, "speeds"],
        tilt_cosine: Annotated[np.ndarray, "tilts"],
        thrust: Annotated[np.ndarray, "..."],
    ) -> Region:
        """Return the region of measured data, without the thousandth of each kind that is farthest out.

        tilt_cosine: down component of the vehicle's down axis. thrust: nominal collective thrusts, N;
        negative ones count as 0.
        """
        tilt = np.arccos(np.clip(tilt_cosine, -1.0, 1.0))
        thrust = np.maximum(thrust, 0.0)
        return cls(
            speed_max_m_s=float(np.quantile(speed_m_s, 0.999)),
            tilt_max_deg=float(np.rad2deg(np.quantile(tilt, 0.999))),
            thrust_min_n=float(np.quantile(thrust, 0.001)),
            thrust_max_n=float(np.quantile(thrust, 0.999)),
        )

    def outside(
        self, x: Annotated[np.ndarray, "samples _"], thrust: Annotated[np.ndarray, "samples"]
    ) -> Annotated[np.ndarray, "samples"]:
        """Return whether states, 12 columns or more, with collective thrusts, N, are outside."""
        return (
            (_speed(x) > self.speed_max_m_s)
            | (_tilt_deg(x) > self.tilt_max_deg)
            | (thrust < self.thrust_min_n)
            | (thrust > self.thrust_max_n)
        )


def _speed(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x[:, 3:6], axis=1)


def _tilt_deg(x: np.ndarray) -> np.ndarray:
    return np.rad2deg(np.arccos(np.clip(np.cos(x[:, 6]) * np.cos(x[:, 7]), -1.0, 1.0)))
