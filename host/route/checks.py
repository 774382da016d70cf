"""Checks that refuse routes with contradictions, before any solver starts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.route.model import Route
from trimtab.host.vehicle import ConfigurationError, Limits, Vehicle
from trimtab.host.vehicle.model import Vector3

HEIGHT_MIN_M = 0.5
"""A reference starts and ends at least this high."""

TIME_MAX_S = 500.0
"""The longest reference that fits into the vehicle's memory, with a node every 0.1 s."""


def check_route(route: Route, vehicle: Vehicle, source: str | None = None) -> Limits:
    """Return the limits that a plan for this route must keep.

    `source` names the route in errors, its name by default. Raises ConfigurationError (exit code 2) with
    every contradiction.
    """
    limits = route.limits.applied_to(vehicle.limits)
    problems = [
        *_loosened(route, vehicle.limits),
        *_hoverless(limits, vehicle),
        *_misplaced(route, limits),
        *_too_fast(route, limits),
    ]
    if problems:
        raise ConfigurationError([f"{source or route.name}: {problem}" for problem in problems])
    return limits


def _loosened(route: Route, limits: Limits) -> Iterator[str]:
    """Yield limits of the route that exceed the vehicle's; the vehicle would refuse such a reference."""
    requested = route.limits
    for name in ("speed_max_m_s", "tilt_max_deg", "jerk_max_m_s3"):
        value, bound = getattr(requested, name), getattr(limits, name)
        if value is not None and value > bound:
            yield f"limits.{name}: {value:g} is above the vehicle's {bound:g}, lower it"
    if requested.body_rate_max_rad_s is not None:
        for axis, (value, bound) in enumerate(
            zip(requested.body_rate_max_rad_s, limits.body_rate_max_rad_s, strict=True)
        ):
            if value > bound:
                name = f"limits.body_rate_max_rad_s[{axis}]"
                yield f"{name}: {value:g} is above the vehicle's {bound:g}, lower it"
    intervals = []
    if requested.thrust_headroom is not None:
        intervals.append(("thrust_headroom", requested.thrust_headroom, limits.thrust_headroom))
    if requested.geofence_m is not None:
        pairs = zip(requested.geofence_m, limits.geofence_m, strict=True)
        intervals.extend((f"geofence_m[{axis}]", *pair) for axis, pair in enumerate(pairs))
    for name, value, bound in intervals:
        if value[0] < bound[0] or value[1] > bound[1]:
            yield f"limits.{name}: {list(value)} leaves the vehicle's {list(bound)}, stay inside it"


def _hoverless(limits: Limits, vehicle: Vehicle) -> Iterator[str]:
    """Yield a thrust headroom that does not contain hover."""
    low, high = limits.thrust_headroom
    hover = vehicle.mass_kg * GRAVITY / (len(vehicle.rotors) * vehicle.thrust_max_n)
    if not low < hover < high:
        yield f"limits.thrust_headroom: [{low:g}, {high:g}] is without hover, {hover:.3f}; take that in"


def _misplaced(route: Route, limits: Limits) -> Iterator[str]:
    """Yield waypoints outside the geofence, inside a keep-out shape, or too low to start or end at.

    A waypoint of several laps is reported once.
    """
    last = len(route.waypoints_m) - 1
    reported = set[tuple[Vector3, bool]]()
    for k, point in enumerate(route.waypoints_m):
        end = k in (0, last)
        if reported & {(point, True), (point, end)}:
            continue
        reported.add((point, end))
        path = f"waypoints_m[{k}]"
        whose = "the vehicle's geofence" if route.limits.geofence_m is None else "the route's own geofence"
        for axis, (value, (low, high)) in enumerate(zip(point, limits.geofence_m, strict=True)):
            if not low <= value <= high:
                name = ("north", "east", "down")[axis]
                yield f"{path}: {name} {value:g} m is outside {whose} [{low:g}, {high:g}], move it"
        if end and -point[2] < HEIGHT_MIN_M:
            yield f"{path}: starts or ends {-point[2]:g} m up, move it to down <= -{HEIGHT_MIN_M:g}"
        elif point[2] > 0.0:
            yield f"{path}: lies below the floor (down {point[2]:g} m), move it up"
        for number, shape in enumerate(route.keep_out):
            depth = -shape.signed_distance(FLOAT, point)
            if depth > 0.0:
                yield f"{path}: lies {depth:.2f} m inside keep_out[{number}] ({shape.kind}), move one of them"


def _too_fast(route: Route, limits: Limits) -> Iterator[str]:
    """Yield a route that is too long for the vehicle's memory, and speeds and turns above the limits."""
    if route.duration_s > TIME_MAX_S:
        key = "times_s" if route.times_s is not None else "total_time_s"
        yield (
            f"{key}: {route.duration_s:g} s do not fit into the vehicle's memory, give at most {TIME_MAX_S:g}"
        )
    legs = list(pairwise(route.waypoints_m))
    speed = limits.speed_max_m_s
    for end, velocity in zip(("start", "end"), route.end_velocities_ned, strict=True):
        if math.hypot(*velocity) > speed:
            yield f"{end}_velocity_m_s: {math.hypot(*velocity):.4g} m/s, the limit is {speed:g}; lower it"
    if route.times_s is not None:
        checked = set[tuple[Vector3, Vector3, float]]()
        for k, ((a, b), (t0, t1)) in enumerate(zip(legs, pairwise(route.times_s), strict=True)):
            if (leg := (a, b, round(t1 - t0, 6))) in checked:
                continue
            checked.add(leg)
            needed = math.dist(a, b) / (t1 - t0)
            if needed > speed:
                yield f"times_s[{k + 1}]: leg {k} needs {needed:.1f} m/s, the limit is {speed:g}; slow down"
    elif route.length_m / route.duration_s > speed:
        yield (
            f"total_time_s: {route.length_m:.1f} m in {route.duration_s:g} s needs "
            f"{route.length_m / route.duration_s:.1f} m/s, the limit is {speed:g}; give it more time"
        )
    yaw_end_s = route.yaw.times_s[-1]
    if yaw_end_s > route.duration_s:
        yield f"yaw.times_s: ends at {yaw_end_s:g} s, the route at {route.duration_s:g} s; shorten it"
    rate, bound = route.yaw.rate_max(), limits.body_rate_max_rad_s[2]
    if route.yaw.rate_max_rad_s is not None and route.yaw.rate_max_rad_s > bound:
        given = route.yaw.rate_max_rad_s
        yield f"yaw.rate_max_rad_s: {given:g} is above the limit of the body rate, {bound:g}; lower it"
    if rate > bound:
        yield f"yaw.yaw_deg: turns at {rate:.2f} rad/s, the limit is {bound:g}; give the turn more time"
