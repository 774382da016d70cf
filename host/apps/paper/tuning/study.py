"""`trimtab study controller-tuning`: what the settings in the controller files are tuned by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.apps.paper.tuning.points import NAME, flight_spread, fly_point, score
from trimtab.host.apps.paper.tuning.search import search_coordinate
from trimtab.host.apps.paper.tuning.summary import markdown, summary
from trimtab.host.apps.paper.tuning.table import FULL, QUICK, Parameter, Search
from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import FlightFailed
from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.vehicle import Vehicle, load_vehicle

MARKDOWN_NAME = "points.md"


def do(piece: Piece, folder: str, *, vehicle: str, seed: int, quick: bool) -> Any:
    """Return the result of a piece."""
    searches = {each.name: each for each in (QUICK if quick else FULL)}
    arguments = dict(piece.arguments)
    parameters = searches[arguments.pop("search")].of(arguments["controller"])
    flown = fly_point(
        Path(folder), load_vehicle(vehicle), seed, parameters=parameters, quick=quick, **arguments
    )
    return {**piece.arguments, **flown}


@dataclass(kw_only=True)
class Points:
    """Points of a study's searches, flown as needed. `found` holds the results of all pieces by name."""

    folder: Path
    config: Mapping[str, Any]
    vehicle: str
    jobs: int
    on_progress: OnProgress
    total: float
    found: dict[str, Any] = field(default_factory=dict)

    def fly(self, pieces: Sequence[Piece]) -> None:
        """Compute the pieces that are not found yet."""
        waiting = [piece for piece in pieces if piece.name not in self.found]
        before = float(len(self.found))
        work = partial(do, vehicle=self.vehicle, seed=self.config["seed"], quick=self.config["quick"])
        self.found |= run_pieces(
            waiting,
            work,
            folder=self.folder,
            config=self.config,
            jobs=self.jobs,
            on_progress=lambda done, total, detail: self.on_progress(
                before + done, max(self.total, before + total), detail
            ),
        )

    def errors_m(self, piece: Piece) -> list[float | None]:
        """Return the mean error of each flight of a point; None for a flight that failed."""
        return self.found[piece.name]["result"]["errors_m"]


def piece_of(search: Search, controller: str, factors: Mapping[str, float], repetition: int = 0) -> Piece:
    """Return the point of a controller, whose name holds all its factors."""
    own = {each.name: factors[each.name] for each in search.of(controller)}
    labels = "".join(f"_{name}-{factor:g}" for name, factor in own.items())
    return Piece(
        name=f"{controller}{labels}_{repetition}",
        kind="point",
        arguments={
            "search": search.name,
            "controller": controller,
            "factors": own,
            "repetition": repetition,
        },
    )


def tune(search: Search, points: Points) -> dict[str, Any]:
    """Search the parameters of controllers one after the other.

    Returns the flight-to-flight `spread` of the log error, and for every parameter its `factor`, the `best`
    factor and the `gain` of that. Raises FlightFailed if a controller does not fly the courses at the start.
    """
    factors = {each.name: 1.0 for each in search.parameters}
    repeated = [[piece_of(search, name, factors, k) for k in (0, 1)] for name in search.files]
    points.fly([piece for pair in repeated for piece in pair])
    errors = [[points.errors_m(piece) for piece in pair] for pair in repeated]
    if any(None in each for pair in errors for each in pair):
        raise FlightFailed(f"{search.name}: a flight with the start values failed; see the pieces' files")
    spread = flight_spread([(first, second) for first, second in errors])
    parameters = {}
    for each in search.parameters:
        outcome = search_coordinate(
            partial(_scores, points, search, each, dict(factors), spread), each.factors, spread
        )
        factors[each.name] = outcome.factor
        parameters[each.name] = {"factor": outcome.factor, "best": outcome.best, "gain": outcome.gain}
    return {"spread": spread, "parameters": parameters}


def _scores(
    points: Points,
    search: Search,
    parameter: Parameter,
    start: Mapping[str, float],
    spread: float,
    candidates: Sequence[float],
) -> list[float]:
    """Return the mean score of the parameter's controllers at each factor, other parameters as in `start`."""
    rows = [
        [piece_of(search, file, {**start, parameter.name: factor}) for file in parameter.files]
        for factor in candidates
    ]
    points.fly([piece for row in rows for piece in row])
    before = [points.errors_m(piece_of(search, file, start)) for file in parameter.files]
    return [
        float(
            np.mean(
                [score(points.errors_m(piece), at, spread) for piece, at in zip(row, before, strict=True)]
            )
        )
        for row in rows
    ]


def _start(searches: Sequence[Search]) -> float:
    """Return the number of points if every search stays at its start."""
    return float(
        sum(
            2 * len(search.files) + sum(2 * len(each.files) for each in search.parameters)
            for search in searches
        )
    )


def run(
    *,
    folder: Path,
    seed: int,
    vehicle: str,
    jobs: int,
    quick: bool = False,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Run the study; also write the table of all points to `folder`/points.md.

    `seed` chooses noise, turbulence and radio; the worlds are fixed. Returns `answer` (the JSON object),
    `tables`, `lines` and `scores` (all points). Raises UsageError if the folder holds another study.
    """
    folder = folder.absolute()
    craft: Vehicle = load_vehicle(vehicle)
    searches = QUICK if quick else FULL
    points = Points(
        folder=folder,
        config={"study": NAME, "seed": seed, "vehicle": craft.id, "quick": quick},
        vehicle=vehicle,
        jobs=jobs,
        on_progress=on_progress,
        total=_start(searches),
    )
    tuned = {search.name: tune(search, points) for search in searches}
    answer = {"study": NAME, "seed": seed, "quick": quick, "folder": str(folder)}
    outcome = summary(answer, searches, tuned, points.found, craft)
    write_atomic(folder / MARKDOWN_NAME, markdown(outcome["tables"]), force=True)
    return {**outcome, "scores": points.found}
