"""Pieces of the study: the paper's course in full, courses of the balanced design, and the weights' front."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.controllers.design import SPEEDS, cells
from trimtab.host.apps.paper.controllers.fly import Course, Row, fly_baseline, fly_set, remove_log
from trimtab.host.apps.paper.controllers.models import Site, learned_site
from trimtab.host.apps.paper.controllers.table import REGRESSORS, SETS
from trimtab.host.apps.paper.planning.compare import NODES, paper_settings
from trimtab.host.apps.paper.planning.courses import BOX_M, WAYPOINTS, draw, draw_course
from trimtab.host.base.errors import Refused
from trimtab.host.plan import Settings, plan
from trimtab.host.plan.flown import fly_plan
from trimtab.host.plan.pareto import pareto
from trimtab.host.route import Route, random_route
from trimtab.host.vehicle import Vehicle

RADIO, WIRED, RICH = "radio", "wired", "rich"
WORLDS = {RADIO: "paper-drag", WIRED: "paper-drag-wired", RICH: "rich"}
"""World of each setting: drag through the radio, or wired as in the paper's simulation, or seven effects."""
PAPER_DURATION_S = 10.0
_FULL_FIRST, _CELL_FIRST, _FRONT_FIRST, _SELECT_FIRST = 101, 201, 301, 501
"""Flight indices; those below belong to training flights."""
_TRIES = 200


def full(
    folder: Path, logs: Path, vehicle: Vehicle, seed: int, *, course: int, setting: str
) -> dict[str, Any]:
    """Fly a course like the paper's by every controller on every trajectory.

    10 s, 400 nodes of 0.025 s, lambda_r = 0.1 (section V-B). Its world and courses are not those of the
    balanced design: these flights select the best pair, which the design then measures.
    """
    place = f"tuning-{setting}"
    site = learned_site(folder / place, vehicle, seed, WORLDS[setting], place)
    flown = Course(
        route=paper_course(vehicle, seed, course),
        flight=_FULL_FIRST + course,
        settings=paper_settings(vehicle),
        nodes=NODES,
    )
    rows = [row for each in SETS for row in fly_set(site, flown, each, logs)]
    return {"kind": "full", "course": course, "setting": setting, "selected": site.selected, "rows": rows}


def select(folder: Path, logs: Path, vehicle: Vehicle, seed: int, *, course: int) -> dict[str, Any]:
    """Fly the baseline on a tuning course at every speed, with the settings of the balanced design.

    These flights select the baseline's trajectory and regressor.
    """
    place = f"tuning-{RADIO}"
    site = learned_site(folder / place, vehicle, seed, WORLDS[RADIO], place)
    route = held_out(vehicle, seed, place, course)
    rows: list[Row] = []
    for k, (speed, scale) in enumerate(SPEEDS.items()):
        flight = _SELECT_FIRST + len(SPEEDS) * course + k
        at_speed = Course(route=timed(route, scale), flight=flight, settings=Settings())
        for regressor in REGRESSORS:
            flown = fly_baseline(site, at_speed, regressor, logs / speed)
            rows += [row | {"speed": speed} for row in flown]
    return {"kind": "select", "course": course, "selected": site.selected, "rows": rows}


def paper_course(vehicle: Vehicle, seed: int, index: int) -> Route:
    """Return a course of nine waypoints that min-snap flies within the limits in 10 s.

    Raises ValueError if no drawn course qualifies.
    """
    for attempt in range(_TRIES):
        route = random_route(
            draw(seed, "controllers-tuning", index, attempt),
            count=WAYPOINTS,
            box_m=BOX_M,
            total_time_s=PAPER_DURATION_S,
            name=f"tuning-{index}",
        )
        try:
            plan(route, vehicle)
        except Refused:
            continue
        return route
    raise ValueError(f"none of {_TRIES} drawn courses may be flown by {vehicle.name} in {PAPER_DURATION_S} s")


def balanced(
    folder: Path, logs: Path, vehicle: Vehicle, seed: int, *, world: int, course: int
) -> dict[str, Any]:
    """Fly a course of the balanced design at every speed."""
    site = _site(folder, vehicle, seed, world)
    route = held_out(vehicle, seed, _place(world), course)
    found: list[Row] = []
    for k, cell in enumerate(cells(course)):
        flown = Course(
            route=timed(route, SPEEDS[cell.speed]),
            flight=_CELL_FIRST + len(SPEEDS) * course + k,
            settings=Settings(),
        )
        rows = fly_set(site, flown, cell.flown, logs / cell.speed, cell.anchors)
        found += [row | {"speed": cell.speed, "family": cell.flown.family} for row in rows]
    return {"kind": "balanced", "world": world, "course": course, "selected": site.selected, "rows": found}


def front(
    folder: Path, logs: Path, vehicle: Vehicle, seed: int, *, world: int, courses: int
) -> dict[str, Any]:
    """Plan held-out courses with scaled weights of thrusts and their rates; the baseline flies the plans."""
    site = _site(folder, vehicle, seed, world)
    rows: list[Row] = []
    logs.mkdir(parents=True, exist_ok=True)
    for course in range(courses):
        points = pareto(held_out(vehicle, seed, _place(world), course), vehicle, site.models["ours"])
        for k, point in enumerate(points):
            row: Row = {"course": course, "plan": point.kind, "factor": point.factor, "failed": point.reason}
            if point.plan is not None:
                log = logs / f"course-{course}-{k}.mcap"
                flight = fly_plan(point.plan, site.field, flight=_FRONT_FIRST + course, log=log)
                row |= {
                    "failed": flight.failure,
                    "error_mean_m": flight.error_mean_m,
                    "jerk_rms_m_s3": point.jerk_rms_m_s3,
                    "residual_rms_m_s2": point.residual_rms_m_s2,
                }
                if flight.failure is None:
                    remove_log(log)
            rows.append(row)
    return {"kind": "front", "world": world, "rows": rows}


def held_out(vehicle: Vehicle, seed: int, place: str, course: int) -> Route:
    """Return a course of a place to fly, in the least time in which min-snap keeps the limits."""
    return draw_course(vehicle, seed, course, f"controllers-flown-{place}").route


def timed(route: Route, scale: float) -> Route:
    """Return a route without waypoint times that takes `scale` times as long."""
    return route.model_copy(update={"total_time_s": scale * route.duration_s})


def _place(world: int) -> str:
    return f"world-{world:02d}"


def _site(folder: Path, vehicle: Vehicle, seed: int, world: int) -> Site:
    place = _place(world)
    return learned_site(folder / place, vehicle, seed, WORLDS[RADIO], place)
