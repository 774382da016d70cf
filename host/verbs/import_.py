"""`trimtab import`: somebody else's flight log becomes one of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from host.verbs.options import Force, Json, VehicleName, WorkspaceFolder


def command(
    profile: Literal["nanobench", "crazyflie-usd", "csv"],
    path: Path,
    *,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    columns: Path | None = None,
    vehicle: VehicleName = "nano",
    workspace: WorkspaceFolder = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Turn somebody else's flight log into one of ours.

    Parameters
    ----------
    profile
        Format of the log.
    path
        The log.
    output
        Flight log to write.
    columns
        For csv: TOML file that says which column is what.
    """
    from host import artefacts
    from host.errors import UsageError
    from host.imports.write import write
    from host.log import read_flight
    from host.output import emit, say
    from host.workspace import open_workspace

    artefacts.check_output(output, force)
    if (profile == "csv") != (columns is not None):
        raise UsageError("--columns MAP.toml goes with the csv profile, and only with it")
    airframe = open_workspace(workspace).vehicle(vehicle)
    if profile == "nanobench":
        from host.imports.nanobench import read

        recording = read(path)
    elif profile == "crazyflie-usd":
        from host.imports.crazyflie_usd import read

        recording = read(path)
    else:
        from host.imports.columns import read as read_columns

        assert columns is not None
        recording = read_columns(path, columns)
    partial = output.with_name(output.name + ".part")
    try:
        topics = write(recording, airframe, partial, profile=profile)
        partial.replace(output)
    finally:
        partial.unlink(missing_ok=True)
    flight = read_flight(output)
    unknown = f"; unknown: {', '.join(recording.unknown)}" if recording.unknown else ""
    say(
        f"{output}: {flight.duration_s:.1f} s of {flight.vehicle.name}, "
        f"{sum(topics.values())} messages{unknown}"
    )
    emit(
        {
            "log": str(output),
            "vehicle": flight.vehicle.name,
            "duration_s": flight.duration_s,
            "topics": topics,
        },
        json,
    )
