"""`trimtab study paper-learning`: the paper's section on learning, with its numbers beside ours."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.learning import curves, flown, noise, transfer
from trimtab.host.apps.paper.learning.flights import Flights, make_flights
from trimtab.host.apps.paper.learning.measure import acceleration_error
from trimtab.host.apps.paper.learning.methods import BODY, CLOSED, LONG, REGRESSORS, SHORT, WORLD, learn_exact
from trimtab.host.apps.paper.learning.summary import summary
from trimtab.host.apps.paper.section import study_of
from trimtab.host.base.pieces import Piece
from trimtab.host.vehicle import load_vehicle

NAME = "paper-learning"
WORLDS = 5

_BY_NAME = {regressor.name: regressor for regressor in REGRESSORS}


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Size of the study: trials of a curve, epochs, seeds, iterations, scales of noise."""

    trials: int
    epochs: int
    seeds: int
    iterations: tuple[int, ...]
    scales: tuple[float, ...]
    noisy: tuple[str, ...]


FULL = Scope(
    trials=5,
    epochs=100,
    seeds=3,
    iterations=(SHORT, LONG),
    scales=(0.0, 1.0, 2.0, 5.0),
    noisy=(CLOSED.name, BODY.name, WORLD.name),
)
QUICK = Scope(
    trials=2, epochs=20, seeds=1, iterations=(60,), scales=(1.0, 5.0), noisy=(CLOSED.name, BODY.name)
)


def plan(seed: int, worlds: int, scope: Scope) -> list[Piece]:
    """Return the pieces of a study."""
    pieces = [Piece(name="nominal", kind="nominal", arguments={}, weight=0.3)]
    for weight, held in ((curves.IDENTITY, False), (curves.IDENTITY, True), (curves.FIRST_SIX, False)):
        for k in range(scope.trials):
            arguments = {"weight": weight, "held": held, "seed": seed + k, "epochs": scope.epochs}
            name = f"curve-{weight.replace(' ', '-')}-{'held' if held else 'moving'}-{k}"
            pieces.append(Piece(name=name, kind="curve", arguments=arguments))
    for regressor in REGRESSORS:
        for k in range(scope.seeds if regressor.layout is not None else 1):
            for iterations in scope.iterations:
                arguments = {"regressor": regressor.name, "seed": seed + k, "iterations": iterations}
                name = f"regressor-{_slug(regressor.name)}-{iterations}-{k}"
                weight = iterations / 150.0 if regressor.layout is not None else 0.8
                pieces.append(Piece(name=name, kind="regressor", arguments=arguments, weight=weight))
    for regressor_name in scope.noisy:
        for scale in scope.scales:
            for k in range(scope.seeds):
                arguments = {"regressor": regressor_name, "scale": scale, "seed": seed + k}
                arguments["iterations"] = min(scope.iterations)
                name = f"noise-{_slug(regressor_name)}-{scale:g}-{k}"
                pieces.append(Piece(name=name, kind="noise", arguments=arguments, weight=4.0))
    arguments = {"seed": seed, "iterations": min(scope.iterations)}
    pieces.append(Piece(name="transfer", kind="transfer", arguments=arguments, weight=5.0))
    for world in range(worlds):
        name = f"world-{world:02d}"
        pieces.append(Piece(name=name, kind="world", arguments={"world": world, "seed": seed}, weight=15.0))
    return pieces


def do(piece: Piece, folder: str, *, vehicle: str, seed: int) -> Any:
    """Return the result of a piece."""
    craft = load_vehicle(vehicle)
    if piece.kind == "world":
        place = Path(folder) / "worlds" / f"{piece.arguments['world']:02d}"
        return flown.fly_and_learn(place, craft, **piece.arguments)
    return _KINDS[piece.kind](make_flights(craft, seed), **piece.arguments)


def _nominal(sets: dict[str, Flights]) -> dict[str, Any]:
    return {name: error.to_json() for name, error in curves.nominal_errors(sets).items()}


def _regressor(sets: dict[str, Flights], regressor: str, seed: int, iterations: int) -> dict[str, Any]:
    """One regressor on exact data: seconds of learning, errors by set."""
    chosen = _BY_NAME[regressor]
    found = learn_exact(sets["train"], sets["validation"], chosen, seed, iterations=iterations)
    errors = {name: acceleration_error(found.candidate, sets[name]).to_json() for name in curves.SETS}
    return {
        "regressor": regressor,
        "seed": seed,
        "iterations": iterations,
        "seconds": found.seconds,
        "errors": errors,
    }


def _noise(sets: dict[str, Flights], regressor: str, **arguments: Any) -> list[dict[str, Any]]:
    return noise.compare(sets, _BY_NAME[regressor], **arguments)


def _transfer(sets: dict[str, Flights], seed: int, iterations: int) -> dict[str, Any]:
    """Of the paper's network learned from exact data."""
    found = learn_exact(sets["train"], sets["validation"], WORLD, seed, iterations=iterations)
    return {
        "steps": transfer.steps(found.candidate, sets["test"]),
        "laws": transfer.laws(found.candidate, sets, seed, iterations),
    }


_KINDS: Mapping[str, Callable[..., Any]] = {
    "nominal": _nominal,
    "curve": curves.trial,
    "regressor": _regressor,
    "noise": _noise,
    "transfer": _transfer,
}


def _slug(name: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in name.lower()).replace("--", "-").strip("-")


run = study_of(
    NAME,
    lambda seed, worlds, quick: plan(seed, 1 if quick else worlds, QUICK if quick else FULL),
    do,
    summary,
    worlds=WORLDS,
)
