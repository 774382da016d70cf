"""`trimtab fly`: a simulated vehicle, or one at a port, flies a reference; the flight is logged."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import DEFAULT_VEHICLE, Force, Json, Output, VehicleName, WorkspaceFolder

if TYPE_CHECKING:
    from collections.abc import Callable

    from trimtab.host.link.flight import FlightOrder
    from trimtab.host.link.summary import FlightResult

CAMERA_DELAY_MS = 4.0
_LEFT_OUT_WITH_VALUE = ("-o", "--output", "--port", "--mocap", "--workspace")
_LEFT_OUT = ("--json", "--force", "--realtime")


def command(
    reference: Path,
    *,
    vehicle: VehicleName = DEFAULT_VEHICLE,
    port: str | None = None,
    mocap: str | None = None,
    mocap_delay_ms: float = CAMERA_DELAY_MS,
    world: str | None = None,
    plant: str | None = None,
    plant_options: str | None = None,
    seed: int = 0,
    world_seed: int = 0,
    flight: int = 0,
    realtime: Annotated[bool, Parameter(negative="")] = False,
    as_flashed: Annotated[bool, Parameter(negative="")] = False,
    parameter: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    feedforward: Path | None = None,
    then: Path | None = None,
    at: float | None = None,
    output: Output = None,
    force: Force = False,
    json: Json = False,
    workspace: WorkspaceFolder = None,
) -> None:
    """Fly a reference and write its log.

    Without --port a simulated vehicle flies, in lock-step and as fast as the machine allows.

    Parameters
    ----------
    reference
        Reference to fly, a .ref file.
    port
        Serial port of a real or served vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    mocap
        Where the camera system's poses arrive, udp://HOST:PORT; goes with --port.
    mocap_delay_ms
        Least time from a camera's exposure to the arrival of its pose, as the maker states it.
    world
        World to simulate, by name or path; the empty one by default.
    plant
        Somebody else's physics in place of a world, path.py:Class.
    plant_options
        TOML file that is handed to the plant.
    seed
        Seed of the host; the log holds it.
    world_seed
        Seed of the simulated world; the log does not hold it.
    flight
        Index of the flight: flights that differ in it alone share the world and nothing else.
    realtime
        Keep the simulation to the wall clock.
    as_flashed
        Fly with parameters on board that differ from the vehicle file.
    parameter
        Parameter to set on board before the flight, NAME=VALUE, over the vehicle file's; may be repeated.
    feedforward
        Feed-forward to fly with, a .ff file.
    then
        Reference to send in flight; it takes over where it goes on with the first.
    at
        When it takes over, in seconds of the first; the latest time possible by default.
    output
        Flight log to write; NAME-FLIGHT.mcap by default, with the reference file's name.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say, warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.link.blob_files import model_of, read_feedforward, read_reference
    from trimtab.host.link.drivers import Interrupts
    from trimtab.host.link.flight import ON_REQUEST, FlightOrder
    from trimtab.host.link.fly import FlightEnded, FlightInterrupted
    from trimtab.host.link.swap import swap_time_us
    from trimtab.host.workspace import open_workspace

    if (port is None) != (mocap is None):
        raise UsageError("--port and --mocap go together: poses reach the vehicle through this host only")
    if port is not None and (world or plant or plant_options or realtime or world_seed):
        raise UsageError("--port flies what is there; leave out world, plant and --realtime")
    if min(seed, world_seed, flight) < 0:
        raise UsageError("seeds and flight indices are not negative")
    if not 0.0 <= mocap_delay_ms <= 1000.0:
        raise UsageError(f"--mocap-delay-ms {mocap_delay_ms:g} is no delay, give 0 to 1000")
    airframe = open_workspace(workspace).vehicle(vehicle)
    blob = read_reference(reference)
    addition = None if feedforward is None else read_feedforward(feedforward)
    following = None if then is None else read_reference(then)
    if at is not None and following is None:
        raise UsageError("--at goes with --then: it says when that reference takes over")
    if at is not None and not math.isfinite(1e6 * at):
        raise UsageError(f"--at {at:g} is no time, give seconds of the first reference")
    at_us = None if at is None else round(1e6 * at)
    swap_us = 0 if following is None else swap_time_us(blob, following, at_us)
    log = artefacts.check_log(output or Path(f"{reference.stem}-{flight}.mcap"), force)
    order = FlightOrder(
        vehicle=airframe,
        reference=blob,
        feedforward=addition,
        log_path=log,
        port=port or "simulated vehicle",
        cameras=mocap or "the camera system",
        upload=port is None,
        as_flashed=as_flashed,
        parameters=_parameters(parameter),
        model_id=model_of(reference),
        session={"seed": str(seed), "flight": str(flight), **_provenance()},
        camera_delay_us=None if port is None else round(1000 * mocap_delay_ms),
        then=following,
        swap_us=swap_us,
    )
    try:  # around the bar, which takes stdout for its own while it is shown
        with Progress(f"flying {reference.name}") as bar:

            def on_phase(phase: str) -> None:
                bar.advance(1.0, phase)
                if phase == ON_REQUEST:
                    warn("landing; Ctrl-C again leaves the vehicle to its failsafe")

            if port is not None and mocap is not None:
                from trimtab.host.link.fly import fly_port

                result = fly_port(order, port, mocap, on_phase=on_phase)
            else:
                world_options = (world, world_seed, flight, plant, plant_options)
                result = _fly_simulated(order, world_options, realtime, on_phase)
    except (FlightEnded, FlightInterrupted) as ended:
        with Interrupts():  # a key that is held down takes no answer away
            say(*ended.result.to_lines())
            emit(ended.result.to_json(), json)
        raise
    say(*result.to_lines())
    emit(result.to_json(), json)


