"""`trimtab trace`: names the missing effects behind flight logs."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
    from trimtab.host.vehicle import Vehicle
    from trimtab.host.workspace import Workspace

MODEL_NAME = "trace.model.toml"
REPORT_NAME = "trace.html"
JSON_NAME = "trace.json"
NETWORK_NAME = "unexplained.model.toml"


def command(
    *logs: Path,
    hold_out: Annotated[list[Path] | None, Parameter(name="--hold-out", consume_multiple=True)] = None,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None,
    network: Annotated[bool, Parameter(negative="--no-network")] = True,
    workspace: WorkspaceFolder = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Name the missing effects behind flight logs.

    Parameters
    ----------
    logs
        Flight logs to trace.
    hold_out
        Flight logs of other references, used for the error before and after only.
    vehicle
        Vehicle the logs must be of; without it, the one they name.
    output
        Folder for model, report and JSON; made if missing. Nothing is written without it.
    network
        Where the cause is outside the library, train a network on what is left: some ten seconds more.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, json_text, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.effects import load_effects
    from trimtab.host.log import read_flight
    from trimtab.host.trace.answer import to_json
    from trimtab.host.trace.run import run
    from trimtab.host.trace.words import result_lines
    from trimtab.host.workspace import open_workspace

    if not logs:
        raise UsageError("no log given, name one or more flight logs")
    if hold_out is not None and not hold_out:
        raise UsageError("--hold-out names no log, give one or more or leave it out")
    space = open_workspace(workspace)
    wanted = None if vehicle is None else space.vehicle(vehicle)
    if output is not None:
        artefacts.check_folder(output, (MODEL_NAME, REPORT_NAME, JSON_NAME, NETWORK_NAME), force)
    flights = [read_flight(path) for path in logs]
    held_out = [read_flight(path) for path in hold_out or ()]
    airframe = wanted or flights[0].vehicle
    with Progress("tracing") as progress:
        result = run(
            flights,
            held_out,
            load_effects(space.root),
            vehicle=wanted,
            manoeuvres=lambda: manoeuvres(space, airframe),
            provenance=artefacts.provenance(parents={f"log {i}": f.id for i, f in enumerate(flights)}),
            network=network,
            report=lambda step: progress.advance(0.0, step),
        )
    model_path = report_path = network_path = None
    if output is not None:
        from trimtab.host.models.file import write_model
        from trimtab.host.report.trace import page

        model_path, report_path = str(output / MODEL_NAME), str(output / REPORT_NAME)
        learned = None if result.unexplained is None else result.unexplained.model
        if learned is not None:
            network_path = str(output / NETWORK_NAME)
        answer = to_json(result, model_path=model_path, report_path=report_path, network_path=network_path)
        report = page(result, flights, held_out, answer)
        output.mkdir(exist_ok=True)
        write_model(result.model, output / MODEL_NAME, force=force)
        if learned is not None:
            write_model(learned, output / NETWORK_NAME, force=force)
        artefacts.write_atomic(output / REPORT_NAME, report, force)
        artefacts.write_atomic(output / JSON_NAME, json_text(answer), force)
        say(f"model, report and JSON are in {output}: {MODEL_NAME}, {REPORT_NAME}, {JSON_NAME}")
    say(*result_lines(result))
    emit(to_json(result, model_path=model_path, report_path=report_path, network_path=network_path), json)


def manoeuvres(space: Workspace, vehicle: Vehicle) -> tuple[Manoeuvre, ...]:
    """Return the shipped routes and the workspace's own that this vehicle can fly."""
    from trimtab.host.route import list_routes
    from trimtab.host.trace.next_flight.manoeuvres import manoeuvres as flyable
    from trimtab.host.vehicle import ConfigurationError

    routes = {}
    for name in list_routes(space.root):
        # A route file with a mistake in it is no reason to stop a trace.
        with suppress(ConfigurationError):
            routes[name] = space.route(name)
    return flyable(routes, vehicle)
