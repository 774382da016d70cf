"""`trimtab import`: convert a foreign flight log to a Trimtab log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.imports.recording import Recording
    from trimtab.host.vehicle import Vehicle
    from trimtab.host.workspace import Workspace


def command(
    profile: Literal["nanobench", "crazyflie-usd", "csv"],
    path: Path,
    *,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    columns: Path | None = None,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    workspace: WorkspaceFolder = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Convert a foreign flight log to a Trimtab log.

    Parameters
    ----------
    profile
        Format of the foreign log.
    path
        Foreign log to read.
    output
        Flight log to write.
    columns
        TOML file that gives the meaning of each column. For csv.
    vehicle
        Vehicle that flew: its file, by name or path. It has no default, because it decides the result.
    """
    import sys

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.imports.profiles import read
    from trimtab.host.log import read_flight
    from trimtab.host.workspace import open_workspace

    artefacts.check_log(output, force)
    if (profile == "csv") != (columns is not None):
        raise UsageError("the csv profile needs --columns MAP.toml; other profiles do not take it")
    airframe = _vehicle(open_workspace(workspace), vehicle)
    recording = read(profile, path, columns)
    words = artefacts.without_options(sys.argv[1:], ("-o", "--output"), ("--json", "--force"))
    provenance = {
        "version": artefacts.version(),
        "command": artefacts.public_command(words),
        "source_id": artefacts.content_id(path.read_bytes()),
    }
    if columns is not None:
        provenance["columns_id"] = artefacts.content_id(columns.read_bytes())
    topics = _write(recording, airframe, output, profile, provenance)
    flight = read_flight(output)
    mass = f", {recording.mass_kg:g} kg as declared" if recording.mass_kg is not None else ""
    unknown = f"; unknown: {', '.join(recording.unknown)}" if recording.unknown else ""
    say(
        f"{output}: {flight.duration_s:.1f} s of {flight.vehicle.name}{mass}, "
        f"{sum(topics.values())} messages{unknown}"
    )
    answer = {
        "log": str(output),
        "vehicle": flight.vehicle.name,
        "duration_s": flight.duration_s,
        "topics": topics,
        "mass_kg": flight.vehicle.mass_kg,
        "unknown": recording.unknown,
    }
    emit(answer, json)


def _vehicle(workspace: Workspace, name: str | None) -> Vehicle:
    """Return the vehicle that flew. Raises UsageError without a name: a wrong one gives wrong physics."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.vehicle import list_vehicles

    if name is None:
        known = ", ".join(list_vehicles(workspace.root))
        raise UsageError(
            f"which vehicle flew? give --vehicle one of {known}, or the .toml file of another, "
            "made from one of these with its own mass, rotors and motors"
        )
    return workspace.vehicle(name)


def _write(
    recording: Recording, vehicle: Vehicle, output: Path, profile: str, provenance: dict[str, str]
) -> dict[str, int]:
    """Write the complete log or nothing. Return the number of messages of each topic."""
    from trimtab.host.imports.write import write
    from trimtab.host.log import partial_path

    growing = output.with_name(output.name + ".import")
    try:
        topics = write(recording, vehicle, growing, profile=profile, provenance=provenance)
        growing.replace(output)
    finally:
        growing.unlink(missing_ok=True)
        partial_path(growing).unlink(missing_ok=True)
    return topics