def _parameters(assignments: tuple[str, ...]) -> dict[str, float]:
    """Value by name of NAME=VALUE texts. Raises UsageError where one is not in the table or not allowed."""
    from trimtab.host.base.errors import UsageError
    from trimtab.protocol.parameters import BY_NAME

    values = {}
    for text in assignments:
        name, _, value = text.partition("=")
        if name not in BY_NAME:
            raise UsageError(f"--parameter {text}: no parameter is called {name}, give NAME=VALUE")
        if not value:
            raise UsageError(f"--parameter {text}: no value, give NAME=VALUE")
        try:
            number = float(value)
        except ValueError:
            raise UsageError(f"--parameter {text}: {value} is no number, give NAME=VALUE") from None
        try:
            values[name] = BY_NAME[name].check(number)
        except ValueError as error:
            raise UsageError(f"--parameter {text}: {error}; give NAME=VALUE") from None
    return values


def _fly_simulated(
    order: FlightOrder,
    world_options: tuple[str | None, int, int, str | None, str | None],
    realtime: bool,
    on_phase: Callable[[str], None],
) -> FlightResult:
    """Return the flight with a simulated vehicle below the reference's first node; its truth goes beside the
    log.
    """
    from contextlib import closing

    from trimtab.host.link.fly import fly_lockstep
    from trimtab.host.link.vehicle import vehicle_class

    world, world_seed, flight, plant, plant_options = world_options
    first = order.reference.nodes_ned()[0].state
    simulated = vehicle_class().create(
        order.vehicle,
        world=world,
        world_seed=world_seed,
        flight=flight,
        plant=plant,
        plant_options=plant_options,
        start_ned=(first[0], first[1], 0.0),
        start_yaw=order.reference.yaw_nodes()[0].yaw,
    )
    before = _file_number(order.log_path)
    with closing(simulated):
        try:
            return fly_lockstep(order, simulated, realtime=realtime, on_phase=on_phase)
        finally:
            if _file_number(order.log_path) not in (None, before):
                _write_truth(order.log_path, simulated.truth())


def _file_number(path: Path) -> int | None:
    """Return what tells the file at `path` from one that replaces it while it is there; None for no file."""
    return path.stat().st_ino if path.exists() else None


def _write_truth(log: Path, truth: dict[str, object]) -> None:
    """Write the sealed truth beside the log, tied to it by its id. Only checks open it."""
    import json

    from trimtab.host.base.artefacts import content_id, write_atomic

    record = {**truth, "log": content_id(log.read_bytes())}
    text = json.dumps(record, indent=2, sort_keys=True) + "\n"
    write_atomic(log.with_name(log.name + ".truth.json"), text, force=True)


def _provenance() -> dict[str, str]:
    """Version, git state and command, without what two runs of the same flight may differ in."""
    import sys

    from trimtab.host.base import artefacts

    kept = artefacts.without_options(sys.argv[1:], _LEFT_OUT_WITH_VALUE, _LEFT_OUT)
    told = {"version": artefacts.version(), "command": artefacts.public_command(kept)}
    git = artefacts.git_state()
    return told | {"git": git} if git is not None else told
