"""A route as its file declares it. Positions are metres in NED, so up is negative."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import Field, field_validator, model_validator

from trimtab.host.base.bounds import WAYPOINTS
from trimtab.host.route.gates import Gate
from trimtab.host.route.shapes import Shape
from trimtab.host.vehicle.canonical_toml import write_toml
from trimtab.host.vehicle.model import Geofence, Interval, Limits, Name, Positive, Positive3, Vector3
from trimtab.host.vehicle.strict_toml import Strict

LEG_MIN_M = 1e-3
"""Least distance between consecutive waypoints."""


def _increasing(values: Sequence[float]) -> bool:
    """Return whether each value is above the previous one."""
    return all(a < b for a, b in itertools.pairwise(values))


class YawProfile(Strict):
    """Heading over time: one value, or values at given times with a smooth turn between them.

    free: a plan by shooting chooses the heading. It starts at yaw_deg and turns at most at rate_max_rad_s.
    """

    yaw_deg: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0,)
    times_s: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0,)
    free: bool | None = None
    rate_max_rad_s: Positive | None = None

    @model_validator(mode="after")
    def _one_time_each(self) -> Self:
        if len(self.yaw_deg) != len(self.times_s):
            raise ValueError(
                f"{len(self.yaw_deg)} headings but {len(self.times_s)} times_s, give one time each"
            )
        if self.times_s[0] != 0.0 or not _increasing(self.times_s):
            raise ValueError("times_s must start at 0 and increase, mend them")
        return self

    @model_validator(mode="after")
    def _free_or_given(self) -> Self:
        if self.free and self.rate_max_rad_s is None:
            raise ValueError("free: a free heading needs rate_max_rad_s, add it")
        if not self.free and self.rate_max_rad_s is not None:
            raise ValueError("rate_max_rad_s: only a free heading has it, add free = true or leave it out")
        if self.free and len(self.yaw_deg) > 1:
            raise ValueError(
                f"yaw_deg: {len(self.yaw_deg)} headings, but free; give the one it starts with, or no free"
            )
        return self

    def nodes(self) -> tuple[tuple[float, float, float], ...]:
        """Return (t_s, yaw, yaw rate), radians, for cubic Hermite pieces: rest at the ends, no overshoot."""
        yaw = [math.radians(value) for value in self.yaw_deg]
        slopes = [
            (y1 - y0) / (t1 - t0)
            for y0, y1, t0, t1 in zip(yaw, yaw[1:], self.times_s, self.times_s[1:], strict=False)
        ]
        inner = [2.0 * a * b / (a + b) if a * b > 0.0 else 0.0 for a, b in itertools.pairwise(slopes)]
        rates = [0.0, *inner, 0.0][: len(yaw)]
        return tuple(zip(self.times_s, yaw, rates, strict=True))

    def rate_max(self) -> float:
        """Return the largest yaw rate of the profile, rad/s."""
        largest = 0.0
        rows = self.nodes()
        for (t0, y0, r0), (t1, y1, r1) in itertools.pairwise(rows):
            slope = (y1 - y0) / (t1 - t0)
            for s in (k / 16 for k in range(17)):
                rate = 6 * s * (1 - s) * slope + (1 - s) * (1 - 3 * s) * r0 + s * (3 * s - 2) * r1
                largest = max(largest, abs(rate))
        return largest


class LimitsOverride(Strict):
    """Limits of a route, tighter than the vehicle's."""

    speed_max_m_s: Positive | None = None
    tilt_max_deg: Positive | None = None
    body_rate_max_rad_s: Positive3 | None = None
    jerk_max_m_s3: Positive | None = None
    thrust_headroom: Interval | None = None
    geofence_m: Geofence | None = None

    def applied_to(self, limits: Limits) -> Limits:
        """Return the vehicle's limits, replaced by those that are set here."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return limits.model_copy(update={name: value for name, value in values.items() if value is not None})


class Route(Strict):
    """Waypoints to pass in order, from rest to rest. Exactly one of times_s and total_time_s is set.

    gates: waypoints that may be passed at a distance. start_velocity_m_s, end_velocity_m_s: NED, for a route
    that does not start or end at rest. The route's text and id hold only those that are set.
    """

    name: Name
    waypoints_m: Annotated[tuple[Vector3, ...], Field(min_length=2, max_length=WAYPOINTS.limit)]
    times_s: tuple[float, ...] | None = None
    total_time_s: Positive | None = None
    yaw: YawProfile = YawProfile()
    limits: LimitsOverride = LimitsOverride()
    keep_out: tuple[Shape, ...] = ()
    gates: tuple[Gate, ...] | None = None
    start_velocity_m_s: Vector3 | None = None
    end_velocity_m_s: Vector3 | None = None

    @field_validator("waypoints_m")
    @classmethod
    def _legs_have_length(cls, value: tuple[Vector3, ...]) -> tuple[Vector3, ...]:
        for k in range(1, len(value)):
            if math.dist(value[k - 1], value[k]) < LEG_MIN_M:
                raise ValueError(f"waypoints {k - 1} and {k} are the same point, leave one out")
        return value

    @model_validator(mode="after")
    def _timed_once(self) -> Self:
        if (self.times_s is None) == (self.total_time_s is None):
            raise ValueError("give either total_time_s or times_s (one time a waypoint), and not both")
        if self.times_s is not None:
            if len(self.times_s) != len(self.waypoints_m):
                raise ValueError(
                    f"{len(self.times_s)} times_s for {len(self.waypoints_m)} waypoints_m, give one time each"
                )
            if self.times_s[0] != 0.0 or not _increasing(self.times_s):
                raise ValueError("times_s must start at 0 and increase, mend them")
        return self

    @model_validator(mode="after")
    def _gates_have_waypoints(self) -> Self:
        last, taken = len(self.waypoints_m) - 1, dict[int, int]()
        for number, gate in enumerate(self.gates or ()):
            path, k = f"gates[{number}].waypoint", gate.waypoint
            if not 0 < k < last:
                remedy = f"give one of 1 to {last - 1}" if last > 1 else "leave the gate out"
                raise ValueError(f"{path}: {k} is no waypoint between the first and the last, {remedy}")
            if k in taken:
                raise ValueError(f"{path}: waypoint {k} has gates[{taken[k]}] already, keep one of them")
            taken[k] = number
        return self

    @property
    def duration_s(self) -> float:
        """Time from the first waypoint to the last."""
        return self.times_s[-1] if self.times_s is not None else self.total_time_s or 0.0

    @property
    def length_m(self) -> float:
        """Length of the straight legs."""
        return sum(math.dist(a, b) for a, b in zip(self.waypoints_m, self.waypoints_m[1:], strict=False))

    @property
    def end_velocities_ned(self) -> tuple[Vector3, Vector3]:
        """Velocity at the start and at the end, m/s."""
        rest = (0.0, 0.0, 0.0)
        return self.start_velocity_m_s or rest, self.end_velocity_m_s or rest

    @property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256 of the canonical text."""
        return hashlib.sha256(self.to_toml().encode()).hexdigest()[:12]

    def to_toml(self) -> str:
        """Canonical TOML text of the expanded route; reads back equal."""
        return write_toml(self)
