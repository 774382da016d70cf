"""Recorded flights in studies: groups of logs that are traced, each in its own process."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from trimtab.host.base.program import git_state, version
from trimtab.host.base.workers import process_pool
from trimtab.host.vehicle.strict_toml import Strict, read_strict
from trimtab.sitl.studies.commandline import Answer, run_apart
from trimtab.sitl.studies.files import StudyError, read_json, sha256_of, write_json
from trimtab.sitl.studies.flights import VERDICT, ask

REAL = "real"


class Group(Strict):
    """Logs that are traced together. Paths are absolute, or relative to the file with the group."""

    name: str
    logs: Annotated[tuple[str, ...], Field(min_length=1)]
    hold_out: tuple[str, ...] = ()
    baseline: tuple[str, ...] = ()
    """Logs from before the change, if the question is what changed."""
    format: str | None = None
    """Format of `trimtab import` for the logs. Without one, they are Trimtab flight logs."""
    columns: str | None = None
    """Column map of the format csv."""
    vehicle: str | None = None
    """Vehicle of imported flights: a name, or the path of a vehicle file. Mandatory with a format."""
    label: str | None = None
    """What is known of the flights, such as "weight on an arm". Groups may share a label."""
    expected: tuple[tuple[str, ...], ...] = ()
    """Sets of effects that are right answers for the label; an empty set: nothing is to be named."""

    @model_validator(mode="after")
    def _belongs_together(self) -> Group:
        if (self.format == "csv") != (self.columns is not None):
            raise ValueError("the format csv needs columns, and no other format takes them")
        if self.format is not None and self.vehicle is None:
            raise ValueError("a format needs the vehicle that flew; add vehicle")
        if self.expected and self.label is None:
            raise ValueError("expected needs the label that it is right for; add label")
        if len(set(self.names.values())) < len(self.all_logs):
            raise ValueError("two logs have the same name and folder; give each log once, or rename one")
        return self

    @property
    def all_logs(self) -> tuple[str, ...]:
        """All logs of the group."""
        return (*self.logs, *self.hold_out, *self.baseline)

    @property
    def names(self) -> dict[str, str]:
        """The name of each log: its own, after that of its folder if another log has the same."""
        count = Counter(Path(log).stem for log in self.all_logs)
        return {
            log: Path(log).stem if count[Path(log).stem] == 1 else f"{Path(log).parent.name}-{Path(log).stem}"
            for log in self.all_logs
        }


class RealFlights(Strict):
    """Content of a file with groups."""

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
        columns = None if group.columns is None else str(folder / group.columns)
        roles = {role: tuple(str(folder / log) for log in getattr(group, role)) for role in _ROLES}
        for file in (*(log for logs in roles.values() for log in logs), *([columns] if columns else [])):
            if not Path(file).is_file():
                raise StudyError(f"{path}: {group.name}: {file} does not exist")
        vehicle = group.vehicle
        if vehicle is not None and (folder / vehicle).is_file():
            vehicle = str(folder / vehicle)
        groups.append(group.model_copy(update={**roles, "columns": columns, "vehicle": vehicle}))
    return groups


_ROLES = ("logs", "hold_out", "baseline")


def judge_real(
    groups: Sequence[Group],
    folder: Path,
    on_progress: Callable[[int, str], None] = lambda done, detail: None,
    *,
    jobs: int = 1,
) -> list[dict[str, Any]]:
    """Trace each group and return a row of plain data for it, see `real_row`.

    Earlier results of this version for the same files are read from `folder`. A group that cannot be imported
    or traced has the verdict failed. on_progress: called with the number of traced groups, and a text. jobs:
    number of groups that are traced at a time.
    """
    folders = [folder / REAL / f"{index:02d}" for index in range(len(groups))]
    with ExitStack() as stack:
        each = map
        if min(jobs, len(groups)) > 1:  # in processes, because each measures the time of its children
            each = stack.enter_context(process_pool(min(jobs, len(groups)))).map
        rows = []
        for group, verdict in zip(groups, each(_verdict, groups, folders), strict=True):
            rows.append(real_row(group, verdict))
            on_progress(len(rows), f"{group.name}: {rows[-1]['verdict']}")
    return rows


def _verdict(group: Group, folder: Path) -> dict[str, Any]:
    """Return the verdict on the group, traced once for the same files, settings and version."""
    files = [*group.all_logs, *([] if group.columns is None else [group.columns])]
    asked = {
        **group.model_dump(mode="json", exclude={"label", "expected"}),
        "sha256": {path: sha256_of(Path(path)) for path in files},
        "version": version(),
        "git": git_state(),
    }
    if (folder / VERDICT).is_file():
        before = read_json(folder / VERDICT)
        if before["asked"] == asked and before["exit_code"] == 0:
            return before
    bare = folder / "trace"
    shutil.rmtree(bare, ignore_errors=True)
    bare.mkdir(parents=True)
    verdict = {"asked": asked, **_answer(group, bare)}
    write_json(folder / VERDICT, verdict)
    shutil.rmtree(bare)
    return verdict


def _answer(group: Group, folder: Path) -> dict[str, Any]:
    """Bring the group's logs into an empty folder, trace them there, and return what `ask` returns."""
    for path, name in group.names.items():
        failed = _bring_in(group, path, name, folder)
        if failed is not None:
            return {"exit_code": failed.code, "answer": {}, "errors": failed.errors, "trace_s": None}
    logs, held_out, baseline = ([f"{group.names[log]}.mcap" for log in getattr(group, r)] for r in _ROLES)
    return ask(folder, logs, held_out, baseline)


def _bring_in(group: Group, path: str, name: str, folder: Path) -> Answer | None:
    """Copy or import the log into `folder` as a Trimtab flight log; return the answer of a failed import."""
    target = f"{name}.mcap"
    if group.format is None:
        shutil.copyfile(path, folder / target)
        return None
    assert group.vehicle is not None  # a group with a format has one
    words = ["import", group.format, path, "--vehicle", group.vehicle, "-o", target]
    if group.columns is not None:
        words += ["--columns", group.columns]
    done = run_apart(words, folder)
    return done if done.code else None


def real_row(group: Group, verdict: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row of a group in a study's results, from its verdict."""
    answer = verdict["answer"]
    before, after = answer.get("before") or {}, answer.get("after") or {}
    used, held_out, baseline = ([group.names[log] for log in getattr(group, role)] for role in _ROLES)
    return {
        "name": group.name,
        "label": group.label,
        "used": used,
        "held_out": held_out,
        "baseline": baseline,
        "verdict": answer.get("verdict", "failed"),
        "effects": [
            {key: effect[key] for key in ("name", "parameters", "aliases")}
            for effect in answer.get("effects", ())
        ],
        "possible": [each["name"] for each in answer.get("possible", ())],
        "doubts": [*answer.get("doubts", ()), *answer.get("reasons", ())],
        "errors": verdict["errors"][-500:] if verdict["exit_code"] else "",
        "before_m": before.get("position_rmse_m"),
        "after_m": after.get("position_rmse_m"),
        "trace_s": verdict["trace_s"],
    }
