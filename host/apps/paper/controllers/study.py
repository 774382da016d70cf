"""`trimtab study paper-controllers`: the paper's controllers and trajectories, flown and compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.controllers.design import COURSES
from trimtab.host.apps.paper.controllers.needs import COUNTS, EXCITATIONS, needs
from trimtab.host.apps.paper.controllers.pieces import RADIO, RICH, WIRED, balanced, front, full, select
from trimtab.host.apps.paper.controllers.summary import summary
from trimtab.host.apps.paper.section import study_of
from trimtab.host.base.pieces import Piece
from trimtab.host.vehicle import load_vehicle

NAME = "paper-controllers"
WORLDS = 5


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Size of a study.

    full: courses like the paper's in each setting. select: tuning courses that select the baseline's
    trajectory. courses: of the balanced design, in each world. front: courses of each world for the weights'
    front. needs: worlds of networks to learn. needs_courses: that each network's plans are flown on.
    """

    full: Mapping[str, int]
    select: int
    courses: int
    front: int
    needs: int
    counts: tuple[int, ...]
    needs_courses: int


FULL = Scope(
    full={RADIO: 3, WIRED: 1, RICH: 1},
    select=3,
    courses=COURSES,
    front=2,
    needs=2,
    counts=COUNTS,
    needs_courses=3,
)
QUICK = Scope(full={RADIO: 1}, select=1, courses=1, front=1, needs=1, counts=COUNTS[:1], needs_courses=1)


def plan_pieces(worlds: int, scope: Scope) -> list[Piece]:
    """Return the pieces of a study.

    Neighbours are of different worlds, so that few processes wait for the models of the same one.
    """
    return [*_full(scope), *_balanced(worlds, scope), *_needs(scope)]


def _full(scope: Scope) -> list[Piece]:
    """Return the tuning courses: those like the paper's, and those that select the baseline's trajectory."""
    courses = [(k, setting) for setting, count in scope.full.items() for k in range(count)]
    selecting = [
        Piece(name=f"select-{k}", kind="select", arguments={"course": k}, weight=30.0)
        for k in range(scope.select)
    ]
    return selecting + [
        Piece(
            name=f"full-{setting}-{k}", kind="full", arguments={"course": k, "setting": setting}, weight=100.0
        )
        for k, setting in sorted(courses)
    ]


def _balanced(worlds: int, scope: Scope) -> list[Piece]:
    """Return the courses of the balanced design, and the weights' front on some of them."""
    design = [
        Piece(
            name=f"balanced-{world:02d}-{course}",
            kind="balanced",
            arguments={"world": world, "course": course},
            weight=80.0,
        )
        for course in range(scope.courses)
        for world in range(worlds)
    ]
    fronts = [
        Piece(
            name=f"front-{world:02d}",
            kind="front",
            arguments={"world": world, "courses": scope.front},
            weight=10.0 * scope.front,
        )
        for world in range(worlds)
    ]
    return design + fronts


def _needs(scope: Scope) -> list[Piece]:
    return [
        Piece(
            name=f"needs-{world:02d}-{excitation}",
            kind="needs",
            arguments={
                "world": world,
                "excitation": excitation,
                "counts": scope.counts,
                "courses": scope.needs_courses,
            },
            weight=60.0 * len(scope.counts),
        )
        for world in range(scope.needs)
        for excitation in EXCITATIONS
    ]


def do(piece: Piece, folder: str, *, vehicle: str, seed: int) -> Any:
    """Return the result of a piece."""
    craft, place = load_vehicle(vehicle), Path(folder)
    logs = place / "logs" / piece.name
    if piece.kind == "needs":
        return needs(logs, craft, seed, **piece.arguments)
    work = {"full": full, "select": select, "balanced": balanced, "front": front}[piece.kind]
    return work(place / "worlds", logs, craft, seed, **piece.arguments)


run = study_of(
    NAME,
    lambda seed, worlds, quick: plan_pieces(1 if quick else worlds, QUICK if quick else FULL),
    do,
    summary,
    worlds=WORLDS,
)
