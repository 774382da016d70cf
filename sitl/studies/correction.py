"""The study of corrections: fly a route that no model has seen, without and with the models' feed-forward.

    trimtab study correction --seed 1

Every world holds two or three common effects. The learning flights of the blind study are traced and learned
from on the command line, in a folder without truth. `trimtab correct` turns each model into a feed-forward,
and other routes are flown without and with it, under the same noise and turbulence.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.base.shards import Shard
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.kinds import DRAG
from trimtab.sitl.studies.commandline import Answer, run_apart, run_inside
from trimtab.sitl.studies.files import StudyError, read_json, sha256_of, write_json, write_whole
from trimtab.sitl.studies.flights import BLIND, TRUTH, Programme, fly_and_seal, plan_references, plan_route
from trimtab.sitl.studies.scoring.correction import cells, flown, lines, pose_age_s, summary, world_cells
from trimtab.sitl.studies.worlds import CALM, PlannedWorld, world_seed
from trimtab.sitl.world import load_world

NAME = "correction"
WORLDS, FLIGHTS = 5, 3
"""Number of worlds, and of flights of each held-out route with each feed-forward."""
HELD_OUT: Mapping[str, str] = {"lemniscate": "fast-lemniscate", "points": "random:7"}
"""Routes that are flown without and with a correction, by their name in the study. No model is made from
them.
"""
FIRST_INDEX = 101
"""Index of the first of these flights. The learning flights have lower ones."""
MODELS = {"traced": "trace.model.toml", "learned": "learned.model.toml"}

_MODELS_DONE = "models.json"


def run(  # noqa: PLR0913 (one keyword for each choice)
    *,
    folder: Path,
    seed: int,
    vehicle: str,
    jobs: int,
    worlds: int = WORLDS,
    quick: bool = False,
    programme: Programme = BLIND,
    shard: Shard | None = None,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Fly without and with corrections, and return the outcome: `answer`, `lines`, `tables` and `scores`.

    Parameters
    ----------
    folder
        State and results; an interrupted study resumes.
    worlds
        Number of worlds.
    quick
        One world, and one flight of each held-out route.
    programme
        Flights that the models are made from.

    Raises
    ------
    UsageError
        No world, or the folder holds another study.
    StudyError
        A route cannot be planned or a world cannot be flown.
    """
    worlds, flights = (1, 1) if quick else (worlds, FLIGHTS)
    if worlds < 1:
        raise UsageError(f"--worlds {worlds}: give 1 or more")
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    references = plan_references(folder, vehicle, programme)
    for name, route in HELD_OUT.items():
        plan_route(references, name, route, vehicle)
    config = {
        "study": NAME,
        "seed": seed,
        "vehicle": load_vehicle(vehicle).id,
        "flights": flights,
        "references": {path.stem: sha256_of(path) for path in sorted(references.glob("*.ref"))},
    }
    names = [f"{index:04d}" for index in range(worlds)]
    results = run_pieces(
        [Piece(name=name, kind="world", arguments={"index": i}) for i, name in enumerate(names)],
        partial(_work, seed=seed, vehicle=vehicle, programme=programme, flights=flights),
        folder=folder,
        config=config,
        jobs=jobs,
        shard=shard,
        on_progress=on_progress,
    )
    scores = {name: results[name]["result"] for name in names}
    figures = summary(scores, seed)
    setup = {"study": NAME, "seed": seed, "worlds": worlds, "quick": quick, "folder": str(folder)}
    return {
        "answer": {**setup, **figures},
        "lines": lines(figures),
        "tables": {
            "Flown error with over without the correction": cells(figures),
            "Worlds and models": world_cells(scores),
        },
        "scores": scores,
    }


def planned_world(seed: int, index: int) -> PlannedWorld:
    """Return the world of a study's seed and an index: two or three kinds of the world drawn-several.

    Wind comes only with a drag, through which it acts.
    """
    draw = load_world("drawn-several")[1].draw
    assert draw is not None
    assert draw.kinds is not None
    rng = np.random.default_rng([seed, index])
    count = int(rng.integers(draw.count[0], draw.count[1], endpoint=True))
    kinds = ["wind"]
    while "wind" in kinds and not set(kinds) & set(DRAG):
        kinds = [draw.kinds[int(i)] for i in rng.permutation(len(draw.kinds))[:count]]
    low, high = (math.log(bound) for bound in CALM)
    return PlannedWorld(
        name=f"{index:04d}",
        kind_class="several",
        kinds=tuple(sorted(kinds)),
        seed=world_seed(seed, index, NAME),
        turbulence=math.exp(rng.uniform(low, high)),
    )


