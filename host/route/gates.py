"""Gates of a route: waypoints that may be passed anywhere in a sphere or in an upright opening."""

from __future__ import annotations

import math
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from trimtab.host.vehicle.model import Positive
from trimtab.host.vehicle.strict_toml import Strict

Array = NDArray[np.float64]

_INSET_M = 0.01
_INSET_SHARE = 0.1
"""Distance that a plan keeps inside a gate's edge; a share of the half size where that is less."""


class Gate(Strict):
    """A waypoint that need not be met exactly: a sphere around it, or an upright rectangle centred on it.

    waypoint: its number from 0, neither the first nor the last. heading_deg: of the rectangle's horizontal
    normal, 0 north, 90 east. The path may cross its plane in either direction. The edges bound the vehicle's
    centre.
    """

    waypoint: int
    radius_m: Positive | None = None
    width_m: Positive | None = None
    height_m: Positive | None = None
    heading_deg: float | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        opening = [self.width_m, self.height_m, self.heading_deg]
        given = sum(value is not None for value in opening)
        if given != (3 if self.radius_m is None else 0):
            raise ValueError("give either radius_m, or width_m, height_m and heading_deg")
        return self

    @property
    def is_sphere(self) -> bool:
        """Whether the gate is a sphere; else it is an opening."""
        return self.radius_m is not None

    @property
    def _halves_m(self) -> Array:
        """Half width and half height (2,); for a sphere twice the radius, as (r, r)."""
        if self.radius_m is not None:
            return np.array([self.radius_m, self.radius_m])
        return np.array([0.5 * (self.width_m or 0.0), 0.5 * (self.height_m or 0.0)])

    def _axes(self) -> Array:
        """Return the axes (3, 3) as rows in NED: normal, right, down."""
        heading = math.radians(self.heading_deg or 0.0)
        cos, sin = math.cos(heading), math.sin(heading)
        return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def corners_ned(self, waypoint_ned: ArrayLike) -> Annotated[np.ndarray, "4 3"]:
        """Return the corners of an opening, in order around it. Raises ValueError for a sphere."""
        if self.is_sphere:
            raise ValueError("a sphere has no corners")
        wide, high = self._halves_m
        around = np.array([[-wide, -high], [wide, -high], [wide, high], [-wide, high]])
        return np.asarray(waypoint_ned, dtype=float) + around @ self._axes()[1:]

    def frame(self) -> Annotated[np.ndarray, "3 3"]:
        """Return the matrix from an NED offset to coordinates q in which a plan's bounds are units.

        In a sphere |q| <= 1. In an opening q[0], along the normal in metres, is 0, and q[1] and q[2], right
        and down, are within -1 to 1.
        """
        return self._axes() / self._units_m()[:, None]

    def _units_m(self) -> Array:
        """Return the lengths (3,) of a unit of q, m."""
        wide, high = self._halves_m - np.minimum(_INSET_M, _INSET_SHARE * self._halves_m)
        return np.array([wide if self.is_sphere else 1.0, wide, high])

    def nearest(self, p_ned: ArrayLike, waypoint_ned: ArrayLike) -> Annotated[np.ndarray, "3"]:
        """Return the point that a plan may pass nearest to p_ned, along each axis of the gate."""
        centre = np.asarray(waypoint_ned, dtype=float)
        q = self.frame() @ (np.asarray(p_ned, dtype=float) - centre)
        if self.is_sphere:
            q /= max(1.0, float(np.linalg.norm(q)))
        else:
            q = np.array([0.0, *np.clip(q[1:], -1.0, 1.0)])
        return centre + self._axes().T @ (self._units_m() * q)

    def inside_m(self, p_ned: ArrayLike, waypoint_ned: ArrayLike) -> float:
        """Return the distance inside the gate's edge, m, less that from its plane; negative outside."""
        along, right, down = self._axes() @ (np.asarray(p_ned, dtype=float) - waypoint_ned)
        wide, high = self._halves_m
        if self.is_sphere:
            return float(wide - math.hypot(along, right, down))
        return float(min(wide - abs(right), high - abs(down)) - abs(along))
