"""A lineage as lines of text and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trimtab.host.lineage.files import Artefact
from trimtab.host.lineage.search import Lineage, Relation


def lines(result: Lineage) -> list[str]:
    """Return the lines of text for the terminal."""
    out = [_described(result.artefact)]
    out += [f"same content: {each.path}" for each in result.copies]
    out += _tree("came from", result.ancestors)
    return out + _tree("led to", result.descendants)


def to_json(result: Lineage) -> dict[str, Any]:
    """Return the answer of `trimtab lineage --json`."""
    return {
        **_artefact(result.artefact),
        "copies": [str(each.path) for each in result.copies],
        "ancestors": [_relation(each) for each in result.ancestors],
        "descendants": [_relation(each) for each in result.descendants],
        "missing": sorted({each.id for each in result.ancestors if not each.artefacts}),
        "damaged": list(result.damaged),
        "files": result.files,
    }


def _tree(title: str, relations: Sequence[Relation]) -> list[str]:
    if not relations:
        return [f"{title}: nothing that is recorded"]
    rows = [f"{title}:"]
    for each in relations:
        what = f"{each.id}, missing" if not each.artefacts else _described(each.artefacts[0])
        also = "".join(f", also {other.path or other.name}" for other in each.artefacts[1:])
        rows.append(f"{'  ' * each.depth}{each.role}: {what}{also}")
    return rows


def _described(artefact: Artefact) -> str:
    """Return one line about an artefact."""
    where = f"{artefact.name} (shipped)" if artefact.path is None else str(artefact.path)
    parts = [f"{where}  {artefact.kind} {artefact.id}"]
    if artefact.origin == "port":
        parts.append(f"flown at port {artefact.port}")
    elif artefact.origin is not None:
        parts.append(artefact.origin)
    if artefact.date is not None:
        parts.append(artefact.date)
    if artefact.command is not None:
        parts.append(f"`{artefact.command}`")
    return ", ".join(parts)


def _artefact(artefact: Artefact) -> dict[str, Any]:
    return {
        "file": None if artefact.path is None else str(artefact.path),
        "name": artefact.name,
        "kind": artefact.kind,
        "id": artefact.id,
        "command": artefact.command,
        "origin": artefact.origin,
        "port": artefact.port,
        "date": artefact.date,
    }


def _relation(relation: Relation) -> dict[str, Any]:
    return {
        "depth": relation.depth,
        "role": relation.role,
        "id": relation.id,
        "artefacts": [_artefact(each) for each in relation.artefacts],
    }
