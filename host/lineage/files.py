"""Artefacts on disk: the id of each, its command, and the ids of its parents.

Only headers, metadata and records are read: no flight is decoded and no weights are loaded.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from trimtab.host.base import bounds
from trimtab.host.base.artefacts import content_id, public_command, record_path
from trimtab.host.base.errors import UsageError
from trimtab.host.log.heading import read_heading
from trimtab.host.log.provenance import (
    HOST_CONTROL,
    PROVENANCE,
    Origin,
    date_text,
    origin_of,
    utc_date,
)
from trimtab.host.models.file import SUFFIX as MODEL_SUFFIX
from trimtab.host.route.files import list_routes, parse_route
from trimtab.host.vehicle import list_vehicles
from trimtab.host.vehicle.files import parse_vehicle
from trimtab.host.vehicle.strict_toml import parse_toml
from trimtab.protocol.blob_fields import kind_of, unpack_header
from trimtab.protocol.blobs import BlobError, Kind, blob_id, least_bytes

ArtefactKind = Literal["vehicle", "route", "reference", "feed-forward", "log", "model", "report"]

SEALED_SUFFIX = ".truth.json"
"""Truth of a simulated world. It is never opened."""
RECORD_SUFFIXES = (".ref.json", ".ff.json")
"""Endings of the records beside references and feed-forwards."""
_LOG_PARENTS = {
    "vehicle_id": "vehicle",
    "reference_id": "reference",
    "then_id": "next reference",
    "feedforward_id": "feed-forward",
    "model_id": "model",
    "source_id": "source",
    "columns_id": "column map",
    "topics_id": "topic map",
}
"""Entries of a log's metadata that name a parent, and its role."""


class LineageError(UsageError):
    """A file has no lineage, or is damaged."""


@dataclass(frozen=True, kw_only=True)
class Artefact:
    """One file: its id, what it records of its making, and the ids of its parents by role.

    path: None for a shipped file. origin, port: of a log; None where the log does not say. date: UTC, of an
    imported flight whose source had a clock.
    """

    path: Path | None
    name: str
    kind: ArtefactKind
    id: str
    parents: Mapping[str, str]
    command: str | None = None
    origin: Origin | None = None
    port: str | None = None
    date: str | None = None


def read_artefact(path: Path) -> Artefact | None:
    """Return the artefact in a file; None for a file of another kind.

    Raises LineageError, LogError or ConfigurationError for a damaged file, OSError for one that cannot be
    read.
    """
    name = path.name
    if name.endswith(SEALED_SUFFIX):
        return None
    if name.endswith(".mcap"):
        return _log(path)
    if name.endswith((".ref", ".ff")):
        return _blob(path)
    if name.endswith(".json"):
        return _json(path)
    if name.endswith(MODEL_SUFFIX):
        return _model(path)
    return _configuration(path) if name.endswith(".toml") else None


def _log(path: Path) -> Artefact:
    heading = read_heading(path)
    entries = heading.metadata[PROVENANCE]
    parents = {role: entries[key] for key, role in _LOG_PARENTS.items() if key in entries}
    control = heading.metadata.get(HOST_CONTROL, {})
    if model := control.get("model_id"):
        parents["model of the controller"] = model
    command = _public(entries.get("command"))
    origin = origin_of(entries)
    return Artefact(
        path=path,
        name=path.name,
        kind="log",
        id=heading.id,
        parents=parents,
        command=command,
        origin=origin,
        port=None if command is None else _option(command, "--port"),
        date=date_text(utc_date(entries)),
    )


def _blob(path: Path) -> Artefact:
    try:
        data = bounds.read_bounded(path, bounds.BLOB_BYTES)
    except bounds.TooLarge as error:
        raise LineageError(f"{path}: {error}") from None
    try:
        kind = kind_of(data)
        vehicle = unpack_header(data, kind, versions=range(256)).vehicle_id
        least = least_bytes(data)
    except BlobError as error:
        raise LineageError(f"{path}: {error}; download or make it again") from None
    if len(data) < least:
        raise LineageError(f"{path}: {len(data)} bytes of at least {least}; download or make it again")
    parents, command = {"vehicle": vehicle}, None
    role = "reference" if kind is Kind.REFERENCE else "feedforward"
    record = record_path(path)
    if record.is_file():
        content = _object(record)
        if content.get(role) != blob_id(data):
            raise LineageError(f"{record}: is not the record of {path.name}; remove it or make both again")
        recorded, command = _provenance(content.get("provenance"))
        parents |= recorded
    return Artefact(
        path=path,
        name=path.name,
        kind="reference" if kind is Kind.REFERENCE else "feed-forward",
        id=blob_id(data),
        parents=parents,
        command=command,
    )


