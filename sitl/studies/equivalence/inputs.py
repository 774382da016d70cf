"""Inputs for both commits: blind worlds as tracing sees them, and groups of real flights."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from trimtab.sitl.studies.files import write_json
from trimtab.sitl.studies.flights import BLIND, fly_and_seal, plan_references
from trimtab.sitl.studies.scoring.world import library
from trimtab.sitl.studies.thin import copier_of, plan_thin_references, programme_of
from trimtab.sitl.studies.worlds import FULL, PlannedWorld, plan_worlds

SEED = 20261122
"""Seed of the drawn worlds; no reported study uses it."""
WORLDS_PER_CLASS = 20
VEHICLE = "research"
CASE_FILE = "case.json"


@dataclass(frozen=True, kw_only=True)
class TraceCase:
    """Logs to trace together: paths inside `folder`."""

    name: str
    folder: Path
    logs: tuple[str, ...]
    held_out: tuple[str, ...]


REAL_GROUPS = (
    ("nanobench", ("B3_figure8_fast_rep1", "B7_oval_fast_rep2"), ("B8_star_slow_rep1",)),
    ("nanobench", ("B3_figure8_fast_rep1", "B8_star_slow_rep1"), ("B7_oval_fast_rep2",)),
    ("nanobench", ("B7_oval_fast_rep2", "B8_star_slow_rep1"), ("B3_figure8_fast_rep1",)),
    ("crazyflie-usd", ("log08", "log12"), ("log15",)),
    ("crazyflie-usd", ("log153",), ("log148",)),
    ("crazyflie-usd", ("log148",), ("log153",)),
)
"""Profile, logs and held-out logs, as in docs/guide/imports.md."""


def chosen_worlds() -> list[PlannedWorld]:
    """Return the first worlds of every class of a full-size blind study."""
    planned = plan_worlds(SEED, sum(FULL.values()), library())
    return [
        world
        for kind_class in FULL
        for world in [w for w in planned if w.kind_class == kind_class][:WORLDS_PER_CLASS]
    ]


def make_worlds(folder: Path, pool: Executor) -> None:
    """Fly the chosen worlds into `folder`, each once. An interrupted run resumes."""
    folder.mkdir(parents=True, exist_ok=True)
    references = plan_references(folder, VEHICLE, BLIND)
    plan_thin_references(folder, VEHICLE, BLIND)
    for done in [pool.submit(_make_world, folder, references, world) for world in chosen_worlds()]:
        done.result()


def _make_world(folder: Path, references: Path, world: PlannedWorld) -> None:
    target = folder / f"{world.kind_class}-{world.name}"
    if (target / CASE_FILE).is_file():
        return
    flown = folder / "flown" / target.name
    flown.mkdir(parents=True, exist_ok=True)
    programme = programme_of(world.case, BLIND)
    fly_and_seal(world, flown, references, VEHICLE, programme)
    target.mkdir(exist_ok=True)
    for log in sorted((flown / "flights").glob("*.mcap")):
        copier_of(world.case)(log, target / log.name)
    case = {"logs": programme.logs(programme.learning), "held_out": programme.logs(programme.held_out)}
    write_json(target / CASE_FILE, case)
    shutil.rmtree(flown)


def world_cases(folder: Path) -> Iterator[TraceCase]:
    """Yield the trace case of every world in `folder`."""
    for path in sorted(folder.glob(f"*/{CASE_FILE}")):
        case = json.loads(path.read_text(encoding="utf-8"))
        yield TraceCase(
            name=path.parent.name,
            folder=path.parent,
            logs=tuple(case["logs"]),
            held_out=tuple(case["held_out"]),
        )
