"""`trimtab sitl`: simulate a vehicle and its camera system in real time at a port."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, Trust, VehicleName, WorkspaceFolder
from trimtab.host.workspace import DEFAULT_VEHICLE

if TYPE_CHECKING:
    from trimtab.host.vehicle import Vehicle


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SitlOptions:
    """Options of `trimtab sitl`.

    Attributes
    ----------
    mocap
        Address to which the camera system sends its poses, udp://HOST:PORT.
    world
        World to simulate, by name or path. Default: the empty world.
    plant
        Physics of your own, path.py:Class. With `world`, it acts out that world.
    plant_options
        TOML file that the plant receives.
    world_seed
        Seed of the simulated world.
    flight
        Index of the flight.
    autopilot
        px4 or ardupilot: speak as that autopilot would, to rehearse a flight by setpoints.
    start
        Position at which the vehicle stands, north and east in m. It stands there again if it has crashed and
        a ground station reboots it.
    memory
        File for the vehicle's memory: live blobs, unfinished uploads, parameters. Made if missing. Without
        it, the memory is lost when the run ends.
    truth
        File for the world's truth. Only checks should open it.
    """

    mocap: str | None = None
    vehicle: VehicleName = DEFAULT_VEHICLE
    world: str | None = None
    plant: str | None = None
    plant_options: str | None = None
    world_seed: int = 0
    flight: int = 0
    autopilot: Literal["px4", "ardupilot"] | None = None
    start: Annotated[tuple[float, float], Parameter(negative="")] = (0.0, 0.0)
    memory: Path | None = None
    truth: Path | None = None
    force: Force = False
    json: Json = False
    workspace: WorkspaceFolder = None
    trust: Trust = False


DEFAULTS = SitlOptions()


def command(*, port: str, options: SitlOptions = DEFAULTS) -> None:
    """Simulate a vehicle and its camera system at a port, until interrupted.

    Parameters
    ----------
    port
        pty, tcp:HOST:PORT or udp:HOST:PORT. The first line printed names the address to open.
    """
    import json as encoder
    from contextlib import closing

    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say, warn
    from trimtab.host.link.vehicle import vehicle_class

    vehicle = _check(options)
    with _stop_on_signal() as stop:
        simulated = vehicle_class().create(
            vehicle,
            world=options.world,
            world_seed=options.world_seed,
            flight=options.flight,
            plant=options.plant,
            plant_options=options.plant_options,
            plant_trusted=options.trust,
            start_ned=(*options.start, 0.0),
            memory=options.memory,
            at_port=True,
        )

        def on_ready(address: str) -> None:
            if options.truth is not None:
                text = encoder.dumps({**simulated.truth(), "log": None}, indent=2, sort_keys=True) + "\n"
                artefacts.write_atomic(options.truth, text, options.force)
            say(address)

        with closing(simulated):
            served = simulated if options.autopilot is None else simulated.as_autopilot(options.autopilot)
            statistics = served.serve(port=port, stop=stop, mocap=options.mocap, ready=on_ready, on_late=warn)
    simulated_s = statistics.simulated_us * 1e-6
    say(f"{simulated_s:.1f} s simulated, {statistics.overruns} times behind real time")
    answer = {
        "simulated_s": simulated_s,
        "overruns": statistics.overruns,
        "stretched_s": statistics.stretched_us * 1e-6,
        "late_ms_max": statistics.late_us * 1e-3,
    }
    emit(answer, options.json)


def _check(options: SitlOptions) -> Vehicle:
    """Return the vehicle that the options name. Raises UsageError."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.workspace import open_workspace

    start = options.start
    if min(options.world_seed, options.flight) < 0:
        raise UsageError("a seed or flight index is negative; give 0 or more")
    if not all(map(math.isfinite, start)):
        raise UsageError(f"--start {start[0]:g} {start[1]:g} is not a position; give two numbers in m")
    vehicle = open_workspace(options.workspace, trusted=options.trust).vehicle(options.vehicle)
    fence = vehicle.limits.geofence_m
    for axis, position, (low, high) in zip(("north", "east"), start, fence, strict=False):
        if not low <= position <= high:
            raise UsageError(
                f"--start {start[0]:g} {start[1]:g}: {axis} {position:g} m is outside the fence of "
                f"{vehicle.name}; give {low:g} to {high:g}"
            )
    if options.truth is not None:
        artefacts.check_output(options.truth, options.force)
    return vehicle


@contextmanager
def _stop_on_signal() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether SIGINT or SIGTERM has arrived, the normal end of a server."""
    signals: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(signals)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
