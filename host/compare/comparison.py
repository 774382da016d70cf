"""Two artefacts, or two folders of artefacts, compared by kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import LOG_SUFFIX
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parallel import one_thread_of_algebra
from trimtab.host.compare.logs import FlightFigures, LogsComparison, compare_logs, read_figures
from trimtab.host.compare.models import ModelsComparison, compare_models
from trimtab.host.compare.plans import PlansComparison, plan_figures
from trimtab.host.link.blob_files import read_reference
from trimtab.host.models.file import SUFFIX as MODEL_SUFFIX
from trimtab.host.models.file import read_model
from trimtab.host.plan.files import SUFFIX as REFERENCE_SUFFIX
from trimtab.host.show.content import vehicle_of
from trimtab.host.workspace import Workspace

KINDS = {"logs": LOG_SUFFIX, "models": MODEL_SUFFIX, "plans": REFERENCE_SUFFIX}
"""Kinds of artefacts that can be compared, and the ends of their names."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What differs between `a` and `b`.

    logs: None if one side has no log. unpaired: models and plans of a folder that have no counterpart of the
    same name. notes: what a reader must know, as sentences.
    """

    a: str
    b: str
    logs: LogsComparison | None
    models: tuple[ModelsComparison, ...]
    plans: tuple[PlansComparison, ...]
    unpaired: tuple[str, ...]
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
        return {
            "a": self.a,
            "b": self.b,
            "logs": None if self.logs is None else self.logs.to_dict(),
            "models": [each.to_dict() for each in self.models],
            "plans": [each.to_dict() for each in self.plans],
            "unpaired": list(self.unpaired),
            "notes": list(self.notes),
        }


@one_thread_of_algebra()
def compare(a: Path, b: Path, space: Workspace) -> Comparison:
    """Compare two logs, models or plans, or two folders, whose artefacts are compared kind by kind.

    A folder stands for the artefacts in it, without those in its folders. A file may be compared with a
    folder of the same kind. Models and plans are paired by name, or if each side has only one.

    Raises
    ------
    UsageError
        If the two have no kind in common, or for a file of another kind; as the reader of a model or plan.
    LogError
        If a log that is named cannot be read, or none of a folder's.
    """
    first, second = _files(a), _files(b)
    common = [kind for kind in KINDS if first[kind] and second[kind]]
    if not common:
        raise UsageError(
            f"{a} has {_kinds(first)}, {b} has {_kinds(second)}; compare two of the same kind, or use "
            "`trimtab predict` for a model and logs"
        )
    logs, flown, notes = _logs(first["logs"], second["logs"], a, b)
    models, plans, unpaired = [], [], []
    pairs, alone = _paired(first["models"], second["models"])
    effects = space.effects() if pairs else {}
    for one, other in pairs:
        models.append(compare_models(read_model(one), read_model(other), one, other, effects))
    unpaired += alone
    pairs, alone = _paired(first["plans"], second["plans"])
    for both in pairs:
        figures = []
        for path in both:
            reference = read_reference(path)
            craft = vehicle_of(reference, None, [flight.vehicle for flight in flown], space)
            figures.append(plan_figures(reference, path, craft))
        plans.append(PlansComparison(a=figures[0], b=figures[1]))
    unpaired += alone
    return Comparison(
        a=str(a),
        b=str(b),
        logs=logs,
        models=tuple(models),
        plans=tuple(plans),
        unpaired=tuple(map(str, unpaired)),
        notes=tuple(notes),
    )


def _files(path: Path) -> dict[str, list[Path]]:
    """Return the artefacts of a file or folder by kind, in the order of their names. Raises UsageError."""
    if path.is_dir():
        inside = sorted(path.iterdir())
        files = {kind: [each for each in inside if each.name.endswith(end)] for kind, end in KINDS.items()}
        if not any(files.values()):
            raise UsageError(f"{path}: holds no log, model or plan; give a folder with {_endings()} files")
        return files
    files = {kind: [path] if path.name.endswith(end) else [] for kind, end in KINDS.items()}
    if not any(files.values()):
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder; check the path")
        raise UsageError(f"{path}: cannot be compared; give a file that ends in {_endings()}, or a folder")
    return files


def _endings() -> str:
    *most, last = KINDS.values()
    return f"{', '.join(most)} or {last}"


def _kinds(files: dict[str, list[Path]]) -> str:
    """Return the kinds of artefacts that there are, as text."""
    return " and ".join(kind for kind, paths in files.items() if paths)


def _logs(
    first: Sequence[Path], second: Sequence[Path], a: Path, b: Path
) -> tuple[LogsComparison | None, list[FlightFigures], list[str]]:
    """Return the comparison of logs, the flights of both sides, and notes on those that are left out."""
    if not first or not second:
        return None, [], []
    of_a, notes = read_figures(first, from_folder=a.is_dir())
    of_b, more = read_figures(second, from_folder=b.is_dir())
    return compare_logs(of_a, of_b), [*of_a, *of_b], [*notes, *more]


def _paired(first: Sequence[Path], second: Sequence[Path]) -> tuple[list[tuple[Path, Path]], list[Path]]:
    """Return the pairs of files, and the files without a counterpart. Both are empty if one side has none."""
    if not first or not second:
        return [], []
    if len(first) == len(second) == 1:
        return [(first[0], second[0])], []
    others = {path.name: path for path in second}
    names = {path.name for path in first} & set(others)
    pairs = [(path, others[path.name]) for path in first if path.name in names]
    return pairs, [path for path in (*first, *second) if path.name not in names]
