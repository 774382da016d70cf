"""Studies as independent pieces. Each piece writes a file, so an interrupted study resumes."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError
from trimtab.host.base.output import json_text
from trimtab.host.base.shards import CONFIG, PIECES, Shard, ShardDone
from trimtab.host.base.workers import process_pool

OnProgress = Callable[[float, float, str], None]
"""Called with the work done, the total, and a detail text."""


@dataclass(frozen=True, kw_only=True)
class Piece:
    """One part of a study. `name` is also the name of its file; `weight` is its share of the work."""

    name: str
    kind: str
    arguments: Mapping[str, Any]
    weight: float = 1.0


Work = Callable[[Piece, str], Any]
"""Compute the result of a piece, as plain data, from the piece and the study's folder. It can be pickled."""


def claim(folder: Path, config: Mapping[str, Any]) -> None:
    """Record which study the folder holds. Raises UsageError if it holds another one."""
    path = folder / CONFIG
    if not path.is_file():
        write_atomic(path, json_text(config), force=True)
        return
    recorded = json.loads(path.read_text("utf-8"))
    different = [key for key in config if recorded.get(key) != config[key]]
    if different:
        raise UsageError(
            f"{folder}: holds a study with another {', '.join(different)}; choose another folder with -o"
        )


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Lock the folder for this process. Raises UsageError if another process has locked it."""
    with (folder / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UsageError(
                f"{folder}: another study is running in this folder; wait or choose another one"
            ) from None
        yield


def run_pieces(
    pieces: Sequence[Piece],
    work: Work,
    *,
    folder: Path,
    config: Mapping[str, Any],
    jobs: int,
    shard: Shard | None = None,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Compute every piece that has no file yet. Return the results of all pieces by name.

    `config` identifies the study that the folder holds. `shard`: compute its pieces alone. Raises UsageError
    if the folder holds another study, and ShardDone where pieces of other shards are missing at the end.
    """
    (folder / PIECES).mkdir(parents=True, exist_ok=True)
    claim(folder, config if shard is None else {**config, **shard.record()})
    wanted = pieces if shard is None else shard.of(pieces)
    total = sum(piece.weight for piece in wanted)
    waiting = [piece for piece in wanted if not _file(folder, piece).is_file()]
    done = total - sum(piece.weight for piece in waiting)
    on_progress(done, total, "")
    if waiting:
        with process_pool(jobs) as pool:
            running = {
                pool.submit(_write_result, work, piece, str(folder)): piece
                for piece in sorted(waiting, key=lambda piece: -piece.weight)
            }
            try:
                for future in as_completed(running):
                    future.result()
                    done += running[future].weight
                    on_progress(done, total, running[future].name)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    done_pieces = sum(_file(folder, piece).is_file() for piece in pieces)
    if shard is not None and done_pieces < len(pieces):
        raise ShardDone(shard, done_pieces, len(pieces))
    return {piece.name: json.loads(_file(folder, piece).read_text("utf-8")) for piece in pieces}


def _write_result(work: Work, piece: Piece, folder: str) -> None:
    """Write the result of a piece to its file."""
    write_atomic(_file(Path(folder), piece), json_text({"result": work(piece, folder)}), force=True)


def _file(folder: Path, piece: Piece) -> Path:
    return folder / PIECES / f"{piece.name}.json"
