"""A study as a list of pieces that do not depend on each other.

Each leaves a file, so a run that was cut short goes on where it was.
"""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError
from trimtab.host.base.output import json_text
from trimtab.host.vehicle import load_vehicle

ORDER, PIECES = "study.json", "pieces"

Report = Callable[[float, float, str], None]


@dataclass(frozen=True, kw_only=True)
class Piece:
    """One part of a study, by the name of the file it leaves; weight is its share of the work."""

    name: str
    kind: str
    arguments: Mapping[str, Any]
    weight: float = 1.0


Work = Callable[[Piece, str], Any]
"""What a piece comes to, as plain data, from it and the study's folder; it can be pickled."""


def run_pieces(
    pieces: Sequence[Piece],
    work: Work,
    *,
    folder: Path,
    order: Mapping[str, Any],
    jobs: int,
    report: Report = lambda done, total, detail: None,
) -> dict[str, Any]:
    """What every piece came to, by name; those whose files are there are not done again.

    `order` says which study the folder holds. Raises UsageError where it holds another.
    """
    (folder / PIECES).mkdir(parents=True, exist_ok=True)
    _same_order(folder, order)
    total = sum(piece.weight for piece in pieces)
    waiting = [piece for piece in pieces if not _file(folder, piece).is_file()]
    done = total - sum(piece.weight for piece in waiting)
    report(done, total, "")
    if waiting:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            running = {
                pool.submit(_leave, work, piece, str(folder)): piece
                for piece in sorted(waiting, key=lambda piece: -piece.weight)
            }
            try:
                for future in as_completed(running):
                    future.result()
                    done += running[future].weight
                    report(done, total, running[future].name)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    return {piece.name: json.loads(_file(folder, piece).read_text("utf-8")) for piece in pieces}


def study_of(
    name: str,
    pieces: Callable[[int, int, bool], Sequence[Piece]],
    do: Callable[..., Any],
    summary: Callable[[Mapping[str, Any], Mapping[str, Any]], dict[str, Any]],
    *,
    worlds: int,
) -> Callable[..., dict[str, Any]]:
    """A study of pieces, as `host.studies` asks for one: what `summary` makes of its answer and its pieces.

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
        report: Report = lambda done, total, detail: None,
    ) -> dict[str, Any]:
        """The study's outcome: `answer` (the machine's object), `lines` (for people), `scores` (all pieces).

        quick: a small one, to see that everything works. Raises UsageError without a world, and where the
        folder holds another study.
        """
        if worlds < 1:
            raise UsageError(f"--worlds {worlds}: give 1 or more")
        folder = folder.absolute()
        order = {"study": name, "seed": seed, "vehicle": load_vehicle(vehicle).id, "quick": quick}
        work = partial(do, vehicle=vehicle, seed=seed)
        wanted = pieces(seed, worlds, quick)
        found = run_pieces(wanted, work, folder=folder, order=order, jobs=jobs, report=report)
        answer = {"study": name, "seed": seed, "worlds": worlds, "quick": quick, "folder": str(folder)}
        return {**summary(answer, found), "scores": found}

    return run


def _leave(work: Work, piece: Piece, folder: str) -> None:
    """Nothing comes back; the piece's file is in the study's folder."""
    write_atomic(_file(Path(folder), piece), json_text({"result": work(piece, folder)}), force=True)


def _same_order(folder: Path, order: Mapping[str, Any]) -> None:
    """Nothing comes back; the folder's study is this one. Raises UsageError where it is another."""
    path = folder / ORDER
    if not path.is_file():
        write_atomic(path, json_text(order), force=True)
        return
    before = json.loads(path.read_text("utf-8"))
    different = [key for key in order if before.get(key) != order[key]]
    if different:
        raise UsageError(
            f"{folder}: holds a study with another {', '.join(different)}; choose another folder with -o"
        )


def _file(folder: Path, piece: Piece) -> Path:
    return folder / PIECES / f"{piece.name}.json"
