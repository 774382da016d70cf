"""Run a study as pieces that do not depend on each other.

Each piece leaves a file, so an interrupted study resumes.
"""

from __future__ import annotations

import fcntl
import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError
from trimtab.host.base.output import json_text

ORDER, PIECES = "study.json", "pieces"

Report = Callable[[float, float, str], None]


@dataclass(frozen=True, kw_only=True)
class Piece:
    """One part of a study, named as the file that it leaves; `weight` is its share of the work."""

    name: str
    kind: str
    arguments: Mapping[str, Any]
    weight: float = 1.0


Work = Callable[[Piece, str], Any]
"""Compute the result of a piece, as plain data, from the piece and the study's folder. It can be pickled."""


def claim(folder: Path, order: Mapping[str, Any]) -> None:
    """Record which study the folder holds. Raises UsageError if it holds another one."""
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


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold the folder for this process. Raises UsageError if another one has it."""
    with (folder / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UsageError(f"{folder}: a study runs there already") from None
        yield


def run_pieces(
    pieces: Sequence[Piece],
    work: Work,
    *,
    folder: Path,
    order: Mapping[str, Any],
    jobs: int,
    report: Report = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Return the result of every piece, by name; compute those that have no file yet.

    `order` identifies the study that the folder holds. Raises UsageError if it holds another one.
    """
    (folder / PIECES).mkdir(parents=True, exist_ok=True)
    claim(folder, order)
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


def _leave(work: Work, piece: Piece, folder: str) -> None:
    """Write the result of a piece to its file."""
    write_atomic(_file(Path(folder), piece), json_text({"result": work(piece, folder)}), force=True)


def _file(folder: Path, piece: Piece) -> Path:
    return folder / PIECES / f"{piece.name}.json"
