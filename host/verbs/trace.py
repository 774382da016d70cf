"""`trimtab trace`: name the effects that a model lacks, from flight logs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trimtab.host.api.trace import FILES, JSON_NAME, MODEL_NAME, REPORT_NAME, trace, write_trace
from trimtab.host.verbs.options import Force, Json, Trust, WorkspaceFolder


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class TraceOptions:
    """Options of `trimtab trace`.

    Attributes
    ----------
    hold_out
        Flight logs of other references. They only measure the error before and after.
    baseline
        Flight logs before a change. The answer is what changed since then, instead of what the vehicle file
        lacks.
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
    baseline: Annotated[list[Path] | None, Parameter(name="--baseline", consume_multiple=True)] = None
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None
    network: Annotated[bool, Parameter(negative="--no-network")] = True
    jobs: int | None = None
    workspace: WorkspaceFolder = None
    trust: Trust = False
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
    from trimtab.host.base.parallel import check_jobs

    check_jobs(options.jobs)

    import sys

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.log import read_flight
    from trimtab.host.trace.words import result_lines
    from trimtab.host.workspace import open_workspace

    if not logs:
        raise UsageError("no log given; name one or more flight logs")
    for name, named in (("--hold-out", options.hold_out), ("--baseline", options.baseline)):
        if named is not None and not named:
            raise UsageError(f"{name} names no log; give one or more or leave it out")
    # Before the logs are read.
    space = open_workspace(options.workspace, trusted=options.trust)
    vehicle = None if options.vehicle is None else space.vehicle(options.vehicle)
    effects = space.effects()
    if options.output is not None:
        artefacts.check_folder(options.output, FILES, options.force)
    flights = [read_flight(path) for path in logs]
    held_out = [read_flight(path) for path in options.hold_out or ()]
    baseline = [read_flight(path) for path in options.baseline or ()]
    with Progress("tracing") as progress:
        result = trace(
            flights,
            held_out,
            baseline=baseline,
            vehicle=vehicle,
            network=options.network,
            jobs=options.jobs,
            effects=effects,
            workspace=space,
            command=sys.argv[1:],
            on_progress=lambda step: progress.advance(0.0, step),
        )
    if options.output is None:
        answer = result.to_dict()
    else:
        answer = write_trace(result, options.output, flights, held_out, force=options.force)
        say(f"model, report and JSON are in {options.output}: {MODEL_NAME}, {REPORT_NAME}, {JSON_NAME}")
    say(*result_lines(result))
    emit(answer, options.json)
