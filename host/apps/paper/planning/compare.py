"""Compare kinds of plan: planned under a known drag, and flown in a sealed world.

Planned: the model is a drag of diag(0.5, 0.5, 0.1) 1/s in the body frame. Flown: a model is learned from
flights in the sealed world, on training courses. The DFBC then flies the held-out courses without
feed-forward, through firmware and radio. The same training flights give further models to compare: a closed
form of the drag, and networks in its place, in the world frame as in the paper and in the body frame.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.planning.courses import Course, draw, draw_course
from trimtab.host.base.errors import Refused, SolverError
from trimtab.host.effects import Effect, load_effects
from trimtab.host.effects.linear_drag import EFFECT as LINEAR_DRAG
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, learn
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.tracking import reference_at
from trimtab.host.models.network import Frame, Layout
from trimtab.host.plan import Plan, ResidualModel, Settings, Weights, plan
from trimtab.host.plan.flown import fly_plan
from trimtab.host.plan.profile import profile
from trimtab.host.plan.table import from_reference
from trimtab.host.vehicle import Vehicle

WORLD = "paper-drag"
DRAG = (0.5, 0.5, 0.1)
"""1/s along FRD, our choice: the paper gives the form of its simulated drag and no coefficients."""
KINDS = ("min-snap", "min-control", "min-control*", "min-control-r", "min-residual", "min-residual*")
NODES = 400
CLOSED_FORM = "closed-form"
NETWORKS: Mapping[str, Frame] = {"network-body": "body", "network-world": "world"}
RESIDUAL_KINDS = ("min-residual", "min-residual*")
"""Kinds planned with the closed form and with each network."""
TRAINING_COURSES = 3
PACES = (1.0, 0.75)
"""Paces of the training flights, over the fastest in which min-snap keeps the limits."""


def planned(vehicle: Vehicle, seed: int, index: int) -> dict[str, Any]:
    """Plan one course in every kind, with the paper's number of nodes and weight of control effort."""
    course = draw_course(vehicle, seed, index, "planned")
    drag = load_effects()[LINEAR_DRAG.name]
    known = ResidualModel(parts=((drag, drag.theta(DRAG)),))
    paper = paper_settings(vehicle)
    return {
        "course": course.route.name,
        "duration_s": course.route.duration_s,
        "kinds": {kind: _planned(course, vehicle, known, kind, paper, NODES)[0] for kind in KINDS},
    }


def paper_settings(vehicle: Vehicle) -> Settings:
    """Return the settings of a plan with the paper's weight of control effort (section V-B: 0.1)."""
    hover_n = vehicle.mass_kg * GRAVITY / 4.0
    return Settings(weights=Weights(control=0.1 * hover_n**2), relative_weights=False)


def flown(
    folder: Path,
    vehicle: Vehicle,
    seed: int,
    world: int,
    courses: int,
    *,
    kinds: Sequence[str] = KINDS,
    residuals: bool = True,
    on_progress: Callable[[str], None] = lambda step: None,
) -> dict[str, Any]:
    """Learn a model from flights of one world; then fly the kinds there on held-out courses.

    residuals: also plan RESIDUAL_KINDS with the closed form and with networks in its place. Logs stay in
    `folder`. on_progress: called `courses` + 1 times, as each step begins.
    """
    on_progress(f"world {world}: flights to learn from")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    field = Airfield(
        vehicle=vehicle,
        world=WORLD,
        world_seed=draw(seed, "world", world),
        session={"seed": str(seed), "command": "trimtab study paper-planning"},
    )
    flights = training_flights(field, folder, seed, purpose=f"training-{world}")
    effects = load_effects()
    learned = learn(flights, effects=effects, settings=CondensedSettings(), forms=DEFAULT_FORMS, hold_out=())
    variants = [(kind, "", ResidualModel.of(learned.model, effects)) for kind in kinds]
    if residuals:
        others = residual_models(flights, effects)
        variants += [(kind, name, model) for name, model in others.items() for kind in RESIDUAL_KINDS]
    rows, number = [], len(flights)
    for k in range(courses):
        course = draw_course(vehicle, seed, k, f"flown-{world}")
        on_progress(f"world {world}: {course.route.name}")
        by_model: dict[str, dict[str, Any]] = {}
        for kind, model_name, model in variants:
            row, result = _planned(course, vehicle, model, kind, Settings(), None)
            if result is not None:
                number += 1
                stem = "-".join(part for part in (f"course-{k}", kind.replace("*", "s"), model_name) if part)
                row |= _flight(field, result, number, folder / f"{stem}.mcap")
            by_model.setdefault(model_name, {})[kind] = row
        rows.append(
            {
                "course": course.route.name,
                "duration_s": course.route.duration_s,
                "kinds": by_model.pop(""),
                "residuals": by_model,
            }
        )
    return {"world": world, "kept": learned.selected.what, "courses": rows}


