"""Flights that somebody flew, beside the drawn worlds: groups of logs, traced, one or more held out.

There is no truth to hold a verdict against; what counts is the error on flights that were not used.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from trimtab.host.vehicle.strict_toml import Strict, read_strict
from trimtab.sitl.studies.commandline import run_apart
from trimtab.sitl.studies.files import StudyError, read_json, sha256_of, write_json
from trimtab.sitl.studies.flights import VERDICT, ask

REAL = "real"


class Group(Strict):
    """Logs that are traced together. Paths are absolute or start at the file that names them."""

    name: str
    logs: Annotated[tuple[str, ...], Field(min_length=1)]
    hold_out: tuple[str, ...] = ()
    profile: Literal["nanobench", "crazyflie-usd", "csv"] | None = None
    """How `trimtab import` reads the logs; without one they are flight logs already."""
    columns: str | None = None
    """Column map of the profile csv."""
    vehicle: str = "nano"
    """What is imported is a flight of it: a name, or the path of a vehicle file."""

    @model_validator(mode="after")
    def _belongs_together(self) -> Group:
        if (self.profile == "csv") != (self.columns is not None):
            raise ValueError("columns go with the profile csv, and only with it")
        stems = [Path(log).stem for log in (*self.logs, *self.hold_out)]
        if len(set(stems)) != len(stems):
            raise ValueError("two logs of one name, rename one of them")
        return self


class RealFlights(Strict):
    """The file that `--real` takes."""

    group: Annotated[tuple[Group, ...], Field(min_length=1)]


def read_groups(path: Path) -> list[Group]:
    """Return the groups of a file, with absolute paths.

    Raises StudyError where the file or a log is not there, ConfigurationError where it says something wrong.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror}), give a file of groups") from None
    folder = path.absolute().parent
    found = []
    for group in read_strict(text, str(path), RealFlights).group:
        logs, held_out = (tuple(str(folder / log) for log in some) for some in (group.logs, group.hold_out))
        columns = None if group.columns is None else str(folder / group.columns)
        own = folder / group.vehicle
        for file in (*logs, *held_out, *(() if columns is None else (columns,))):
            if not Path(file).is_file():
                raise StudyError(f"{path}: {group.name}: {file} is not there")
        paths = {"logs": logs, "hold_out": held_out, "columns": columns}
        vehicle = str(own) if own.is_file() else group.vehicle
        found.append(group.model_copy(update={**paths, "vehicle": vehicle}))
    return found


def judge_real(
    groups: Sequence[Group], folder: Path, on_progress: Callable[[str], None] = lambda _: None
) -> list[dict[str, Any]]:
    """Return a row of plain data for each group: name, used, held_out, verdict, effects, before_m, after_m,
    trace_s.

    What was traced before, of the same files, is taken from `folder`. Raises StudyError where a log is no
    flight.
    """
    rows = []
    for index, group in enumerate(groups):
        rows.append(real_row(group, _verdict(group, folder / REAL / f"{index:02d}")))
        on_progress(f"{group.name}: {rows[-1]['verdict']}")
    return rows


def _verdict(group: Group, folder: Path) -> dict[str, Any]:
    """Return what tracing says of the group, made once for the same files and settings."""
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
    """Import the log into `folder` as a flight log of the project's own."""
    target = f"{Path(path).stem}.mcap"
    if group.profile is None:
        shutil.copyfile(path, folder / target)
        return
    words = ["import", group.profile, path, "--vehicle", group.vehicle, "-o", target]
    if group.columns is not None:
        words += ["--columns", group.columns]
    done = run_apart(words, folder)
    if done.code:
        raise StudyError(f"{group.name}: {done.errors.strip()}")


def real_row(group: Group, verdict: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the study tells of a group, from the verdict on it."""
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
