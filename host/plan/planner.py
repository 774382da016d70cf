"""`plan`: from a route to a checked reference.

min-snap is the minimum-snap spline with optimised leg times. It ignores limits. If it breaks one, it is
refused, or stretched in time where allowed. min-control and min-residual are paper eqs. 10-11, solved by
multiple shooting within the vehicle's limits. min-error minimises the tracking error that the residual causes
in the loop of the flatness-based law (`trimtab.host.plan.tracking_error`) instead of the residual itself.

With nominal dynamics the reference is feasible for the nominal vehicle, which is what a flatness-based law
assumes (paper section IV-C.4). With augmented dynamics (`*` in the paper) the path is feasible for the
vehicle with its effects. The reference then holds that path's position, velocity, acceleration and jerk, but
the law's flat attitude and thrust for it lack the contribution of the effects. Only a law that feeds the
effects forward, or an MPC with the same model, commands the planned attitude and thrust. Either way the
limits are judged on the flat reference, as on board. min-control-r is the paper's baseline (section V-B.1):
min-control with nominal dynamics, then the path nearest to it with augmented dynamics.

The shooting problem starts on the straight lines between the waypoints; where that fails, along the min-snap
spline. A reference that breaks limits between nodes is solved again within tighter bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TypedDict, Unpack

from trimtab.host.base.errors import UsageError
from trimtab.host.base.parallel import one_thread_of_algebra
from trimtab.host.effects import Effect, load_effects
from trimtab.host.models.model import Model
from trimtab.host.plan.box import within_region
from trimtab.host.plan.clearance import ALLOWANCE_M
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.plan.heading import check_turnable
from trimtab.host.plan.job import Job
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.result import MINIMISED, Kind, Plan, Settings, label, parse_kind
from trimtab.host.plan.stretch import plan_snap
from trimtab.host.route import TIME_MAX_S, LimitsOverride, Route, check_route
from trimtab.host.route.clearance import has_obstacles, room, with_clearance
from trimtab.host.shooting.problem import NODES_MAX
from trimtab.host.vehicle import Limits, Vehicle

CLEARANCE_MAX_M = 2.0
"""The largest clearance that a plan may keep."""
_MORE = 1.1
"""Factor on the clearance that a plan's predicted error needs, for the next plan."""


class JobOptions(TypedDict, total=False):
    """Options of a plan.

    effects: library that the model's names refer to,
    the shipped one by default. headroom: limits tighter than the route's. total_time_s: instead of the
    route's. time_box: the total time is free within these shares of it, and each second costs time_weight (1
    by default), in the unit of the weights. settings: weights and tolerances. source: names the route in
    errors, its name by default.
    """

    effects: Mapping[str, Effect] | None
    headroom: LimitsOverride | None
    total_time_s: float | None
    time_box: tuple[float, float] | None
    time_weight: float | None
    clearance_m: float | None
    settings: Settings | None
    source: str | None


@one_thread_of_algebra()
def plan(
    route: Route,
    vehicle: Vehicle,
    *,
    kind: str = "min-snap",
    model: Model | ResidualModel | None = None,
    stretch: bool = False,
    nodes: int | None = None,
    **options: Unpack[JobOptions],
) -> Plan:
    """Return a checked plan for the route. The same arguments give the same reference.

    kind: one of KINDS; a final `*` puts the model into the dynamics. model: needed by
    all kinds but min-snap and min-control. stretch: a min-snap plan that breaks a
    limit takes more time. nodes: approximate number of shooting intervals, None for one about every 70 ms.
    options: see `JobOptions`.

    Raises ConfigurationError or UsageError (exit code 2) for contradictory arguments, PlanRefused (1) with
    node and reason, PlanUnsolved (4).
    """
    name, _ = parse_kind(kind)
    if nodes is not None and not 20 <= nodes <= NODES_MAX:
        raise UsageError(f"--nodes {nodes}: give a number within 20..{NODES_MAX}")
    if stretch and name != "min-snap":
        raise UsageError(f"--stretch goes with min-snap, not with {kind}: give the time with --time-s")
    job = make_job(route, vehicle, kind=kind, model=model, **options)
    is_stated = options.get("clearance_m") is not None or not has_obstacles(route)
    while True:
        made = _solve(job, stretch=stretch, nodes=nodes)
        needed_m = ALLOWANCE_M + made.predicted_error_max_m
        if is_stated or needed_m <= job.clearance_m or job.clearance_m >= CLEARANCE_MAX_M:
            return made
        # The next path is another one, and may have a little more error.
        clearance_m = min(_MORE * needed_m, CLEARANCE_MAX_M)
        job = replace(job, clearance_m=clearance_m, route=with_clearance(job.course, clearance_m))


def _solve(job: Job, *, stretch: bool, nodes: int | None) -> Plan:
    if job.kind == "min-snap":
        return plan_snap(job, stretch=stretch)
    from trimtab.host.plan.rounds import plan_shooting  # with scipy, which min-snap does not need

    return plan_shooting(job, nodes=nodes)


