"""Calibrate the measured rules of tracing on simulated worlds without effects.

    trimtab study calibrate --seed 1

Such a world differs from the model only by turbulence, noise and deviations within tolerance, so anything
that tracing finds is chance. The seeds of the worlds come from a separate hash; no other study flies them.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.base.shards import Shard
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.files import read_json
from trimtab.sitl.studies.flights import BLIND, TRUTH, Programme, fly_and_seal, plan_references
from trimtab.sitl.studies.scoring.calibration import Measured, measure, rules_in_force
from trimtab.sitl.studies.worlds import CALM, PlannedWorld

NAME = "calibrate"
WORLDS = 20
TRACED = replace(BLIND, held_out=())
"""Flights in every world: the blind study's references twice, none held out."""
DRAWS = 1000
"""Number of bootstrap draws over worlds for each interval."""


def run(
    *,
    folder: Path,
    seed: int,
    vehicle: str,
    jobs: int,
    worlds: int = WORLDS,
    programme: Programme = TRACED,
    shard: Shard | None = None,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Measure each rule in the worlds, and return the outcome: `answer`, `lines`, `tables` and `scores`.

    Parameters
    ----------
    folder
        State and results; an interrupted study resumes.
    worlds
        Number of worlds, at least two.
    programme
        Flights in every world.

    Raises
    ------
    UsageError
        Fewer than two worlds, or the folder holds another study.
    StudyError
        A route cannot be planned or a world cannot be flown.
    """
    if worlds < 2:
        raise UsageError(f"--worlds {worlds}: give 2 or more")
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    config = {"study": NAME, "seed": seed, "vehicle": load_vehicle(vehicle).id}
    plan_references(folder, vehicle, programme)
    names = [f"{index:04d}" for index in range(worlds)]
    results = run_pieces(
        [Piece(name=name, kind="world", arguments={"index": i}) for i, name in enumerate(names)],
        partial(_measure_world, seed=seed, vehicle=vehicle, programme=programme),
        folder=folder,
        config=config,
        jobs=jobs,
        shard=shard,
        on_progress=on_progress,
    )
    scores = {name: results[name]["result"] for name in names}
    rows = calibrated(list(scores.values()), seed)
    return {
        "answer": {"study": NAME, "seed": seed, "worlds": worlds, "folder": str(folder), "rules": rows},
        "lines": [
            "{rule}: {measured} ({interval}), in force {in_force}".format(**cells)
            for cells in (_cells(name, row) for name, row in rows.items())
        ],
        "tables": {"Measured rules": [_cells(name, row) for name, row in rows.items()]},
        "scores": scores,
    }


def planned_world(seed: int, index: int) -> PlannedWorld:
    """Return a world without effects; its seed and turbulence come from the study's seed and its index."""
    digest = hashlib.sha256(f"calibration {seed} world {index}".encode()).digest()
    rng = np.random.default_rng([seed, index])
    low, high = (math.log(bound) for bound in CALM)
    return PlannedWorld(
        name=f"{index:04d}",
        kind_class="none",
        kinds=(),
        seed=int.from_bytes(digest[:6], "big"),
        turbulence=math.exp(rng.uniform(low, high)),
    )


def _measure_world(
    piece: Piece, folder: str, *, seed: int, vehicle: str, programme: Programme
) -> dict[str, float]:
    """Fly the world of a piece, and return the quantities measured from its flights."""
    world = planned_world(seed, piece.arguments["index"])
    place = Path(folder) / "worlds" / world.name
    place.mkdir(parents=True, exist_ok=True)
    if not (place / TRUTH).is_file():
        fly_and_seal(world, place, Path(folder) / "references", vehicle, programme)
    logs = [place / "flights" / log for log in programme.logs(programme.learning)]
    return measure(logs, load_vehicle(vehicle), read_json(place / TRUTH)["deviations"])._asdict()


def calibrated(scores: Sequence[Mapping[str, float]], seed: int) -> dict[str, dict[str, float]]:
    """Return for each measured rule the value in force, the measured value and its 95 % interval.

    The interval is from a bootstrap over worlds; the numbers of a world stay together.
    """
    table = np.array([[score[name] for name in Measured._fields] for score in scores])
    rng = np.random.default_rng(seed)
    draws = rng.integers(len(table), size=(DRAWS, len(table)))
    estimate, spread = rules_of(table), np.array([rules_of(table[draw]) for draw in draws])
    low, high = np.quantile(spread, [0.025, 0.975], axis=0)
    return {
        name: {
            "in_force": value,
            "measured": float(estimate[k]),
            "low": float(low[k]),
            "high": float(high[k]),
        }
        for k, (name, value) in enumerate(rules_in_force().items())
    }


def rules_of(table: np.ndarray) -> np.ndarray:
    """Return the rules (6,) of `rules_in_force` from the worlds' numbers (worlds, 6).

    The share is the 95 % quantile over worlds, so that chance exceeds it in one world in twenty. The tempers
    are mean powers. The widening is a root mean square.
    """
    share, *powers, error = table.T
    return np.array([np.quantile(share, 0.95), *np.mean(powers, axis=1), np.sqrt(error.mean())])


def _cells(name: str, row: Mapping[str, float]) -> dict[str, str]:
    """Return the row of a rule in the report."""
    return {
        "rule": name,
        "in_force": f"{row['in_force']:.3g}",
        "measured": f"{row['measured']:.3g}",
        "interval": f"{row['low']:.3g} to {row['high']:.3g}",
    }
