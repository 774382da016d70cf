"""`trimtab plan --pareto`: a route planned with scaled weights, and flown where a world is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from trimtab.host.models.model import Model
    from trimtab.host.plan.pareto import Point
    from trimtab.host.route import Route
    from trimtab.host.vehicle import Vehicle

_LEFT_OUT_WITH_VALUE = ("-o", "--output", "--report", "--workspace")
_LEFT_OUT = ("--json", "--force")


@dataclass(frozen=True, kw_only=True)
class Hangar:
    """Where plans are flown: world by name or path, its seed, and the folder for references and logs."""

    world: str
    world_seed: int
    folder: Path
    force: bool


def check_options(world: str | None, world_seed: int, output: Path | None, *, pareto: bool) -> None:
    """Refuse options of a flown trade that do not go together. Raises UsageError."""
    from trimtab.host.base.errors import UsageError

    if world is not None and not pareto:
        raise UsageError("--world goes with --pareto: `trimtab fly` flies a single reference")
    if world is None and world_seed:
        raise UsageError("--world-seed goes with --world")
    if world_seed < 0:
        raise UsageError(f"--world-seed {world_seed} is negative, give 0 or more")
    if pareto and world is None and output is not None:
        raise UsageError("--pareto goes without --output where no --world is named: it writes no reference")


def trade(
    route: Route,
    vehicle: Vehicle,
    model: Model,
    *,
    options: Mapping[str, Any],
    hangar: Hangar | None,
    origin: Mapping[str, Any],
    report: Path | None,
    force: bool,
    json: bool,
) -> None:
    """Plan, fly, tell. options: more of `host.plan.pareto.pareto`. origin: the provenance of what is written.

    Raises Refused where no plan was found, FlightFailed where none was flown to its end.
    """
    from dataclasses import replace

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import FlightFailed, Refused
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.plan.pareto import FACTORS, pareto

    count = len(FACTORS) + 2
    fly = None if hangar is None else _Flights(hangar, vehicle, model.id, origin)
    with Progress(f"planning {route.name}", count if fly is None else 2 * count) as progress:
        points = pareto(
            route, vehicle, model, on_point=lambda point: progress.advance(1.0, point.label), **options
        )
        if fly is not None:
            for k, point in enumerate(points):
                progress.advance(0.0, f"flying {point.label}")
                if point.plan is not None:
                    points[k] = replace(point, flown=fly(point))
                progress.advance(1.0)
    if report is not None:
        from trimtab.host.report.plan import trade_page

        artefacts.write_atomic(report, trade_page(points, route, origin), force)
    say(*_lines(points))
    if hangar is not None:
        say(f"references and logs are in {hangar.folder}")
    if report is not None:
        say(f"the report is {report}")
    folder = None if hangar is None else str(hangar.folder)
    emit({"points": [point.to_json() for point in points], "folder": folder, "report": report}, json)
    if all(point.plan is None for point in points):
        raise Refused(f"{route.name}: none of the plans was found, give it more time or headroom")
    if fly is not None and all(point.error_mean_m is None for point in points):
        raise FlightFailed(f"{route.name}: none of the plans was flown to its end")


class _Flights:
    """Flies points, all as the same flight of the same world: what differs is the plan."""

    def __init__(self, hangar: Hangar, vehicle: Vehicle, model_id: str, origin: Mapping[str, Any]) -> None:
        """Raise ConfigurationError where there is no such world, UsageError for a folder that is taken."""
        import sys

        from trimtab.host.apps.demo.flights import Airfield
        from trimtab.host.base import artefacts
        from trimtab.host.verbs.demo import free_folder

        kept = artefacts.without_options(sys.argv[1:], _LEFT_OUT_WITH_VALUE, _LEFT_OUT)
        told = {
            "version": origin["version"],
            "git": origin["git"],
            "command": artefacts.public_command(kept),
        }
        self._field = Airfield(
            vehicle=vehicle,
            world=hangar.world,
            world_seed=hangar.world_seed,
            session={key: value for key, value in told.items() if value is not None},
        )
        self._field.check()
        self._folder = free_folder(hangar.folder.parent, hangar.folder, hangar.force)
        self._force, self._model_id, self._origin = hangar.force, model_id, origin

    def __call__(self, point: Point) -> Any:
        """Return the point's `Flown`; its reference is written too."""
        from trimtab.host.base import artefacts
        from trimtab.host.plan.files import write_plan
        from trimtab.host.plan.flown import fly_plan

        assert point.plan is not None
        self._folder.mkdir(exist_ok=True)
        name = point.label.replace("*", "-augmented").replace(" x ", "-x")
        write_plan(point.plan, self._folder / f"{name}.ref", provenance=self._origin, force=self._force)
        log = artefacts.check_log(self._folder / f"{name}.mcap", self._force)
        return fly_plan(point.plan, self._field, flight=0, log=log, model_id=self._model_id)


def _lines(points: Sequence[Point]) -> list[str]:
    """Return the trade for people: a table, then why plans or flights are missing."""
    from trimtab.host.plan.pareto import tabulate

    units, cells = tabulate(points)
    rows = [("plan", *units, "status"), ("", *units.values(), "")]
    rows += [(point.label, *row, point.status) for point, row in zip(points, cells, strict=True)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if k in (0, len(row) - 1) else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return lines + [f"{point.label}: {point.why_not}" for point in points if point.why_not is not None]