def make_job(
    route: Route,
    vehicle: Vehicle,
    *,
    kind: str,
    model: Model | ResidualModel | None = None,
    **options: Unpack[JobOptions],
) -> Job:
    """Return the job that `plan` solves, checked. Raises ConfigurationError or UsageError."""
    name, augmented = parse_kind(kind)
    source = options.get("source")
    settings = options.get("settings") or Settings()
    settings = _free_time(settings, route, kind, options.get("time_box"), options.get("time_weight"))
    route = _timed(route, options.get("total_time_s"))
    limits = _limits(route, vehicle, options.get("headroom"), source)
    residual = _residual_model(model, options.get("effects"), vehicle, name, augmented)
    dynamics = Dynamics(vehicle=vehicle, model=residual, augmented=augmented)
    if route.yaw.free and name == "min-control-r":
        raise UsageError(
            f"{source or route.name}: yaw.free: min-control-r tracks a path with its heading; give the "
            "heading, or plan min-control"
        )
    if route.yaw.free and (name in MINIMISED or augmented):
        check_turnable(dynamics, source or route.name)
    if augmented:
        _check_steady(dynamics, route)
    if dynamics.model.network is not None and dynamics.model.region is not None and name in MINIMISED:
        limits = within_region(limits, dynamics.model.region, dynamics)
    clearance_m = _clearance(route, options.get("clearance_m"), source)
    return Job(
        kind=name,
        course=route,
        route=with_clearance(route, clearance_m),
        clearance_m=clearance_m,
        dynamics=dynamics,
        limits=limits,
        settings=settings,
    )


def _clearance(route: Route, clearance_m: float | None, source: str | None) -> float:
    """Return the first clearance. Raises UsageError for a stated one that the route has no room for."""
    if clearance_m is None:
        return ALLOWANCE_M
    if not 0.0 <= clearance_m <= CLEARANCE_MAX_M:
        raise UsageError(f"--clearance {clearance_m:g}: give 0 to {CLEARANCE_MAX_M:g} m")
    room_m, where = room(route)
    if room_m < clearance_m:
        raise UsageError(
            f"{source or route.name}: {where} has room for {room_m:.3g} m of clearance, not for "
            f"{clearance_m:g} m; give a smaller --clearance or more room"
        )
    return clearance_m


def _residual_model(
    model: Model | ResidualModel | None,
    effects: Mapping[str, Effect] | None,
    vehicle: Vehicle,
    kind: Kind,
    augmented: bool,
) -> ResidualModel:
    """Return the model in the planner's form.

    Raises UsageError where it is missing, empty or of another vehicle.
    """
    if isinstance(model, Model):
        if model.vehicle_id != vehicle.id:
            raise UsageError(
                f"the model is of vehicle {model.vehicle_name} ({model.vehicle_id}), not of {vehicle.name} "
                f"({vehicle.id}); give this vehicle's model"
            )
        try:
            model = ResidualModel.of(model, load_effects() if effects is None else effects)
        except ValueError as error:
            raise UsageError(str(error)) from None
    if model is None:
        if kind in MINIMISED or augmented:
            raise UsageError(f"{label(kind, augmented)} needs a model, give --model")
        return ResidualModel()
    if kind == "min-residual" and not model.has_residual(vehicle):
        raise UsageError(
            "the model has no network and names no effect that depends on the path: no residual to minimise"
        )
    if kind == "min-error" and not model.has_acceleration(vehicle):
        raise UsageError(
            "the model has no network and names no effect whose acceleration depends on the path: no "
            "tracking error to minimise; min-residual also avoids torques"
        )
    return model


def _check_steady(dynamics: Dynamics, route: Route) -> None:
    """Raise UsageError for a model with no steady flight at hover or at the end velocities."""
    try:
        for p_ned in (route.waypoints_m[0], route.waypoints_m[-1]):
            for v_ned in ((0.0, 0.0, 0.0), *route.end_velocities_ned):
                dynamics.steady(0.0, v_ned, p_ned)
    except (ValueError, ArithmeticError) as error:
        raise UsageError(f"{error}; plan without the star") from None


def _free_time(
    settings: Settings,
    route: Route,
    kind: str,
    box: tuple[float, float] | None,
    weight: float | None,
) -> Settings:
    """Return the settings with the total time free within `box`. Raises UsageError."""
    if box is None:
        if weight is not None:
            raise UsageError("--time-weight goes with --time-box: without it the total time is given")
        return settings
    low, high = box
    if not 0.1 <= low <= 1.0 <= high <= 10.0:
        raise UsageError(
            f"--time-box {low:g} {high:g}: give two shares of the route's time, 0.1..1 and 1..10"
        )
    if kind == "min-snap":
        raise UsageError("--time-box goes with min-control and min-residual; give min-snap --stretch")
    if route.times_s is not None:
        raise UsageError(
            f"{route.name}: its waypoints have times, --time-box needs a route with total_time_s"
        )
    price = 1.0 if weight is None else weight
    if not (math.isfinite(price) and price >= 0.0):
        raise UsageError(f"--time-weight {price:g}: give 0 or more")
    step_low, step_high = settings.step_box
    return replace(
        settings,
        total_time_box=(low, high),
        step_box=(low * step_low, high * step_high),
        weights=replace(settings.weights, time=price),
    )


def _timed(route: Route, total_time_s: float | None) -> Route:
    """Return the route with this total time; waypoint times and yaw profile scale with it."""
    if total_time_s is None:
        return route
    if not 0.0 < total_time_s <= TIME_MAX_S:
        raise UsageError(f"--time-s {total_time_s:g}: give a time above 0 and at most {TIME_MAX_S:g} s")
    scale = total_time_s / route.duration_s
    yaw = route.yaw.model_copy(update={"times_s": tuple(t * scale for t in route.yaw.times_s)})
    if route.times_s is not None:
        return route.model_copy(update={"times_s": tuple(t * scale for t in route.times_s), "yaw": yaw})
    return route.model_copy(update={"total_time_s": total_time_s, "yaw": yaw})


def _limits(route: Route, vehicle: Vehicle, headroom: LimitsOverride | None, source: str | None) -> Limits:
    """Return the limits of vehicle, route and headroom together. Raises ConfigurationError."""
    limits = check_route(route, vehicle, source)
    if headroom is None:
        return limits
    return check_route(
        route.model_copy(update={"limits": headroom}), vehicle.replace(limits=limits), "--headroom"
    )
