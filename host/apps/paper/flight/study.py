"""`trimtab study paper-flight`: the paper's section VI through the whole chain, its numbers beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.flight.models import PAPER_SETTINGS
from trimtab.host.apps.paper.flight.summary import summary
from trimtab.host.apps.paper.flight.world import fly_world
from trimtab.host.apps.paper.section import study_of
from trimtab.host.base.pieces import Piece
from trimtab.host.vehicle import load_vehicle

NAME = "paper-flight"
WORLDS, PRETZELS, QUICK_PRETZELS = 5, 4, 2
"""Sealed worlds; flights of each plan by each controller in a world, in full and with --quick."""


def plan_pieces(worlds: int, pretzels: int, epochs: int) -> list[Piece]:
    """Return the pieces of a study, one for each world."""
    return [
        Piece(
            name=f"world-{world:02d}",
            kind="world",
            arguments={"world": world, "pretzels": pretzels, "epochs": epochs},
        )
        for world in range(worlds)
    ]


def do(piece: Piece, folder: str, *, vehicle: str, seed: int) -> Any:
    """Return the result of a piece."""
    place = Path(folder) / "worlds" / f"{piece.arguments['world']:02d}"
    return fly_world(place, load_vehicle(vehicle), seed, **piece.arguments)


run = study_of(
    NAME,
    lambda seed, worlds, quick: plan_pieces(
        1 if quick else worlds, QUICK_PRETZELS if quick else PRETZELS, PAPER_SETTINGS.epochs
    ),
    do,
    summary,
    worlds=WORLDS,
)
