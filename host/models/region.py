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
