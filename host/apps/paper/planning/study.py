"""`trimtab study paper-planning`: the paper's section on planning, with its numbers beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.planning import compare
from trimtab.host.apps.paper.planning.summary import summary
from trimtab.host.apps.paper.section import study_of
from trimtab.host.base.pieces import Piece
from trimtab.host.vehicle import load_vehicle

NAME = "paper-planning"
WORLDS, COURSES, PLANNED = 5, 4, 20
"""Sealed worlds, held-out courses flown in each, courses planned under the known drag."""


def plan_pieces(worlds: int, courses: int, planned: int) -> list[Piece]:
    """Return the pieces of a study."""
    pieces = [Piece(name=f"planned-{k:02d}", kind="planned", arguments={"index": k}) for k in range(planned)]
    for world in range(worlds):
        arguments = {"world": world, "courses": courses}
        pieces.append(
            Piece(name=f"world-{world:02d}", kind="world", arguments=arguments, weight=8.0 + 5.0 * courses)
        )
    return pieces


def do(piece: Piece, folder: str, *, vehicle: str, seed: int) -> Any:
    """Return the result of a piece."""
    craft = load_vehicle(vehicle)
    if piece.kind == "planned":
        return compare.planned(craft, seed, **piece.arguments)
    place = Path(folder) / "worlds" / f"{piece.arguments['world']:02d}"
    return compare.flown(place, craft, seed, **piece.arguments)


run = study_of(
    NAME,
    lambda seed, worlds, quick: plan_pieces(
        1 if quick else worlds, 1 if quick else COURSES, 2 if quick else PLANNED
    ),
    do,
    summary,
    worlds=WORLDS,
)
