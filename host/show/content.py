"""The content of a page from the files that `trimtab show` is given."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.base.artefacts import LOG_SUFFIX
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parts import target_of
from trimtab.host.link.blob_files import read_reference
from trimtab.host.log import LogError
from trimtab.host.log.unfinished import unfinished_logs
from trimtab.host.models.file import SUFFIX as MODEL_SUFFIX
from trimtab.host.models.file import read_model
from trimtab.host.plan.files import SUFFIX as REFERENCE_SUFFIX
from trimtab.host.plan.files import read_course
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.route.shapes import Box, Cylinder, Sphere
from trimtab.host.show.flights import UP, ShownFlight, flight_facts, flight_track, read_shown
from trimtab.host.show.lattice import Track, step_for
from trimtab.host.show.models import model_facts
from trimtab.host.show.plans import Course, plan_facts, plan_track
from trimtab.host.vehicle import ConfigurationError, Vehicle, list_vehicles, load_vehicle
from trimtab.host.workspace import Workspace
from trimtab.protocol.blobs import Reference


@dataclass(frozen=True, kw_only=True)
class Content:
    """What a page shows: facts of flights, plans and models, tracks, the scene in 3D, and notes."""

    flights: list[dict[str, Any]]
    plans: list[dict[str, Any]]
    models: list[dict[str, Any]]
    tracks: list[Track]
    scene: dict[str, Any]
    notes: list[str]

    def facts(self) -> dict[str, Any]:
        """Return the facts for `--json`."""
        return {
            "flights": self.flights,
            "plans": self.plans,
            "models": self.models,
            "notes": self.notes,
        }


@dataclass(kw_only=True)
class _Files:
    """Files by kind, in the order given. Logs of a folder may be unreadable; a log that is named may not."""

    logs: list[Path] = field(default_factory=list)
    in_folders: set[Path] = field(default_factory=set)
    references: list[Path] = field(default_factory=list)
    models: list[Path] = field(default_factory=list)


def read_content(inputs: Sequence[Path], space: Workspace, vehicle: Vehicle | None = None) -> Content:
    """Return the content of a page. vehicle: of references whose vehicle is not found by its id.

    Raises
    ------
    UsageError
        For a file of another kind, or a folder without logs.
    LogError
        If a log that is named cannot be shown, or none of a folder's.
    """
    files = _sorted(inputs)
    shown, notes = _read_logs(files)
    references = [(path, read_reference(path)) for path in files.references]
    effects = space.effects() if files.models else {}
    models = [model_facts(read_model(path), path, effects) for path in files.models]
    total_us = sum(s.span_us[1] - s.span_us[0] for _, s in shown)
    step_us = step_for(total_us + sum(reference.duration_us for _, reference in references))
    flights, tracks, courses = _flown(shown, [path.parent for path, _ in references], step_us)
    plans = []
    for path, reference in references:
        course = read_course(path, reference.id)
        if course is not None:
            courses.append((reference.id, course))
        route = None if course is None else course[0]
        craft = vehicle_of(reference, vehicle, [s.flight.vehicle for _, s in shown], space)
        plans.append(plan_facts(reference, path, craft, route))
        tracks.append(plan_track(reference, craft, course, path.name, step_us))
    return Content(
        flights=flights, plans=plans, models=models, tracks=tracks, scene=_scene(courses), notes=notes
    )


def content_of_flights(logs: Sequence[Path]) -> Content:
    """Return the content of these logs for a report, one track for each. Raises LogError."""
    shown, notes = _read_logs(_Files(logs=list(logs)))
    step_us = step_for(sum(s.span_us[1] - s.span_us[0] for _, s in shown))
    flights, tracks, courses = _flown(shown, [], step_us)
    return Content(flights=flights, plans=[], models=[], tracks=tracks, scene=_scene(courses), notes=notes)


def content_of_plan(reference: Reference, course: Course, vehicle: Vehicle, model: ResidualModel) -> Content:
    """Return the content of one plan for its report. model: predicts the residual that is shown."""
    step_us = step_for(reference.duration_us)
    return Content(
        flights=[],
        plans=[],
        models=[],
        tracks=[plan_track(reference, vehicle, course, course[0].name, step_us, model)],
        scene=_scene([(reference.id, course)]),
        notes=[],
    )


def _flown(
    shown: Sequence[tuple[Path, ShownFlight]], folders: Sequence[Path], step_us: int
) -> tuple[list[dict[str, Any]], list[Track], list[tuple[str | None, Course]]]:
    """Return facts and track of each flight, and the courses that are known, with their references.

    folders: further folders with the records of references.
    """
    flights, tracks, courses = [], [], []
    for path, flight in shown:
        course = _course_of(flight.flight.reference_id, [path.parent, *folders])
        route = None if course is None else course[0].name
        flights.append(flight_facts(flight, path, route))
        track = flight_track(flight, _title(flight, path, route), step_us)
        tracks.append(replace(track, group=route or ""))
        if course is not None:
            courses.append((tracks[-1].reference_id, course))
    counts = Counter(track.name for track in tracks)
    tracks = [
        track if counts[track.name] == 1 else replace(track, name=f"{track.name} ({path.name})")
        for track, (path, _) in zip(tracks, shown, strict=True)
    ]
    return flights, tracks, courses


def _title(shown: ShownFlight, path: Path, route: str | None) -> str:
    """Return route and index of a flight, or the name of its log where these are not known."""
    index = shown.flight.metadata.get("flight")
    return path.stem if route is None or index is None else f"{route} {index}"


def _sorted(inputs: Sequence[Path]) -> _Files:
    """Return the inputs by kind; a folder stands for its logs. Raises UsageError."""
    files = _Files()
    for path in inputs:
        if path.is_dir():
            logs = sorted({*path.glob(f"*{LOG_SUFFIX}"), *_unfinished(path)})
            if not logs:
                raise UsageError(f"{path}: holds no flight log; give a folder with {LOG_SUFFIX} files")
            files.logs += logs
            files.in_folders |= set(logs)
        elif path.name.endswith(MODEL_SUFFIX):
            files.models.append(path)
        elif path.suffix == REFERENCE_SUFFIX:
            files.references.append(path)
        elif target_of(path).suffix == LOG_SUFFIX:
            files.logs.append(path)
        elif not path.exists():
            raise UsageError(f"{path}: no such file or folder; check the path")
        else:
            raise UsageError(
                f"{path}: give a flight log ({LOG_SUFFIX}), a reference ({REFERENCE_SUFFIX}), "
                f"a model ({MODEL_SUFFIX}) or a folder with logs"
            )
    return files


def _unfinished(folder: Path) -> list[Path]:
    """Return the logs of a folder that are not closed."""
    return [part.path for part in unfinished_logs(folder)]


def _read_logs(files: _Files) -> tuple[list[tuple[Path, ShownFlight]], list[str]]:
    """Return the flights, and a note for each log of a folder that cannot be shown. Raises LogError."""
    shown, notes = [], []
    for path in dict.fromkeys(files.logs):
        try:
            shown.append((path, read_shown(path)))
        except LogError as error:
            if path not in files.in_folders:
                raise
            notes.append(f"Left out: {error}.")
    if files.logs and not shown:
        raise LogError(f"{files.logs[0].parent}: none of its logs can be shown; {notes[0]}")
    return shown, notes


def _course_of(reference_id: str | None, folders: Sequence[Path]) -> Course | None:
    """Return the course of a reference from a NAME.ref.json in these folders; None if none is of it."""
    if reference_id is None:
        return None
    for folder in dict.fromkeys(folders):
        for record in sorted(folder.glob(f"*{REFERENCE_SUFFIX}.json")):
            course = read_course(record.with_suffix(""), reference_id)
            if course is not None:
                return course
    return None


def vehicle_of(
    reference: Reference, vehicle: Vehicle | None, flown: Sequence[Vehicle], space: Workspace
) -> Vehicle | None:
    """Return the vehicle of a reference: as named, of a log beside it, or found by its id; else None.

    Raises UsageError if the named one is another vehicle.
    """
    if vehicle is not None:
        if vehicle.id != reference.vehicle_id:
            raise UsageError(
                f"--vehicle: {vehicle.name} ({vehicle.id}) is not the vehicle of the reference "
                f"({reference.vehicle_id}); give that one"
            )
        return vehicle
    for craft in flown:
        if craft.id == reference.vehicle_id:
            return craft
    for path in [*sorted((space.root / "vehicles").glob("*.toml")), *list_vehicles().values()]:
        try:
            craft = load_vehicle(path)
        except ConfigurationError:  # a faulty file of the user's matters only if it is named
            continue
        if craft.id == reference.vehicle_id:
            return craft
    return None


def _scene(courses: Iterable[tuple[str | None, Course]]) -> dict[str, Any]:
    """Return waypoints, gates and keep-out shapes of the routes, in north, east, up.

    Each is listed once, with the references of its route.
    """
    by_route: dict[str, Course] = {}
    references: dict[str, list[str | None]] = {}
    for reference, course in courses:
        by_route[course[0].id] = course
        known = references.setdefault(course[0].id, [])
        if reference not in known:
            known.append(reference)
    waypoints: list[dict[str, Any]] = []
    gates: list[dict[str, Any]] = []
    shapes: list[dict[str, Any]] = []
    for identity, (route, times_s) in by_route.items():
        first = len(waypoints), len(gates), len(shapes)
        for k, (point, t_s) in enumerate(zip(route.waypoints_m, times_s, strict=True)):
            waypoints.append({"p": _up(point), "t_s": t_s, "label": str(k)})
        for gate in route.gates or ():
            centre = np.array(route.waypoints_m[gate.waypoint])
            if gate.radius_m is not None:
                gates.append({"kind": "sphere", "centre": _up(centre), "radius": gate.radius_m})
            else:
                corners = [_up(corner) for corner in gate.corners_ned(centre)]
                gates.append({"kind": "opening", "corners": corners})
        shapes += [_shape(shape) for shape in route.keep_out]
        for rows, start in zip((waypoints, gates, shapes), first, strict=True):
            for row in rows[start:]:
                row["references"] = references[identity]
    return {"waypoints": waypoints, "gates": gates, "keep_out": shapes}


def _shape(shape: Box | Sphere | Cylinder) -> dict[str, Any]:
    if isinstance(shape, Box):
        low, high = np.array(shape.min_m) * UP, np.array(shape.max_m) * UP
        return {"kind": "box", "low": np.minimum(low, high).tolist(), "high": np.maximum(low, high).tolist()}
    if isinstance(shape, Sphere):
        return {"kind": "sphere", "centre": _up(shape.centre_m), "radius": shape.radius_m}
    return {
        "kind": "cylinder",
        "centre": [*shape.centre_m, 0.0],
        "radius": shape.radius_m,
        "low": -shape.down_m[1],
        "high": -shape.down_m[0],
    }


def _up(point_ned: Any) -> list[float]:
    return (np.asarray(point_ned, dtype=float) * UP).tolist()
