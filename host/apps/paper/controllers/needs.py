"""What a network needs: training flights, excitation, and the frame of its inputs.

The measure is the error of the baseline on min-residual over that on min-snap, on held-out courses.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.controllers.fly import Course, Row, fly_controller
from trimtab.host.apps.paper.controllers.models import Site, airfield
from trimtab.host.apps.paper.controllers.pieces import RADIO, WORLDS, held_out
from trimtab.host.apps.paper.controllers.table import BASELINE, MIN_RESIDUAL, MIN_SNAP
from trimtab.host.apps.paper.planning.compare import training_flights
from trimtab.host.effects import load_effects
from trimtab.host.effects.linear_drag import EFFECT as LINEAR_DRAG
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, learn
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.network import Frame, Layout
from trimtab.host.plan import Plan, Settings
from trimtab.host.route import Route
from trimtab.host.vehicle import Vehicle

COUNTS = (4, 12, 24)
"""Numbers of training flights; the smaller sets are the first flights of the larger ones."""
EXCITATIONS = {"gentle": (0.6, 0.45), "aggressive": (1.0, 0.75)}
"""Paces of the training flights, over the fastest in which min-snap keeps the limits."""
FRAMES: tuple[Frame, ...] = ("world", "body")
TARGET = 0.7
"""Error ratio of min-residual over min-snap that counts as reached."""
_FLIGHT_FIRST = 401


def needs(
    logs: Path,
    vehicle: Vehicle,
    seed: int,
    *,
    world: int,
    excitation: str,
    counts: Sequence[int],
    courses: int,
) -> dict[str, Any]:
    """Learn networks from training flights of one excitation, and fly min-residual with each.

    The networks take the place of the closed form of the drag; the torque keeps its closed form. Training
    flights and courses are the same for both excitations. Where the region of the training flights allows no
    plan, the plan ignores it.
    """
    place = f"needs-{world}"
    field, effects = airfield(vehicle, seed, WORLDS[RADIO], place), load_effects()
    shutil.rmtree(logs, ignore_errors=True)
    logs.mkdir(parents=True)
    paces = EXCITATIONS[excitation]
    flights = training_flights(
        field,
        logs,
        seed,
        purpose=f"controllers-{place}",
        courses=-(-max(counts) // len(paces)),
        paces=paces,
    )
    torque = tuple(name for name in DEFAULT_FORMS if name != LINEAR_DRAG.name)
    rows: list[Row] = []
    for count in counts:
        for frame in FRAMES:
            settings = CondensedSettings(layout=Layout(hidden=(32, 32), frame=frame))
            try:
                found = learn(
                    flights[:count],
                    effects=effects,
                    settings=settings,
                    forms=torque,
                    hold_out=(),
                    as_asked=True,
                )
            except TooLittleData as error:
                flown = [{"failed": f"learning: {error}", "within_region": False}] * courses
            else:
                site = Site(
                    field=field, models={"ours": found.model}, effects=effects, selected=found.selected.what
                )
                flown = [_fly(site, held_out(vehicle, seed, place, k), k, logs) for k in range(courses)]
            rows += [
                {"flights": count, "frame": frame, "course": course, **row}
                for course, row in enumerate(flown)
            ]
    return {"kind": "needs", "world": world, "excitation": excitation, "rows": rows}


def _fly(site: Site, route: Route, index: int, logs: Path) -> Row:
    """Return the errors of the baseline on min-snap and min-residual, and why one is missing, or None."""
    course = Course(route=route, flight=_FLIGHT_FIRST + index, settings=Settings())
    vehicle, model = site.field.vehicle, site.models["ours"]
    plans = course.plans(vehicle, model, (MIN_SNAP, MIN_RESIDUAL))
    within_region = isinstance(plans[MIN_RESIDUAL], Plan)
    if not within_region:
        plans |= course.plans(vehicle, replace(model, region=None), (MIN_RESIDUAL,))
    rows = {row["trajectory"]: row for row in fly_controller(site, course, BASELINE, "ours", plans, logs)}
    return {
        "failed": next((row["failed"] for row in rows.values() if row["failed"] is not None), None),
        "within_region": within_region,
        "min_snap_m": rows[MIN_SNAP].get("error_mean_m"),
        "min_residual_m": rows[MIN_RESIDUAL].get("error_mean_m"),
    }
