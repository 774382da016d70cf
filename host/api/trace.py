"""Trace flights with the effects and routes of a workspace, and write what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trimtab.host.api.load import vehicle_of
from trimtab.host.base.parallel import check_jobs, one_thread_of_algebra
from trimtab.host.workspace import Workspace, open_workspace

if TYPE_CHECKING:
    from trimtab.host.effects import Effect
    from trimtab.host.log import Flight
    from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
    from trimtab.host.trace.result import Trace
    from trimtab.host.vehicle import Vehicle

MODEL_NAME = "trace.model.toml"
REPORT_NAME = "trace.html"
JSON_NAME = "trace.json"
NETWORK_NAME = "unexplained.model.toml"
FILES = (MODEL_NAME, REPORT_NAME, JSON_NAME, NETWORK_NAME)


def trace(  # noqa: PLR0913 (one keyword for each choice)
    flights: Sequence[Flight],
    held_out: Sequence[Flight] = (),
    effects: Mapping[str, Effect] | None = None,
    *,
    baseline: Sequence[Flight] = (),
    vehicle: Vehicle | str | Path | None = None,
    network: bool = True,
    jobs: int | None = None,
    workspace: str | Path | Workspace | None = None,
    command: Sequence[str] = (),
    on_progress: Callable[[str], None] = lambda _: None,
) -> Trace:
    """Name the effects that a vehicle's model lacks, from its flights, as `trimtab trace` does.

    Parameters
    ----------
    flights
        Flights in which effects are searched.
    held_out
        Flights of other references. They only measure the error before and after.
    effects
        Candidate effects by name. Default: the shipped ones and those of the workspace.
    baseline
        Flights before a change. The answer is then what changed since, not what the vehicle file lacks.
    vehicle
        Vehicle that all flights must come from, or the name or path of its file. Default: the one that the
        flights name.
    network
        Train a network on the unexplained residual if the cause is outside the library. Takes about ten
        seconds.
    jobs
        Threads that work on flights. Default: the number of cores. The result does not depend on it.
    workspace
        Folder with effects, vehicles and routes of yours. Default: the current folder.
    command
        Words of the command line, recorded in the model.
    on_progress
        Called with a text as each step begins or ends.

    Returns
    -------
    Trace
        Verdict, named effects with values, standard deviations and units, findings, prediction errors, the
        proposed next flight, and the model.

    Raises
    ------
    LogsRefused
        If the flights cannot be traced, alone or together.
    TooLittleData
        If they hold too little data.
    UsageError, ConfigurationError, EffectError
        If a file of the workspace cannot be used.
    """
    check_jobs(jobs)
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.log import log_parents
    from trimtab.host.trace.run import run

    if not flights:
        raise UsageError("no flight given; give one or more")
    space = open_workspace(workspace)
    stated = None if vehicle is None else vehicle_of(vehicle, space)
    return run(
        flights,
        held_out,
        space.effects() if effects is None else effects,
        baseline=baseline,
        vehicle=stated,
        manoeuvres=lambda: flyable(space, stated or flights[0].vehicle),
        provenance=artefacts.provenance(parents=log_parents([*baseline, *flights], held_out), argv=command),
        network=network,
        jobs=jobs,
        on_progress=on_progress,
    )


@one_thread_of_algebra()
def write_trace(
    result: Trace,
    folder: str | Path,
    flights: Sequence[Flight],
    held_out: Sequence[Flight] = (),
    *,
    force: bool = False,
) -> dict[str, Any]:
    """Write the model, the report and the JSON of a trace, as `trimtab trace -o` does.

    Parameters
    ----------
    result
        What `trace` returned.
    folder
        Folder for trace.model.toml, trace.html and trace.json, and for unexplained.model.toml if a network
        was trained. Made if missing.
    flights, held_out
        The flights that were traced. The report draws them.
    force
        Overwrite these files.

    Returns
    -------
    dict[str, Any]
        The object of `Trace.to_dict`, with the paths of the files.

    Raises
    ------
    UsageError
        If a file exists and `force` is not set, or if the folder cannot be written to.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import json_text
    from trimtab.host.models.file import write_model
    from trimtab.host.report.trace import page, pictures, shown_flights

    folder = artefacts.check_folder(folder, FILES, force)
    network = None if result.unexplained is None else result.unexplained.model
    answer = result.to_dict(
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


def flyable(space: Workspace, vehicle: Vehicle) -> tuple[Manoeuvre, ...]:
    """Return the routes, shipped or in the workspace, that this vehicle can fly."""
    from trimtab.host.route import list_routes
    from trimtab.host.trace.next_flight.manoeuvres import manoeuvres
    from trimtab.host.vehicle import ConfigurationError

    routes = {}
    for name in list_routes(space.root):
        # A faulty route file does not stop a trace.
        with suppress(ConfigurationError):
            routes[name] = space.route(name)
    return manoeuvres(routes, vehicle)
