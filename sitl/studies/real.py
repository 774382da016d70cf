"""The study of real flights: verdicts on groups of recorded logs against their labels.

    trimtab study real FLIGHTS.toml

Each group is imported and traced on the command line, in its own process, which does not see the labels. A
group whose logs are refused counts as a miss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import OnProgress, alone_in
from trimtab.sitl.studies.recorded import judge_real, read_groups
from trimtab.sitl.studies.scoring.labelled import check_expected, score_row, summary
from trimtab.sitl.studies.table import real_table, share_row
from trimtab.sitl.studies.text_tables import lines

NAME = "real"

_SHARES = (
    ("exact", "label named exactly, and traced"),
    ("exact_names", "the same names, whatever the verdict"),
    ("in_alias", "label among names and aliases"),
    ("false_name", "a name where nothing changed or is missing"),
)


def run(
    *,
    folder: Path,
    seed: int,
    vehicle: str,
    jobs: int,
    flights: Path | None = None,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Trace the groups of a file, and return the outcome: `answer`, `lines`, `tables` and `scores`.

    Parameters
    ----------
    folder
        State and results. Groups whose files, settings and version have not changed are not traced again.
    seed, vehicle
        Not used: nothing is drawn, and each group names its vehicle.
    jobs
        Number of groups that are traced at a time.
    flights
        TOML file with the groups.

    Raises
    ------
    UsageError
        No file is given, or the folder is in use.
    StudyError
        The file or a log does not exist.
    ConfigurationError
        The file is invalid.
    """
    if flights is None:
        raise UsageError("which flights? give a TOML file with groups: trimtab study real FLIGHTS.toml")
    groups = read_groups(flights)
    check_expected(groups, str(flights))
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    with alone_in(folder):
        total = float(len(groups))
        on_progress(0.0, total, "")
        rows = judge_real(
            groups, folder, lambda done, detail: on_progress(float(done), total, detail), jobs=jobs
        )
    scores = [{**row, **score_row(row, group.expected)} for row, group in zip(rows, groups, strict=True)]
    figures = summary(scores)
    shown = tables(figures, scores)
    return {
        "answer": {"study": NAME, "folder": str(folder), **figures, "groups": scores},
        "lines": list(lines(shown)),
        "tables": shown,
        "scores": scores,
    }


def tables(
    figures: Mapping[str, Any], scores: Sequence[Mapping[str, Any]]
) -> dict[str, list[dict[str, str]]]:
    """Return the tables of the report: figures, confusion by label, and every group."""
    answers = sorted({answer for row in figures["confusion"].values() for answer in row})
    confusion = [
        {"label": label, **{answer: str(counts.get(answer, "")) for answer in answers}}
        for label, counts in figures["confusion"].items()
    ]
    groups = [
        {
            "group": text["name"],
            "label": row["label"] or "-",
            "verdict": row["verdict"],
            "score": _score(row),
            "answer": text["said"] or "nothing named",
            "held-out error before, after": f"{text['before']}, {text['after']}",
            "time": text["seconds"],
        }
        for row, text in zip(scores, real_table(scores), strict=True)
    ]
    shares = [
        share_row(label, "", figures[key], figures["n"][key], figures["interval"][key])
        for key, label in _SHARES
    ]
    for row in shares:
        del row["target"]
    shown = {"Figures, with exact 95 % intervals": [{k: str(v) for k, v in row.items()} for row in shares]}
    if confusion:
        shown["Labels (rows) and answers (columns)"] = confusion
    return {**shown, "Groups": groups}


def _score(row: Mapping[str, Any]) -> str:
    """Return in words whether a group's answer is right."""
    if not row["expected"]:
        return "-"
    if row["verdict"] == "failed":
        return "failed"
    if row["false_name"] is not None:
        return "a false name" if row["false_name"] else "right"
    if row["exact"]:
        return "exact"
    if row["exact_names"]:
        return "exact names, not traced"
    return "among aliases" if row["in_alias"] else "missed"