def training_flights(
    field: Airfield,
    folder: Path,
    seed: int,
    *,
    purpose: str,
    courses: int = TRAINING_COURSES,
    paces: Sequence[float] = PACES,
) -> list[Flight]:
    """Fly the courses of a purpose at each pace, course by course; logs stay in `folder`."""
    flights: list[Flight] = []
    for k in range(courses):
        course = draw_course(field.vehicle, seed, k, purpose)
        for pace in paces:
            log = folder / f"training-{k}-{pace:g}.mcap"
            slow = plan(course.route, field.vehicle, total_time_s=course.route.duration_s / pace)
            field.fly(slow.reference, len(flights) + 1, log)
            flights.append(read_flight(log))
    return flights


def residual_models(flights: Sequence[Flight], effects: Mapping[str, Effect]) -> dict[str, ResidualModel]:
    """Learn the residual acceleration as a closed form and as networks, the torque as a closed form."""
    torque = tuple(name for name in DEFAULT_FORMS if name != LINEAR_DRAG.name)
    variants: dict[str, tuple[Layout | None, tuple[str, ...]]] = {CLOSED_FORM: (None, DEFAULT_FORMS)}
    for name, frame in NETWORKS.items():
        variants[name] = (Layout(hidden=(32, 32), frame=frame), torque)
    return {
        name: ResidualModel.of(
            learn(
                flights,
                effects=effects,
                settings=CondensedSettings(layout=layout),
                forms=forms,
                hold_out=(),
                as_asked=True,
            ).model,
            effects,
        )
        for name, (layout, forms) in variants.items()
    }


def _planned(
    course: Course, vehicle: Vehicle, model: ResidualModel, kind: str, settings: Settings, nodes: int | None
) -> tuple[dict[str, Any], Plan | None]:
    """Return the plan's figures and the plan, or why there is none and None."""
    try:
        if kind == "min-snap":
            result = course.snap
        else:
            result = plan(course.route, vehicle, kind=kind, model=model, nodes=nodes, settings=settings)
    except (Refused, SolverError) as error:
        return {"failed": str(error)}, None
    along = profile(vehicle, model, from_reference(result.reference), result.reference.yaw_nodes())
    assert along.residual is not None
    d = along.residual
    norm = np.linalg.norm(d - d[:, :1], axis=0)
    flat = reference_at(result.reference, np.arange(0, result.reference.duration_us, 10_000))
    return {
        "residual_mean_m_s2": float(norm.mean()),
        "drag_mean_n": float(vehicle.mass_kg * np.linalg.norm(d[:3], axis=0).mean()),
        "solve_s": result.solve_s,
        "first_solve_s": result.first_solve_s,
        "iterations": result.iterations,
        "rounds": result.rounds,
        "path_length_m": result.path_length_m,
        "mean_speed_m_s": result.mean_speed_m_s,
        "acceleration_max_m_s2": float(np.linalg.norm(flat[:, 6:9], axis=1).max()),
        "jerk_max_m_s3": float(np.linalg.norm(flat[:, 9:12], axis=1).max()),
        "jerk_mean_m_s3": float(np.linalg.norm(flat[:, 9:12], axis=1).mean()),
        "outside_region": result.outside_region,
    }, result


def _flight(field: Airfield, plan_flown: Plan, number: int, log: Path) -> Mapping[str, Any]:
    """Fly a plan; return the mean, RMS and greatest tracking error, m, and the share of clipped ticks."""
    flight = fly_plan(plan_flown, field, flight=number, log=log)
    if flight.failure is not None:
        return {"flight_failed": flight.failure}
    return {
        "error_mean_m": flight.error_mean_m,
        "error_rmse_m": flight.error_rmse_m,
        "error_max_m": flight.error_max_m,
        "clipped_share": flight.clipped_share,
    }