def _work(
    piece: Piece, folder: str, *, seed: int, vehicle: str, programme: Programme, flights: int
) -> dict[str, Any]:
    """Fly, model, correct and fly again in the world of a piece; return what its score needs."""
    world = planned_world(seed, piece.arguments["index"])
    place, references = Path(folder) / "worlds" / world.name, Path(folder) / "references"
    place.mkdir(parents=True, exist_ok=True)
    fly_and_seal(world, place, references, vehicle, programme)
    models = _make_models(place, programme)
    truth = read_json(place / TRUTH)
    feedforwards = {"uncorrected": None}
    feedforwards |= {name: place / "models" / f"{name}.ff" for name, made in models.items() if "id" in made}
    rows = []
    for route in HELD_OUT:
        for index in range(FIRST_INDEX, FIRST_INDEX + flights):
            row: dict[str, Any] = {"route": route, "flight": index}
            for name, feedforward in feedforwards.items():
                log, answer = _fly(world, place, references / f"{route}.ref", index, vehicle, feedforward)
                row[name] = flown(log, answer, pose_age_s(truth))
            rows.append(row)
    return {"effects": truth["effects"], "models": models, "flights": rows}


def _make_models(place: Path, programme: Programme) -> dict[str, Any]:
    """Trace and learn from the world's logs, correct, and return what was made, by model.

    Models and feed-forwards are written to the folder `models`, which holds copies of the logs and no truth.
    """
    folder = place / "models"
    if (folder / _MODELS_DONE).is_file():
        return read_json(folder / _MODELS_DONE)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for log in (place / "flights").glob("*.mcap"):
        shutil.copyfile(log, folder / log.name)
    learning, held_out = programme.logs(programme.learning), programme.logs(programme.held_out)
    traced = run_apart(["trace", *learning, "--hold-out", *held_out, "-o", "."], folder)
    words = ["learn", *learning, "--hold-out", *held_out, "--frame", "body"]
    learned = run_apart([*words, "-o", MODELS["learned"]], folder)
    models = {
        name: _correct(folder, name, answer) for name, answer in (("traced", traced), ("learned", learned))
    }
    for log in folder.glob("*.mcap"):
        log.unlink()
    write_json(folder / _MODELS_DONE, models)
    return models


def _correct(folder: Path, name: str, answer: Answer) -> dict[str, Any]:
    """Make the feed-forward NAME.ff of a model; return its id and contents, or why there is none."""
    if answer.code or not (folder / MODELS[name]).is_file():
        return {"verdict": None, "reason": answer.errors.strip()}
    made = run_apart(["correct", MODELS[name], "--accept-undecided", "-o", f"{name}.ff"], folder)
    verdict = answer.data.get("verdict", made.data.get("verdict"))
    if made.code:
        return {"verdict": verdict, "reason": made.errors.strip()}
    contents = {key: made.data[key] for key in ("corrected", "uncorrected", "verdict")}
    return {"id": made.data["feedforward_id"], **contents}


def _fly(
    world: PlannedWorld, place: Path, reference: Path, index: int, vehicle: str, feedforward: Path | None
) -> tuple[Path, dict[str, Any]]:
    """Fly a reference in the world, and return log and answer."""
    name = "uncorrected" if feedforward is None else feedforward.stem
    logs = place / "flown"
    logs.mkdir(exist_ok=True)
    log, file = logs / f"{reference.stem}-{index}-{name}.mcap", place / "flown" / "world.toml"
    write_whole(file, world.toml().encode())
    words = ["fly", str(reference), "--vehicle", vehicle, "--world", str(file)]
    words += ["--world-seed", str(world.seed), "--flight", str(index), "--seed", str(index)]
    words += [] if feedforward is None else ["--feedforward", str(feedforward)]
    done = run_inside([*words, "-o", str(log), "--force"])
    if done.code not in (0, 1) or not log.is_file():
        raise StudyError(f"world {world.name}, flight {log.stem}: {done.errors.strip()}")
    return log, done.data
