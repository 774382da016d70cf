"""The data of section VI-B: flights through firmware, radio and a plant of its own, in drawn, sealed worlds.

Four paths of twenty waypoints, each flown at four decay rates, and three faster ones out of distribution.
Four fifths of the sixteen are learned from, the others tested on; nobody opens a world's truth.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import FlightFailed
from trimtab.host.base.output import json_text
from trimtab.host.effects import Effect, load_effects
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, Learned, Settings, learn
from trimtab.host.learn.evaluate import model_errors
from trimtab.host.log import Flight, read_flight
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout
from trimtab.host.plan.judge import judge
from trimtab.host.plan.snap import optimise_durations
from trimtab.host.plan.table import Table, evaluate, snap_table
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference, YawNode

WORLD = "drawn"
DECAYS = (1.0, 0.87, 0.75, 0.65)
"""Pace of each path's four flights."""
OOD_PACE = 1.15

_PATHS, _OOD_PATHS, _WAYPOINTS = 4, 3, 20
_DURATION_S = 15.0
_BOX_M = np.array([4.5, 4.5, 1.4])
_LEG_M, _TURN_RAD = (1.0, 2.2), np.deg2rad(70.0)
"""Legs between drawn waypoints and the most they turn, chosen for means near those of the paper's paths."""
_MIDDLE_NED = np.array([0.0, 0.0, -1.6])
_TEST = 3
_TRIES, _CANDIDATES = 50, 200


@dataclass(frozen=True, kw_only=True)
class Course:
    """A reference, the set it belongs to (known, ood) and its name."""

    name: str
    out_of_distribution: bool
    reference: Reference
    table: Table


def draw_courses(vehicle: Vehicle, seed: int) -> list[Course]:
    """Return the sixteen references and the three out of distribution.

    A path that violates the vehicle's limits at its fastest pace is drawn again.
    """
    rng = np.random.default_rng([seed, 1])
    courses = []
    for k in range(_PATHS):
        courses += _paced(rng, vehicle, f"path-{k}", dict(zip("abcd", DECAYS, strict=True)), ood=False)
    for k in range(_OOD_PATHS):
        courses += _paced(rng, vehicle, f"ood-{k}", {"": OOD_PACE}, ood=True)
    return courses


def statistics(courses: list[Course]) -> dict[str, float]:
    """Return mean and standard deviation of speed, acceleration and jerk along references, every 20 ms."""
    rows: list[np.ndarray] = []
    for course in courses:
        times = np.arange(0, course.table.times_us[-1], 20_000)
        rows.append(np.stack([np.linalg.norm(row, axis=0) for row in evaluate(course.table, times)[1:4]]))
    norms = np.concatenate(rows, axis=1)
    names = ("speed_m_s", "acceleration_m_s2", "jerk_m_s3")
    return {
        f"{name}_{what}": float(value)
        for name, row in zip(names, norms, strict=True)
        for what, value in (("mean", row.mean()), ("sd", row.std()))
    }


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


def _paced(
    rng: np.random.Generator, vehicle: Vehicle, name: str, paces: Mapping[str, float], *, ood: bool
) -> list[Course]:
    """Return a path drawn and flown at these paces.

    Raises ValueError where none that was drawn may be flown.
    """
    for _ in range(_TRIES):
        waypoints = _walk(rng)
        durations = optimise_durations(waypoints, _DURATION_S)
        courses = []
        for suffix, pace in paces.items():
            table = snap_table(waypoints, durations / pace)
            verdict = judge(table, [YawNode(0, 0.0, 0.0)], vehicle, vehicle.limits, ())
            if not verdict.ok:
                break
            courses.append(
                Course(
                    name=f"{name}{suffix}",
                    out_of_distribution=ood,
                    reference=verdict.reference,
                    table=verdict.table,
                )
            )
        else:
            return courses
    raise ValueError(f"none of {_TRIES} drawn paths {name} may be flown by {vehicle.name}")


def _walk(rng: np.random.Generator) -> np.ndarray:
    """Return waypoints (20, 3) drawn in a box.

    Each is the first drawn one that meets the bounds of a leg, or the one with the smallest turn of many.
    """
    points = [rng.uniform(-0.5, 0.5, 3) * _BOX_M]
    way = np.zeros(3)
    while len(points) < _WAYPOINTS:
        best, straightest = points[-1], -np.inf
        for candidate in rng.uniform(-0.5, 0.5, (_CANDIDATES, 3)) * _BOX_M:
            leg = candidate - points[-1]
            length = float(np.linalg.norm(leg))
            ahead = float(leg @ way) / length if way.any() else 1.0
            if _LEG_M[0] <= length <= _LEG_M[1] and ahead > straightest:
                best, straightest = candidate, ahead
                if ahead >= np.cos(_TURN_RAD):
                    break
        way = (best - points[-1]) / np.linalg.norm(best - points[-1])
        points.append(best)
    return _MIDDLE_NED + np.array(points)


def _hash(purpose: str, seed: int, world: int) -> int:
    text = f"trimtab study paper-learning, {purpose} of world {world}, seed {seed}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1
