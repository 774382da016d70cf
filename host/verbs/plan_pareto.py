"""`trimtab plan --pareto`: plan a route with scaled weights, and fly the plans in a world."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trimtab.host.api.plan import PlanTask
    from trimtab.host.plan.flown import Flown
    from trimtab.host.plan.pareto import Point
    from trimtab.host.verbs.plan_options import PlanOptions

_LEFT_OUT_WITH_VALUE = ("-o", "--output", "--report")
_LEFT_OUT = ("--json", "--force")


def check_options(options: PlanOptions) -> None:
    """Check that the options of a comparison go together. Raises UsageError."""
    from trimtab.host.base.errors import UsageError

    if options.world is not None and not options.pareto:
        raise UsageError("--world needs --pareto; fly a single reference with `trimtab fly`")
    if options.world is None and options.world_seed:
        raise UsageError("--world-seed needs --world")
    if options.world_seed < 0:
        raise UsageError(f"--world-seed {options.world_seed} is negative; give 0 or more")
    if options.pareto and options.world is None and options.output is not None:
        raise UsageError("--pareto without --world does not take --output: it writes no reference")


def trade(task: PlanTask, options: PlanOptions) -> None:
    """Plan with each weight, fly the plans if a world is given, and print the comparison.

    Raises Refused if no plan was found, FlightFailed if none was flown to its end.
    """
    from dataclasses import replace

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import FlightFailed, Refused
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.plan.pareto import FACTORS, pareto

    assert task.model is not None
    count = len(FACTORS) + 2
    flown: list[Flown | None] = []
    with ExitStack() as stack:
        fly = None if options.world is None else _Flights(task, options, options.world, stack)
        progress = stack.enter_context(Progress(f"planning {task.route.name}"))

        def on_point(point: Point) -> None:
            """Fly the point's plan at once, so that the points take about the same time."""
            progress.advance(0.0, point.label)
            flown.append(None if fly is None or point.plan is None else fly(point))
            progress.update(len(flown), total=count)  # the first one also compiled what all need

        points = pareto(
            task.route,
            task.vehicle,
            task.model,
            kind=options.kind or "min-residual",
            on_point=on_point,
            **task.planner_options,
        )
    points = [replace(point, flown=result) for point, result in zip(points, flown, strict=True)]
    if options.report is not None:
        from trimtab.host.report.plan import trade_page

        text = trade_page(points, task.route, task.provenance)
        artefacts.write_atomic(options.report, text, options.force)
    say(*_lines(points))
    if fly is not None:
        say(f"references and logs are in {fly.folder}")
    if options.report is not None:
        say(f"the report is {options.report}")
    folder = None if fly is None else str(fly.folder)
    answer = {"points": [point.to_json() for point in points], "folder": folder, "report": options.report}
    emit(answer, options.json)
    if all(point.plan is None for point in points):
        raise Refused(f"{task.route.name}: no plan was found; give the route more time or headroom")
    if fly is not None and all(point.error_mean_m is None for point in points):
        raise FlightFailed(f"{task.route.name}: none of the plans was flown to its end")


class _Flights:
    """Simulated flights of the points. All have the same world and flight index; only the plan differs."""

    def __init__(self, task: PlanTask, options: PlanOptions, world: str, stack: ExitStack) -> None:
        """Check the world (ConfigurationError if it is unknown) and reserve the folder (UsageError).

        stack: ends the reservation.
        """
        import sys

        from trimtab.host.apps.demo.flights import Airfield
        from trimtab.host.base import artefacts

        arguments = artefacts.without_options(sys.argv[1:], _LEFT_OUT_WITH_VALUE, _LEFT_OUT)
        self._field = Airfield(
            vehicle=task.vehicle,
            world=world,
            world_seed=options.world_seed,
            session=artefacts.log_provenance(arguments),
            force=options.force,
        )
        self._field.check()
        folder = options.output or Path(f"{task.route.name}-pareto")
        self.folder = stack.enter_context(artefacts.own_folder(folder, options.force))
        self._task, self._force = task, options.force

    def __call__(self, point: Point) -> Flown:
        """Fly the point's plan; write its reference and log."""
        from trimtab.host.plan.files import write_plan
        from trimtab.host.plan.flown import fly_plan

        assert point.plan is not None
        assert self._task.model is not None
        name = point.label.replace("*", "-augmented").replace(" x ", "-x")
        reference = self.folder / f"{name}.ref"
        write_plan(point.plan, reference, provenance=self._task.provenance, force=self._force)
        log = self.folder / f"{name}.mcap"
        return fly_plan(point.plan, self._field, flight=0, log=log, model_id=self._task.model.id)


def _lines(points: Sequence[Point]) -> list[str]:
    """Return the comparison as lines of text: a table, then why plans or flights are missing."""
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
