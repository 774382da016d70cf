"""Recorded flights in the blind study: groups of logs that are traced, with some held out.

There is no truth to compare a verdict with. The score is the error on the held-out flights.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from trimtab.host.vehicle.strict_toml import Strict, read_strict
from trimtab.sitl.studies.commandline import run_apart
from trimtab.sitl.studies.files import StudyError, read_json, sha256_of, write_json
from trimtab.sitl.studies.flights import VERDICT, ask

REAL = "real"


class Group(Strict):
    """Logs that are traced together. Paths are absolute, or relative to the file with the group."""

    name: str
    logs: Annotated[tuple[str, ...], Field(min_length=1)]
    hold_out: tuple[str, ...] = ()
    format: str | None = None
    """Format of `trimtab import` for the logs. Without one, they are Trimtab flight logs."""
    columns: str | None = None
    """Column map of the format csv."""
    vehicle: str | None = None
    """Vehicle of imported flights: a name, or the path of a vehicle file. Mandatory with a format."""

    @model_validator(mode="after")
    def _belongs_together(self) -> Group:
        if (self.format == "csv") != (self.columns is not None):
            raise ValueError("the format csv needs columns, and no other format takes them")
        if self.format is not None and self.vehicle is None:
            raise ValueError("a format needs the vehicle that flew; add vehicle")
        stems = [Path(log).stem for log in (*self.logs, *self.hold_out)]
        if len(set(stems)) != len(stems):
            raise ValueError("two logs have the same name; rename one of them")
        return self


class RealFlights(Strict):
    """Content of the file for `--real`."""

    group: Annotated[tuple[Group, ...], Field(min_length=1)]


def read_groups(path: Path) -> list[Group]:
    """Return the groups of a file, with absolute paths.

    Raises StudyError if the file or a log does not exist, ConfigurationError if the content is invalid.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror}); give a TOML file with groups") from None
    folder = path.absolute().parent
    groups = []
    for group in read_strict(text, str(path), RealFlights).group:
        logs, held_out = (tuple(str(folder / log) for log in some) for some in (group.logs, group.hold_out))
        columns = None if group.columns is None else str(folder / group.columns)
        for file in (*logs, *held_out, *(() if columns is None else (columns,))):
            if not Path(file).is_file():
                raise StudyError(f"{path}: {group.name}: {file} does not exist")
        paths = {"logs": logs, "hold_out": held_out, "columns": columns}
        vehicle = group.vehicle
        if vehicle is not None and (folder / vehicle).is_file():
            vehicle = str(folder / vehicle)
        groups.append(group.model_copy(update={**paths, "vehicle": vehicle}))
    return groups


def judge_real(
    groups: Sequence[Group], folder: Path, on_progress: Callable[[str], None] = lambda _: None
) -> list[dict[str, Any]]:
    """Trace each group and return a row of plain data for it, see `real_row`.

    Earlier results for the same files are read from `folder`. Raises StudyError if a log cannot be imported.
    """
    rows = []
    for index, group in enumerate(groups):
        rows.append(real_row(group, _verdict(group, folder / REAL / f"{index:02d}")))
        on_progress(f"{group.name}: {rows[-1]['verdict']}")
    return rows


def _verdict(group: Group, folder: Path) -> dict[str, Any]:
    """Return the verdict on the group, traced once for the same files and settings."""
    inputs = [*group.logs, *group.hold_out, *([] if group.columns is None else [group.columns])]
    asked = {**group.model_dump(mode="json"), "sha256": {path: sha256_of(Path(path)) for path in inputs}}
    if (folder / VERDICT).is_file():
        before = read_json(folder / VERDICT)
        if before["asked"] == asked:
            return before
    bare = folder / "trace"
    shutil.rmtree(bare, ignore_errors=True)
    bare.mkdir(parents=True)
    for path in (*group.logs, *group.hold_out):
        _bring_in(group, path, bare)
    logs, held_out = ([f"{Path(log).stem}.mcap" for log in which] for which in (group.logs, group.hold_out))
    verdict = {"asked": asked, **ask(bare, logs, held_out)}
    write_json(folder / VERDICT, verdict)
    shutil.rmtree(bare)
    return verdict


def _bring_in(group: Group, path: str, folder: Path) -> None:
    """Copy or import the log into `folder` as a Trimtab flight log."""
    target = f"{Path(path).stem}.mcap"
    if group.format is None:
        shutil.copyfile(path, folder / target)
        return
    assert group.vehicle is not None  # a group with a format has one
    words = ["import", group.format, path, "--vehicle", group.vehicle, "-o", target]
    if group.columns is not None:
        words += ["--columns", group.columns]
    done = run_apart(words, folder)
    if done.code:
        raise StudyError(f"{group.name}: {done.errors.strip()}")


def real_row(group: Group, verdict: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row of a group in the study's results, from its verdict."""
    answer = verdict["answer"]
    before, after = answer.get("before") or {}, answer.get("after") or {}
    return {
        "name": group.name,
        "used": [Path(log).stem for log in group.logs],
        "held_out": [Path(log).stem for log in group.hold_out],
        "verdict": answer.get("verdict", "failed"),
        "effects": [
            {key: effect[key] for key in ("name", "parameters", "aliases")}
            for effect in answer.get("effects", ())
        ],
        "doubts": [*answer.get("doubts", ()), *answer.get("reasons", ())],
        "errors": verdict["errors"][-500:] if verdict["exit_code"] else "",
        "before_m": before.get("position_rmse_m"),
        "after_m": after.get("position_rmse_m"),
        "trace_s": verdict["trace_s"],
    }
