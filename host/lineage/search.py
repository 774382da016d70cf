"""Search of a folder for what an artefact came from and what came from it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trimtab.host.base.errors import TrimtabError
from trimtab.host.lineage.files import RECORD_SUFFIXES, Artefact, LineageError, read_artefact, shipped


@dataclass(frozen=True, kw_only=True)
class Relation:
    """One step of a lineage: role of the parent, its id, and the files that have it; none if missing.

    depth: steps from the file in question, from 1. Of a descendant, `id` is its own and `role` is that of the
    parent in it.
    """

    depth: int
    role: str
    id: str
    artefacts: tuple[Artefact, ...]


@dataclass(frozen=True, kw_only=True)
class Lineage:
    """Ancestors and descendants of a file, other files of the same content, and one line per damaged file."""

    artefact: Artefact
    copies: tuple[Artefact, ...]
    ancestors: tuple[Relation, ...]
    descendants: tuple[Relation, ...]
    damaged: tuple[str, ...]
    files: int


def lineage(path: Path, folder: Path | None = None) -> Lineage:
    """Return the lineage of a file among the files in `folder` and below; None for the folder of the file.

    Folders whose names begin with a dot are left out. Raises LineageError if the file has no lineage or the
    folder does not exist, and the error of its format if it is damaged.
    """
    root = path.parent if folder is None else folder
    if not root.is_dir():
        raise LineageError(f"{root}: no such folder; give --workspace an existing one")
    path = _artefact_path(path)
    if not path.is_file():
        raise LineageError(f"{path}: no such file; check the path")
    artefact = read_artefact(path)
    if artefact is None:
        raise LineageError(
            f"{path}: has no lineage; give a vehicle, route, reference, feed-forward, log, model or report"
        )
    found, damaged = _scan(root)
    same = path.resolve()
    others = [each for each in found if each.path is None or each.path.resolve() != same]
    everything = [artefact, *others]
    by_id: dict[str, list[Artefact]] = {}
    for each in everything:
        by_id.setdefault(each.id, []).append(each)
    for each in shipped():
        by_id.setdefault(each.id, [each])
    return Lineage(
        artefact=artefact,
        copies=tuple(each for each in by_id[artefact.id] if each is not artefact and each.path is not None),
        ancestors=tuple(_ancestors(artefact, by_id, 1, {artefact.id})),
        descendants=tuple(_descendants(artefact.id, everything, 1, {artefact.id})),
        damaged=tuple(damaged),
        files=len(everything),
    )


def _scan(root: Path) -> tuple[list[Artefact], list[str]]:
    """Return all artefacts in a folder and below, by path, and one line for each damaged file."""
    found: list[Artefact] = []
    damaged: list[str] = []
    for path in _files(root):
        try:
            artefact = read_artefact(path)
        except TrimtabError as error:
            damaged.append(error.lines[0])
        except OSError as error:
            damaged.append(f"{path}: cannot be read ({error.strerror or error}); check the file")
        else:
            if artefact is not None:
                found.append(artefact)
    return found, damaged


def _files(root: Path) -> Iterator[Path]:
    """Yield the files in a folder and below that may be artefacts, in the order of their paths."""
    for parent, folders, names in os.walk(root):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = Path(parent) / name
            # The record of a reference or feed-forward belongs to the file beside it.
            if _artefact_path(path) == path and path.is_file():
                yield path


def _artefact_path(path: Path) -> Path:
    """Return the reference or feed-forward that a record belongs to, if it exists, or any other path."""
    if path.name.endswith(RECORD_SUFFIXES):
        artefact = path.with_name(path.name.removesuffix(".json"))
        return artefact if artefact.is_file() else path
    return path


def _ancestors(
    artefact: Artefact, by_id: Mapping[str, Sequence[Artefact]], depth: int, seen: set[str]
) -> Iterator[Relation]:
    """Yield the parents of an artefact, each followed by its own that were not yielded before."""
    for role, parent in artefact.parents.items():
        artefacts = tuple(by_id.get(parent, ()))
        yield Relation(depth=depth, role=role, id=parent, artefacts=artefacts)
        if artefacts and parent not in seen:
            seen.add(parent)
            yield from _ancestors(artefacts[0], by_id, depth + 1, seen)


def _descendants(
    parent: str, everything: Sequence[Artefact], depth: int, seen: set[str]
) -> Iterator[Relation]:
    """Yield what names `parent` as a parent, each followed by its own descendants, once each."""
    for each in everything:
        roles = [role for role, identity in each.parents.items() if identity == parent]
        if roles and each.id not in seen:
            seen.add(each.id)
            same = tuple(other for other in everything if other.id == each.id)
            yield Relation(depth=depth, role=roles[0], id=each.id, artefacts=same)
            yield from _descendants(each.id, everything, depth + 1, seen)
