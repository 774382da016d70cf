"""Route files: found by name or path, read strictly, expanded into waypoints."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from trimtab.host.base.bounds import WAYPOINTS
from trimtab.host.route.checks import TIME_MAX_S, check_route
from trimtab.host.route.gates import Gate
from trimtab.host.route.generators import FigureEight, RandomWaypoints
from trimtab.host.route.laps import LAPS_MAX, flown
from trimtab.host.route.model import LEG_MIN_M, LimitsOverride, Route, YawProfile
from trimtab.host.route.shapes import Shape
from trimtab.host.vehicle.files import find_file, list_files, read_text, shown
from trimtab.host.vehicle.model import Name, Positive, Vector3, Vehicle
from trimtab.host.vehicle.strict_toml import ConfigurationError, Strict, parse_toml, validate


class RouteFile(Strict):
    """A route file: a Route whose waypoints are listed or made by exactly one generator.

    description: one line on the purpose of the route; no part of the route. closed: the waypoints are one
    lap, which returns to the first waypoint and is flown `laps` times, 1 by default.
    """

    name: Name
    description: str | None = None
    waypoints_m: Annotated[tuple[Vector3, ...], Field(min_length=2, max_length=WAYPOINTS.limit)] | None = None
    figure_eight: FigureEight | None = None
    random: RandomWaypoints | None = None
    closed: bool = False
    laps: Annotated[int, Field(ge=1, le=LAPS_MAX)] | None = None
    times_s: tuple[float, ...] | None = None
    total_time_s: Positive | None = None
    yaw: YawProfile = YawProfile()
    limits: LimitsOverride = LimitsOverride()
    keep_out: tuple[Shape, ...] = ()
    gates: tuple[Gate, ...] | None = None
    start_velocity_m_s: Vector3 | None = None
    end_velocity_m_s: Vector3 | None = None

    @model_validator(mode="after")
    def _one_source_of_waypoints(self) -> Self:
        given = [self.waypoints_m, self.figure_eight, self.random]
        if sum(source is not None for source in given) != 1:
            raise ValueError("give exactly one of waypoints_m, [figure_eight] and [random]")
        return self

    @model_validator(mode="after")
    def _closes_where_it_may(self) -> Self:
        if not self.closed:
            if self.laps is not None:
                raise ValueError("laps: only a closed route has laps, add closed = true or leave laps out")
            return self
        if self.figure_eight is not None:
            raise ValueError("closed: a figure eight is closed as it is, leave closed out and give it turns")
        for name in ("start_velocity_m_s", "end_velocity_m_s"):
            if getattr(self, name) is not None:
                raise ValueError(f"{name}: a closed route starts and ends at rest, leave it out")
        points = self.waypoints_m or ()
        if points and math.dist(points[0], points[-1]) < LEG_MIN_M:
            raise ValueError(
                "waypoints_m: the last is the first, to which closed returns; leave the last out"
            )
        if points and self.times_s is not None and len(self.times_s) != len(points) + 1:
            raise ValueError(
                f"times_s: {len(self.times_s)} for a lap through {len(points)} waypoints_m, give "
                f"{len(points) + 1}: one each, and that of the return to the first"
            )
        return self

    def expanded(self, source: str) -> Route:
        """Return the route with its waypoints listed, lap after lap. Raises ConfigurationError."""
        fields = {name: getattr(self, name) for name in Route.model_fields}
        if self.figure_eight is not None:
            fields["waypoints_m"] = self.figure_eight.waypoints()
        if self.random is not None:
            fields["waypoints_m"] = self.random.waypoints()
        if not self.closed:
            return validate(fields | self._drawn_time(fields["waypoints_m"]), source, Route)
        lap, laps = fields["waypoints_m"], self.laps or 1
        if len(lap) * laps > WAYPOINTS.limit:
            raise ConfigurationError([f"{source}: laps: {WAYPOINTS.problem(len(lap) * laps)}"])
        fields["waypoints_m"] = (*lap, lap[0])
        whole = self._drawn_time((*lap * laps, lap[0]))
        return flown(validate(fields | whole, source, Route), laps)

    def _drawn_time(self, waypoints_m: Sequence[Vector3]) -> dict[str, float]:
        """Return the total time of a random route where the file gives none."""
        if self.random is None or self.times_s is not None or self.total_time_s is not None:
            return {}
        return {"total_time_s": self.random.total_time_s(waypoints_m)}


def parse_route(text: str, source: str, vehicle: Vehicle | None = None) -> Route:
    """Return the route in a TOML text; `source` names it in errors.

    Raises ConfigurationError with every problem. If some keys are invalid, the other keys are still checked
    against the vehicle.
    """
    return _read(text, source, vehicle).expanded(source)


def _read(text: str, source: str, vehicle: Vehicle | None) -> RouteFile:
    """Return the route file in a TOML text. Raises ConfigurationError."""
    data = parse_toml(text, source)
    try:
        return validate(data, source, RouteFile)
    except ConfigurationError as error:
        more = () if vehicle is None else _contradictions(data, error.problems, source, vehicle)
        raise ConfigurationError([*error.problems, *more]) from None


def _contradictions(data: dict[str, Any], known: Sequence[str], source: str, vehicle: Vehicle) -> list[str]:
    """Return the problems of the rest of a route, without the keys that `known` problems name."""
    wrong = {re.split(r"[.:\[]", line.removeprefix(f"{source}: "))[0] for line in known}
    if wrong & {"waypoints_m", "figure_eight", "random"}:
        return []
    rest = {"name": "route"} | {key: value for key, value in data.items() if key not in wrong}
    if not rest.keys() & {"times_s", "total_time_s"}:
        rest["total_time_s"] = TIME_MAX_S
    try:
        check_route(validate(rest, source, RouteFile).expanded(source), vehicle, source)
    except ConfigurationError as error:
        return [line for line in error.problems if line not in known]
    return []


def load_route(
    name_or_path: str | Path, workspace: Path | None = None, vehicle: Vehicle | None = None
) -> Route:
    """Return the route of a path, or of a name in `workspace`/routes or else among the shipped routes.

    `NAME:SEED` draws a route with a [random] table again with that seed. Raises ConfigurationError (exit code
    2) as `parse_route` does.
    """
    path, seed = _place(name_or_path, workspace)
    if not seed:
        return parse_route(read_text(path), shown(path), vehicle)
    file = _read(read_text(path), shown(path), vehicle)
    if file.random is None or not (seed.isascii() and seed.isdigit()):
        raise ConfigurationError(
            [f"{name_or_path}: :SEED is a whole number after a route with a [random] table"]
        )
    drawn = file.random.model_copy(update={"seed": int(seed)})
    return file.model_copy(update={"random": drawn, "name": f"{file.name}-{int(seed)}"}).expanded(shown(path))


def route_file(name_or_path: str | Path, workspace: Path | None = None) -> str:
    """Return the name in messages of the file that `load_route` reads. Raises ConfigurationError."""
    return shown(_place(name_or_path, workspace)[0])


def _place(name_or_path: str | Path, workspace: Path | None) -> tuple[Path, str]:
    """Return file and seed of a route's name or path; the seed is empty without one."""
    seed = ""
    if isinstance(name_or_path, str):
        name_or_path, _, seed = name_or_path.partition(":")
    return find_file(name_or_path, "routes", workspace, what="route"), seed


def route_description(name_or_path: str | Path, workspace: Path | None = None) -> str | None:
    """Return the description in a route's file. Raises ConfigurationError as `load_route` does."""
    path, _ = _place(name_or_path, workspace)
    return _read(read_text(path), shown(path), None).description


def list_routes(workspace: Path | None = None) -> dict[str, Path]:
    """Return all routes, name to file; those of `workspace` replace shipped ones of the same name."""
    return list_files("routes", workspace)
