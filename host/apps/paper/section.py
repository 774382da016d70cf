"""Study of a section of the paper, as independent pieces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.base.shards import Shard
from trimtab.host.vehicle import load_vehicle


def study_of(
    name: str,
    pieces: Callable[[int, int, bool], Sequence[Piece]],
    do: Callable[..., Any],
    summary: Callable[[Mapping[str, Any], Mapping[str, Any]], dict[str, Any]],
    *,
    worlds: int,
) -> Callable[..., dict[str, Any]]:
    """Return a study of pieces with the interface of `host.studies.Study`.

    `pieces(seed, worlds, quick)` returns the pieces, `do(piece, folder, vehicle=, seed=)` the result of a
    piece, and `summary` the outcome. `worlds` is the default number of worlds.
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
        shard: Shard | None = None,
        on_progress: OnProgress = lambda done, total, detail: None,
    ) -> dict[str, Any]:
        """Run the study and return its outcome: `answer` (the JSON object), `lines`, `scores` (all pieces).

        With `quick`, run a small study to check that everything works. Raises UsageError for fewer worlds
        than one, or if the folder holds another study.
        """
        if worlds < 1:
            raise UsageError(f"--worlds {worlds}: give 1 or more")
        folder = folder.absolute()
        config = {"study": name, "seed": seed, "vehicle": load_vehicle(vehicle).id, "quick": quick}
        work = partial(do, vehicle=vehicle, seed=seed)
        wanted = pieces(seed, worlds, quick)
        found = run_pieces(
            wanted, work, folder=folder, config=config, jobs=jobs, shard=shard, on_progress=on_progress
        )
        answer = {"study": name, "seed": seed, "worlds": worlds, "quick": quick, "folder": str(folder)}
        return {**summary(answer, found), "scores": found}

    return run