def _json(path: Path) -> Artefact | None:
    """Return a report, or the record of a reference or feed-forward that is missing; None for other JSON."""
    content = _object(path)
    parents, command = _provenance(content.get("provenance"))
    for role in ("reference", "feedforward"):
        if path.name.endswith(RECORD_SUFFIXES) and isinstance(content.get(role), str):
            return Artefact(
                path=path,
                name=path.name,
                kind="reference" if role == "reference" else "feed-forward",
                id=content[role],
                parents=parents,
                command=command,
            )
    model = content.get("model")
    if "verdict" in content and isinstance(model, str):  # a trace, which was written with its model
        beside = path.with_name(Path(model).name)
        if beside.is_file():
            parents["model"] = _model(beside).id
    elif "provenance" not in content:
        return None
    return Artefact(
        path=path,
        name=path.name,
        kind="report",
        id=content_id(path.read_bytes()),
        parents=parents,
        command=command,
    )


def _model(path: Path) -> Artefact:
    content = _toml(path)
    identity, vehicle = content.get("id"), content.get("vehicle_id")
    if content.get("kind") != "trimtab-model" or not isinstance(vehicle, str):
        raise LineageError(f"{path}: is not a model; trace or learn again")
    if not isinstance(identity, str):
        raise LineageError(f"{path}: id: was removed, so nothing names it as a parent; trace or learn again")
    recorded, command = _provenance(content.get("provenance"))
    parents = {"vehicle": vehicle, **recorded}
    used = content.get("data")
    for index, log in enumerate(used if isinstance(used, list) else ()):
        if log not in recorded.values():
            parents[f"log {index}"] = str(log)
    return Artefact(path=path, name=path.name, kind="model", id=identity, parents=parents, command=command)


def _configuration(path: Path) -> Artefact | None:
    """Return a vehicle or route; None for another TOML file, such as a world, of which only keys are read."""
    content = _toml(path)
    text = path.read_text(encoding="utf-8")
    if "rotors" in content and "mass_kg" in content:
        vehicle = parse_vehicle(text, str(path))
        return Artefact(path=path, name=path.name, kind="vehicle", id=vehicle.id, parents={})
    if "waypoints_m" in content:
        route = parse_route(text, str(path))
        return Artefact(path=path, name=path.name, kind="route", id=route.id, parents={})
    return None


def shipped() -> Iterator[Artefact]:
    """Yield the vehicles and the routes of fixed waypoints that come with Trimtab."""
    for paths in (list_vehicles(), list_routes()):
        for path in paths.values():
            artefact = _configuration(path)
            if artefact is not None:
                yield Artefact(path=None, name=path.stem, kind=artefact.kind, id=artefact.id, parents={})


def _provenance(value: object) -> tuple[dict[str, str], str | None]:
    """Return the parents by role and the command of a provenance, as far as it has them."""
    if not isinstance(value, Mapping):
        return {}, None
    parents, command = value.get("parents"), value.get("command")
    known = parents.items() if isinstance(parents, Mapping) else ()
    return {str(role): str(identity) for role, identity in known}, _public(command)


def _public(command: object) -> str | None:
    """Return a recorded command without what is sealed, even if whoever wrote it left that in."""
    if not isinstance(command, str):
        return None
    try:
        return public_command(shlex.split(command)[1:])
    except ValueError:
        return None


def _option(command: str, name: str) -> str | None:
    """Return the value of an option in a command; None without it."""
    words = shlex.split(command)
    for word, value in zip(words, [*words[1:], ""], strict=True):
        option, joined, inline = word.partition("=")
        if option == name:
            return inline if joined else value
    return None


def _object(path: Path) -> Mapping[str, Any]:
    try:
        content = bounds.read_json(path)
    except ValueError:
        raise LineageError(f"{path}: is not JSON; make it again") from None
    return content if isinstance(content, dict) else {}


def _toml(path: Path) -> Mapping[str, Any]:
    try:
        return parse_toml(bounds.read_text(path, bounds.TOML_BYTES), str(path))
    except ValueError:
        raise LineageError(f"{path}: is not TOML; correct it or make it again") from None
