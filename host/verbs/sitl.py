"""`trimtab sitl`: a simulated vehicle and its camera system, played in real time at a port."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import DEFAULT_VEHICLE, Force, Json, VehicleName, WorkspaceFolder


def command(
    *,
    port: str,
    mocap: str | None = None,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    world: str | None = None,
    plant: str | None = None,
    plant_options: str | None = None,
    world_seed: int = 0,
    flight: int = 0,
    start: Annotated[tuple[float, float], Parameter(negative="")] = (0.0, 0.0),
    memory: Path | None = None,
    truth: Path | None = None,
    force: Force = False,
    json: Json = False,
    workspace: WorkspaceFolder = None,
) -> None:
    """Play a simulated vehicle and its camera system at a port, until interrupted.

    Parameters
    ----------
    port
        pty, tcp:HOST:PORT or udp:HOST:PORT; the first line printed says what to open.
    mocap
        Where the camera system sends its poses, udp://HOST:PORT.
    world
        World to simulate, by name or path; the empty one by default.
    plant
        Somebody else's physics in place of a world, path.py:Class.
    plant_options
        TOML file that is handed to the plant.
    world_seed
        Seed of the simulated world.
    flight
        Index of the flight.
    start
        Where the vehicle stands, north and east in m.
    memory
        File of the vehicle's memory, made where there is none: what is live, half an upload, parameters.
        Without, nothing outlives this run.
    truth
        File for what the world holds; only checks should open it.
    """
    import json as encoder
    from contextlib import closing

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.link.vehicle import vehicle_class
    from trimtab.host.workspace import open_workspace

    if min(world_seed, flight) < 0:
        raise UsageError("seeds and flight indices are not negative")
    if not all(map(math.isfinite, start)):
        raise UsageError(f"--start {start[0]:g} {start[1]:g} is no place, give two numbers in m")
    airframe = open_workspace(workspace).vehicle(vehicle)
    fence = airframe.limits.geofence_m
    for axis, place, (least, most) in zip(("north", "east"), start, fence, strict=False):
        if not least <= place <= most:
            raise UsageError(
                f"--start {start[0]:g} {start[1]:g}: {axis} {place:g} m is outside the fence of "
                f"{airframe.name}, give {least:g} to {most:g}"
            )
    if truth is not None:
        artefacts.check_output(truth, force)

    with _stop_on_signal() as stop:
        simulated = vehicle_class().create(
            airframe,
            world=world,
            world_seed=world_seed,
            flight=flight,
            plant=plant,
            plant_options=plant_options,
            start_ned=(*start, 0.0),
            memory=memory,
        )

        def ready(address: str) -> None:
            if truth is not None:
                text = encoder.dumps({**simulated.truth(), "log": None}, indent=2, sort_keys=True) + "\n"
                artefacts.write_atomic(truth, text, force)
            say(address)

        with closing(simulated):
            statistics = simulated.serve(port=port, stop=stop, mocap=mocap, ready=ready)
    simulated_s = statistics.simulated_us * 1e-6
    say(f"{simulated_s:.1f} s simulated, late {statistics.overruns} times")
    emit(
        {
            "simulated_s": simulated_s,
            "overruns": statistics.overruns,
            "stretched_s": statistics.stretched_us * 1e-6,
        },
        json,
    )


@contextmanager
def _stop_on_signal() -> Iterator[Callable[[], bool]]:
    """Says whether the process was asked to end: for a server that is the ordinary way out."""
    asked: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        asked.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
