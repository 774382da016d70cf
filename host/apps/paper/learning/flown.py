"""The data of section VI-B: flights through firmware, radio and a plant of its own, in drawn, sealed worlds.

Four paths of twenty waypoints, each flown at four decay rates, and three faster ones out of distribution.
Four fifths of the sixteen are learned from, the others tested on; nobody opens a world's truth.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.paths import Course, Room, draw_path, statistics
from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import FlightFailed
from trimtab.host.base.output import json_text
from trimtab.host.effects import Effect, load_effects
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, Learned, Settings, learn
from trimtab.host.learn.evaluate import model_errors
from trimtab.host.log import Flight, read_flight
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout
from trimtab.host.vehicle import Vehicle

WORLD = "drawn"
DECAYS = (1.0, 0.87, 0.75, 0.65)
"""Pace of each path's four flights."""
OOD_PACE = 1.15

ROOM = Room(
    box_m=(4.5, 4.5, 1.4), middle_ned=(0.0, 0.0, -1.6), leg_m=(1.0, 2.2), turn_deg=70.0, duration_s=15.0
)
"""Legs and turns are chosen for means near those of the paper's paths."""

_PATHS, _OOD_PATHS = 4, 3
_TEST = 3


def draw_courses(vehicle: Vehicle, seed: int) -> list[Course]:
    """Return the sixteen references and the three out of distribution.

    A path that violates the vehicle's limits at its fastest pace is drawn again.
    """
    rng = np.random.default_rng([seed, 1])
    paces = dict(zip("abcd", DECAYS, strict=True))
    courses = []
    for k in range(_PATHS):
        courses += draw_path(rng, vehicle, ROOM, f"path-{k}", paces, out_of_distribution=False)
    for k in range(_OOD_PATHS):
        courses += draw_path(rng, vehicle, ROOM, f"ood-{k}", {"": OOD_PACE}, out_of_distribution=True)
    return courses


def fly_and_learn(folder: Path, vehicle: Vehicle, seed: int, world: int) -> dict[str, Any]:
    """Fly and learn in one world; return and store the result in `folder`/result.json.

    It holds position and velocity errors of whole flights by set and method, and the failed flights.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    courses = draw_courses(vehicle, _hash("courses", seed, world))
    field = Airfield(
        vehicle=vehicle,
        world=WORLD,
        world_seed=_hash("world", seed, world),
        session={"seed": str(seed), "command": "trimtab study paper-learning"},
    )
    flown: dict[str, Flight] = {}
    failed = []
    for index, course in enumerate(courses, start=1):
        log = folder / f"{course.name}.mcap"
        try:
            field.fly(course.reference, index, log)
            flown[course.name] = read_flight(log)
        except FlightFailed as error:
            failed.append({"flight": course.name, "why": str(error)})
    sets = _sets(courses, flown, np.random.default_rng([seed, 2, world]))
    effects = load_effects()
    used = sets["train"]
    # The paper's algorithm, with our settings, always keeps its network; the others keep what predicts best.
    learned = {
        "paper": _learned(used, effects, Settings(hidden=(32, 32, 32)), (), as_asked=True),
        "hybrid": _learned(used, effects, CondensedSettings(), DEFAULT_FORMS),
        "body": _learned(
            used, effects, CondensedSettings(layout=Layout(hidden=(32, 32), frame="body")), DEFAULT_FORMS
        ),
    }
    models: dict[str, Model | None] = {"nominal": None, **{name: e.model for name, e in learned.items()}}
    errors = {
        name: {method: model_errors(flights, model, effects).to_json() for method, model in models.items()}
        for name, flights in sets.items()
    }
    result = {
        "world": world,
        "errors": errors,
        "kept": {method: found.selected.what for method, found in learned.items()},
        "flights": {name: len(flights) for name, flights in sets.items()},
        "failed": failed,
        "statistics": {
            name: statistics([c for c in courses if c.out_of_distribution == ood])
            for name, ood in (("known", False), ("ood", True))
        },
    }
    write_atomic(folder / "result.json", json_text(result), force=True)
    return result


def _learned(
    flights: list[Flight],
    effects: Mapping[str, Effect],
    settings: Settings | CondensedSettings,
    forms: tuple[str, ...],
    *,
    as_asked: bool = False,
) -> Learned:
    """Return the model learned from all of these flights, with none held out."""
    return learn(flights, effects=effects, settings=settings, forms=forms, hold_out=(), as_asked=as_asked)


def _sets(
    courses: list[Course], flown: Mapping[str, Flight], rng: np.random.Generator
) -> dict[str, list[Flight]]:
    """Return flights by set: train and test drawn 8:2 from the sixteen, and ood."""
    known = [c.name for c in courses if not c.out_of_distribution and c.name in flown]
    order = [known[i] for i in rng.permutation(len(known))]
    ood = [c.name for c in courses if c.out_of_distribution and c.name in flown]
    sets = {"train": order[_TEST:], "test": order[:_TEST], "ood": ood}
    return {name: [flown[each] for each in names] for name, names in sets.items()}


def _hash(purpose: str, seed: int, world: int) -> int:
    text = f"trimtab study paper-learning, {purpose} of world {world}, seed {seed}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1
