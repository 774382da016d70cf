"""`trimtab trace`: name the effects that a model lacks, from flight logs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.log import Flight
    from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
    from trimtab.host.trace.result import Trace
    from trimtab.host.vehicle import Vehicle
    from trimtab.host.workspace import Workspace

MODEL_NAME = "trace.model.toml"
REPORT_NAME = "trace.html"
JSON_NAME = "trace.json"
NETWORK_NAME = "unexplained.model.toml"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class TraceOptions:
    """Options of `trimtab trace`.

    Attributes
    ----------
    hold_out
        Flight logs of other references. They only measure the error before and after.
    vehicle
        Vehicle that the logs must come from. Default: the one that they name.
    output
        Folder for model, report and JSON. Made if missing. Without it, no file is written.
    network
        Train a network on the unexplained residual if the cause is outside the library. Takes about ten
        seconds.
    jobs
        Threads that work on flights. Default: the number of cores. The result does not depend on it.
    """

    hold_out: Annotated[list[Path] | None, Parameter(name="--hold-out", consume_multiple=True)] = None
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None
    network: Annotated[bool, Parameter(negative="--no-network")] = True
    jobs: int | None = None
    workspace: WorkspaceFolder = None
    json: Json = False
    force: Force = False


DEFAULTS = TraceOptions()


def command(*logs: Path, options: TraceOptions = DEFAULTS) -> None:
    """Name the effects that a vehicle's model lacks, from flight logs.

    Parameters
    ----------
    logs
        Flight logs to trace.
    """
    from trimtab.host.base.parallel import check_jobs, one_thread_of_algebra

    check_jobs(options.jobs)
    one_thread_of_algebra()

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.effects import load_effects
    from trimtab.host.log import log_parents, read_flight
    from trimtab.host.trace.answer import to_json
    from trimtab.host.trace.run import run
    from trimtab.host.trace.words import result_lines
    from trimtab.host.workspace import open_workspace

    if not logs:
        raise UsageError("no log given; name one or more flight logs")
    if options.hold_out is not None and not options.hold_out:
        raise UsageError("--hold-out names no log; give one or more or leave it out")
    space = open_workspace(options.workspace)
    vehicle = None if options.vehicle is None else space.vehicle(options.vehicle)
    if options.output is not None:
        artefacts.check_folder(
            options.output, (MODEL_NAME, REPORT_NAME, JSON_NAME, NETWORK_NAME), options.force
        )
    flights = [read_flight(path) for path in logs]
    held_out = [read_flight(path) for path in options.hold_out or ()]
    airframe = vehicle or flights[0].vehicle
    with Progress("tracing") as progress:
        result = run(
            flights,
            held_out,
            load_effects(space.root),
            vehicle=vehicle,
            manoeuvres=lambda: manoeuvres(space, airframe),
            provenance=artefacts.provenance(parents=log_parents(flights, held_out)),
            network=options.network,
            jobs=options.jobs,
            on_progress=lambda step: progress.advance(0.0, step),
        )
    answer = (
        to_json(result)
        if options.output is None
        else _write(result, flights, held_out, options.output, options.force)
    )
    if options.output is not None:
        say(f"model, report and JSON are in {options.output}: {MODEL_NAME}, {REPORT_NAME}, {JSON_NAME}")
    say(*result_lines(result))
    emit(answer, options.json)


def _write(
    result: Trace, flights: Sequence[Flight], held_out: Sequence[Flight], folder: Path, force: bool
) -> dict[str, Any]:
    """Write model, report, JSON and, if there is one, the network; return the answer with their paths."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import json_text
    from trimtab.host.models.file import write_model
    from trimtab.host.report.trace import page, pictures, shown_flights
    from trimtab.host.trace.answer import to_json

    network = None if result.unexplained is None else result.unexplained.model
    answer = to_json(
        result,
        model_path=str(folder / MODEL_NAME),
        report_path=str(folder / REPORT_NAME),
        network_path=None if network is None else str(folder / NETWORK_NAME),
    )
    shown = shown_flights(result, flights, held_out)
    report = page(result, flights, held_out, shown, answer, pictures(result))
    folder.mkdir(parents=True, exist_ok=True)
    write_model(result.model, folder / MODEL_NAME, force=force)
    if network is not None:
        write_model(network, folder / NETWORK_NAME, force=force)
    artefacts.write_atomic(folder / REPORT_NAME, report, force)
    artefacts.write_atomic(folder / JSON_NAME, json_text(answer), force)
    return answer


def manoeuvres(space: Workspace, vehicle: Vehicle) -> tuple[Manoeuvre, ...]:
    """Return the routes, shipped or in the workspace, that this vehicle can fly."""
    from trimtab.host.route import list_routes
    from trimtab.host.trace.next_flight.manoeuvres import manoeuvres as flyable
    from trimtab.host.vehicle import ConfigurationError

    routes = {}
    for name in list_routes(space.root):
        # A faulty route file does not stop a trace.
        with suppress(ConfigurationError):
            routes[name] = space.route(name)
    return flyable(routes, vehicle)
