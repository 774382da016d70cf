"""Kinds of plan side by side: as planned under a drag that is known, and flown in a sealed world.

Planned: a drag of diag(0.5, 0.5, 0.1) 1/s in the body's frame is the model itself. Flown: a model is
learned from flights of the sealed world, on courses of their own; the compared courses are flown by the DFBC
without feed-forward, through firmware and radio. From the same flights more are learned, to be compared with
each other: with a closed form of the drag, and with a network in its place, in the world's frame as the
paper's and in the body's.
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
"""What is planned with the closed form and with each network."""
_TRAINING = 6
_PACES = (1.0, 0.75)


def planned(vehicle: Vehicle, seed: int, index: int) -> dict[str, Any]:
    """One course planned in every kind with the paper's nodes and its weight of control effort."""
    course = draw_course(vehicle, seed, index, "planned")
    known = ResidualModel(parts=((load_effects()[LINEAR_DRAG.name], DRAG),))
    hover_n = vehicle.mass_kg * GRAVITY / 4.0
    paper = Settings(weights=Weights(control=0.1 * hover_n**2), relative_weights=False)
    return {
        "course": course.route.name,
        "duration_s": course.route.duration_s,
        "kinds": {kind: _planned(course, vehicle, known, kind, paper, NODES)[0] for kind in KINDS},
    }


def flown(
    folder: Path,
    vehicle: Vehicle,
    seed: int,
    world: int,
    courses: int,
    *,
    kinds: Sequence[str] = KINDS,
    residuals: bool = True,
    hear: Callable[[str], None] = lambda step: None,
) -> dict[str, Any]:
    """One world: a model learned from flights of its own, then the kinds flown on held-out courses.

    residuals: RESIDUAL_KINDS with the closed form and with networks in its place too. Logs stay in `folder`.
    hear: told `courses` + 1 times what begins.
    """
    hear(f"world {world}: flights to learn from")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    field = Airfield(
        vehicle=vehicle,
        world=WORLD,
        world_seed=draw(seed, "world", world),
        session={"seed": str(seed), "command": "trimtab study paper-planning"},
    )
    flights, number = [], 0
    for k in range(_TRAINING // len(_PACES)):
        course = draw_course(vehicle, seed, k, f"training-{world}")
        for pace in _PACES:
            number += 1
            log = folder / f"training-{k}-{pace:g}.mcap"
            slow = plan(course.route, vehicle, total_time_s=course.route.duration_s / pace)
            field.fly(slow.reference, number, log)
            flights.append(read_flight(log))
    effects = load_effects()
    learned = learn(flights, effects=effects, settings=CondensedSettings(), forms=DEFAULT_FORMS, hold_out=())
    model = ResidualModel.of(learned.model, effects)
    others = residual_models(flights, effects) if residuals else {}
    rows = []
    for k in range(courses):
        course = draw_course(vehicle, seed, k, f"flown-{world}")
        hear(f"world {world}: {course.route.name}")
        asked = [(kind, "", model) for kind in kinds]
        asked += [(kind, what, other) for what, other in others.items() for kind in RESIDUAL_KINDS]
        found: dict[str, dict[str, Any]] = {}
        for kind, what, known in asked:
            row, made = _planned(course, vehicle, known, kind, Settings(), None)
            if made is not None:
                number += 1
                name = "-".join(part for part in (f"course-{k}", kind.replace("*", "s"), what) if part)
                row |= _flight(field, made, number, folder / f"{name}.mcap")
            found.setdefault(what, {})[kind] = row
        rows.append(
            {
                "course": course.route.name,
                "duration_s": course.route.duration_s,
                "kinds": found.pop(""),
                "residuals": found,
            }
        )
    return {"world": world, "kept": learned.selected.what, "courses": rows}


def residual_models(flights: Sequence[Flight], effects: Mapping[str, Effect]) -> dict[str, ResidualModel]:
    """Return the residual acceleration as a closed form, and as networks; the torque is a closed form in
    all.
    """
    torque = tuple(name for name in DEFAULT_FORMS if name != LINEAR_DRAG.name)
    asked: dict[str, tuple[Layout | None, tuple[str, ...]]] = {CLOSED_FORM: (None, DEFAULT_FORMS)}
    for what, frame in NETWORKS.items():
        asked[what] = (Layout(hidden=(32, 32), frame=frame), torque)
    return {
        what: ResidualModel.of(
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
        for what, (layout, forms) in asked.items()
    }


def _planned(
    course: Course, vehicle: Vehicle, model: ResidualModel, kind: str, settings: Settings, nodes: int | None
) -> tuple[dict[str, Any], Plan | None]:
    """Return the plan's figures, or why there is none, and the plan."""
    try:
        if kind == "min-snap":
            made = course.snap
        else:
            made = plan(course.route, vehicle, kind=kind, model=model, nodes=nodes, settings=settings)
    except (Refused, SolverError) as error:
        return {"failed": str(error)}, None
    along = profile(vehicle, model, from_reference(made.reference), made.reference.yaw_nodes())
    assert along.residual is not None
    d = along.residual
    norm = np.linalg.norm(d - d[:, :1], axis=0)
    flat = reference_at(made.reference, np.arange(0, made.reference.duration_us, 10_000))
    return {
        "residual_mean_m_s2": float(norm.mean()),
        "drag_mean_n": float(vehicle.mass_kg * np.linalg.norm(d[:3], axis=0).mean()),
        "solve_s": made.solve_s,
        "first_solve_s": made.first_solve_s,
        "iterations": made.iterations,
        "rounds": made.rounds,
        "path_length_m": made.path_length_m,
        "mean_speed_m_s": made.mean_speed_m_s,
        "acceleration_max_m_s2": float(np.linalg.norm(flat[:, 6:9], axis=1).max()),
        "jerk_max_m_s3": float(np.linalg.norm(flat[:, 9:12], axis=1).max()),
        "jerk_mean_m_s3": float(np.linalg.norm(flat[:, 9:12], axis=1).mean()),
        "outside_region": made.outside_region,
    }, made


def _flight(field: Airfield, made: Plan, number: int, log: Path) -> Mapping[str, Any]:
    """Tracking error of one flight, m, mean and greatest, and the share of clipped ticks."""
    flight = fly_plan(made, field, flight=number, log=log)
    if flight.failure is not None:
        return {"flight_failed": flight.failure}
    return {
        "error_mean_m": flight.error_mean_m,
        "error_rmse_m": flight.error_rmse_m,
        "error_max_m": flight.error_max_m,
        "clipped_share": flight.clipped_share,
    }
