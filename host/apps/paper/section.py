"""The study of a section of the paper, as pieces that do not depend on each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.vehicle import load_vehicle


def study_of(
    name: str,
    pieces: Callable[[int, int, bool], Sequence[Piece]],
    do: Callable[..., Any],
    summary: Callable[[Mapping[str, Any], Mapping[str, Any]], dict[str, Any]],
    *,
    worlds: int,
) -> Callable[..., dict[str, Any]]:
    """Return a study of pieces, as `host.studies` asks for one: what `summary` makes of its answer and its
    pieces.

    pieces(seed, worlds, quick): what it consists of. do(piece, folder, vehicle=, seed=): what a piece comes
    to. worlds: by default.
    """
    by_default = worlds

    def run(
        *,
        folder: Path,
        seed: int,
        vehicle: str,
        jobs: int,
        worlds: int = by_default,
        quick: bool = False,
        on_progress: OnProgress = lambda done, total, detail: None,
    ) -> dict[str, Any]:
        """Return the study's outcome: `answer` (the machine's object), `lines` (for people), `scores` (all
        pieces).

        quick: a small one, to see that everything works. Raises UsageError without a world, and where the
        folder holds another study.
        """
        if worlds < 1:
            raise UsageError(f"--worlds {worlds}: give 1 or more")
        folder = folder.absolute()
        config = {"study": name, "seed": seed, "vehicle": load_vehicle(vehicle).id, "quick": quick}
        work = partial(do, vehicle=vehicle, seed=seed)
        wanted = pieces(seed, worlds, quick)
        found = run_pieces(wanted, work, folder=folder, config=config, jobs=jobs, on_progress=on_progress)
        answer = {"study": name, "seed": seed, "worlds": worlds, "quick": quick, "folder": str(folder)}
        return {**summary(answer, found), "scores": found}

    return run
