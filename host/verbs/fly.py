"""`trimtab fly`: fly a reference, simulated or at a port, and log the flight."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import (
    DEFAULT_VEHICLE,
    AcceptUndecided,
    Force,
    Json,
    KeyFile,
    Output,
    VehicleName,
    WorkspaceFolder,
    accepted_model,
    key_option,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from trimtab.host.link.flight_request import FlightRequest
    from trimtab.host.link.host_control import FlownBy
    from trimtab.host.link.keys import StationKey
    from trimtab.host.link.summary import FlightResult
    from trimtab.host.route.clearance import Passed
    from trimtab.host.vehicle import Vehicle

CAMERA_DELAY_MS = 4.0
_LEFT_OUT_WITH_VALUE = ("-o", "--output", "--key")
_LEFT_OUT = ("--json", "--force", "--realtime")
"""Options that do not change the flight, and the key, which leaves no trace in a log."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FlyOptions:
    """Options of `trimtab fly`.

    Attributes
    ----------
    port
        Serial port of a real or served vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    mocap
        Address at which the camera system's poses arrive, udp://HOST:PORT. Goes with --port.
    mocap_delay_ms
        Minimum time from a camera's exposure to the arrival of its pose, as the manufacturer states it.
    world
        World to simulate, by name or path. Default: the empty world.
    plant
        Physics of your own instead of a world, path.py:Class.
    plant_options
        TOML file that the plant receives.
    seed
        Seed of the host. The log contains it.
    world_seed
        Seed of the simulated world. The log does not contain it.
    flight
        Index of the flight. Flights with the same seeds and another index share the world, but not the noise.
        Default: the first index whose log does not exist, or 0 with --output or --force.
    realtime
        Run the simulation at the speed of the wall clock.
    as_flashed
        Fly with parameters on board that differ from the vehicle file.
    parameter
        Parameter to set on board before the flight, NAME=VALUE, instead of the vehicle file's. May be
        repeated.
    feedforward
        Feed-forward to fly with, a .ff file.
    controller
        Controller that flies, by name or path of its file. One on the host streams its commands; one on board
        is set by parameters, which stay. Default: the law on board as the vehicle file has it.
    model
        Model file with the residual that the controller predicts with.
    then
        Reference to send in flight. It takes over at a point where it continues the first one.
    at
        Time at which it takes over, in seconds of the first reference. Default: the latest time possible.
    output
        Flight log to write. Default: NAME-FLIGHT.mcap, with the reference file's name.
    """

    vehicle: VehicleName = DEFAULT_VEHICLE
    port: str | None = None
    mocap: str | None = None
    mocap_delay_ms: float = CAMERA_DELAY_MS
    world: str | None = None
    plant: str | None = None
    plant_options: str | None = None
    seed: int = 0
    world_seed: int = 0
    flight: int | None = None
    realtime: Annotated[bool, Parameter(negative="")] = False
    as_flashed: Annotated[bool, Parameter(negative="")] = False
    parameter: Annotated[tuple[str, ...], Parameter(negative="")] = ()
    feedforward: Path | None = None
    controller: str | None = None
    model: Path | None = None
    accept_undecided: AcceptUndecided = False
    then: Path | None = None
    at: float | None = None
    key: KeyFile = None
    output: Output = None
    force: Force = False
    json: Json = False
    workspace: WorkspaceFolder = None


DEFAULTS = FlyOptions()


def command(reference: Path, *, options: FlyOptions = DEFAULTS) -> None:
    """Fly a reference and write its log.

    Without --port a simulated vehicle flies, in lock-step and as fast as the machine allows.

    Parameters
    ----------
    reference
        Reference to fly, a .ref file.
    """
    from trimtab.host.base.output import warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.link.drivers import Interrupts
    from trimtab.host.link.flight import ON_REQUEST
    from trimtab.host.link.fly import FlightEnded, FlightInterrupted, fly_port

    _check(options)
    flight = _flight_index(reference, options)
    request = _request(reference, options, flight)
    try:  # outside the progress bar, which holds stdout while it is shown
        with Progress(f"flying {reference.name}") as bar:

            def on_phase(phase: str) -> None:
                bar.advance(1.0, phase)
                if phase == ON_REQUEST:
                    warn("landing; Ctrl-C again leaves the vehicle to its failsafe")

            if options.port is not None and options.mocap is not None:
                result = fly_port(request, options.port, options.mocap, on_phase=on_phase)
            else:
                result = _fly_simulated(request, options, flight, on_phase)
    except (FlightEnded, FlightInterrupted) as ended:
        with Interrupts():  # a key that is held down must not suppress the answer
            _answer(ended.result, reference, options)
        raise
    _answer(result, reference, options)


def _answer(result: FlightResult, reference: Path, options: FlyOptions) -> None:
    """Print the result, with the flight's distance from the gates and keep-out shapes of its route."""
    from trimtab.host.base.output import emit, say

    passed = _passed(result, reference)
    lines = [
        f"{each.obstacle}: {abs(1e3 * each.distance_m):.0f} mm "
        f"{'clear' if each.distance_m >= 0.0 else 'MISSED'} at {each.t_s:.2f} s"
        for each in passed
    ]
    say(*result.to_lines(), *lines)
    emit({**result.to_json(), "clearance": [asdict(each) for each in passed]}, options.json)


def _passed(result: FlightResult, path: Path) -> list[Passed]:
    """Return how the flight passed the obstacles of its route, if the plan's file beside it names any."""
    from trimtab.host.log import read_flight, topics
    from trimtab.host.log.tracking import within
    from trimtab.host.plan.files import read_course
    from trimtab.host.route.clearance import flown_clearance, has_obstacles

    course = read_course(path, result.reference)
    if course is None or not has_obstacles(course[0]) or result.tracking_max_m is None:
        return []
    flight = read_flight(result.log, leave_out=[topics.FC_CONTROL])
    assert flight.mocap is not None  # else it has no tracking error
    assert flight.tracking is not None
    keep = within(flight.mocap.t_us, flight.tracking)
    t_s = 1e-6 * (flight.mocap.t_us[keep] - flight.tracking[0])
    return flown_clearance(*course, t_s, flight.mocap.p[keep])


def _check(options: FlyOptions) -> None:
    """Refuse values out of range and options that do not go together. Raises UsageError."""
    from trimtab.host.base.errors import UsageError

    simulates = options.world or options.plant or options.plant_options or options.realtime
    if (options.port is None) != (options.mocap is None):
        raise UsageError("give --port and --mocap together: poses reach the vehicle only through this host")
    if options.port is not None and (simulates or options.world_seed):
        raise UsageError("--port flies the vehicle at the port; leave out world, plant and --realtime")
    if min(options.seed, options.world_seed, options.flight or 0) < 0:
        raise UsageError("a seed or flight index is negative; give 0 or more")
    if not 0.0 <= options.mocap_delay_ms <= 1000.0:
        raise UsageError(f"--mocap-delay-ms {options.mocap_delay_ms:g} is out of range; give 0 to 1000")


def _flight_index(reference: Path, options: FlyOptions) -> int:
    """Return the index of the flight: as given, or the first one that has no log, not even a part of one."""
    from trimtab.host.log import partial_path

    if options.flight is not None:
        return options.flight
    if options.output is not None or options.force:
        return 0
    logs = ((index, _default_log(reference, index)) for index in count())
    return next(index for index, log in logs if not (log.exists() or partial_path(log).exists()))


def _default_log(reference: Path, flight: int) -> Path:
    return Path(f"{reference.stem}-{flight}.mcap")


def _request(reference: Path, options: FlyOptions, flight: int) -> FlightRequest:
    """Read the files that the options name. Raises UsageError."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.link.blob_files import model_of, read_feedforward, read_reference
    from trimtab.host.link.flight_request import FlightRequest
    from trimtab.host.link.swap import swap_time_us
    from trimtab.host.workspace import open_workspace

    vehicle = open_workspace(options.workspace).vehicle(options.vehicle)
    blob = read_reference(reference)
    feedforward = None if options.feedforward is None else read_feedforward(options.feedforward)
    following = None if options.then is None else read_reference(options.then)
    at = options.at
    if at is not None and following is None:
        raise UsageError("--at needs --then: it is the time at which that reference takes over")
    if at is not None and not math.isfinite(1e6 * at):
        raise UsageError(f"--at {at:g} is not a time; give seconds of the first reference")
    at_us = None if at is None else round(1e6 * at)
    swap_us = 0 if following is None else swap_time_us(blob, following, at_us)
    by = _flown_by(options, vehicle)
    log = options.output or _default_log(reference, flight)
    return FlightRequest(
        vehicle=vehicle,
        reference=blob,
        feedforward=feedforward,
        log_path=artefacts.check_log(log, options.force),
        port=options.port or "simulated vehicle",
        cameras=options.mocap or "the camera system",
        upload=options.port is None,
        as_flashed=options.as_flashed,
        parameters={**by.parameters, **_parameters(options.parameter)},
        model_id=model_of(reference),
        session={"seed": str(options.seed), "flight": str(flight), **_provenance(options, flight)},
        camera_delay_us=None if options.port is None else round(1000 * options.mocap_delay_ms),
        then=following,
        swap_us=swap_us,
        control=by.control,
        key=_key(options),
    )


def _key(options: FlyOptions) -> StationKey | None:
    """Return the key that --key names. A simulated flight holds the same key and reads no wall clock."""
    from trimtab.host.link.keys import read_key

    if options.key is not None and options.port is None:
        return read_key(options.key)
    return key_option(options.key)


def _flown_by(options: FlyOptions, vehicle: Vehicle) -> FlownBy:
    """Return what --controller and --model mean. Raises UsageError and what reading them raises."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.link.host_control import FlownBy

    if options.controller is None:
        if options.model is not None:
            raise UsageError("--model needs --controller: it is the model that the controller predicts with")
        return FlownBy()
    from trimtab.host.effects import load_effects
    from trimtab.host.link.controllers import flown_by
    from trimtab.host.workspace import open_workspace

    workspace = open_workspace(options.workspace)
    model = None
    if options.model is not None:
        model = accepted_model(options.model, options.accept_undecided, vehicle_id=vehicle.id)
    return flown_by(
        options.controller,
        workspace.controller(options.controller),
        vehicle,
        feedforward=options.feedforward is not None,
        model=model,
        effects=load_effects(workspace.root),
    )


def _parameters(assignments: tuple[str, ...]) -> dict[str, float]:
    """Return the values by name of NAME=VALUE texts. Raises UsageError for an unknown name or a bad value."""
    from trimtab.host.base.errors import UsageError
    from trimtab.protocol.parameters import BY_NAME

    values = {}
    for text in assignments:
        name, _, value = text.partition("=")
        if name not in BY_NAME:
            raise UsageError(f"--parameter {text}: there is no parameter {name}; give NAME=VALUE")
        if not value:
            raise UsageError(f"--parameter {text}: no value; give NAME=VALUE")
        try:
            number = float(value)
        except ValueError:
            raise UsageError(f"--parameter {text}: {value} is not a number; give NAME=VALUE") from None
        try:
            values[name] = BY_NAME[name].check(number)
        except ValueError as error:
            raise UsageError(f"--parameter {text}: {error}; give NAME=VALUE") from None
    return values


def _fly_simulated(
    request: FlightRequest, options: FlyOptions, flight: int, on_phase: Callable[[str], None]
) -> FlightResult:
    """Fly a simulated vehicle from below the reference's first node. Write its truth beside the log."""
    from contextlib import closing

    from trimtab.host.link.fly import fly_lockstep
    from trimtab.host.link.vehicle import vehicle_class

    first = request.reference.nodes_ned()[0].state
    simulated = vehicle_class().create(
        request.vehicle,
        world=options.world,
        world_seed=options.world_seed,
        flight=flight,
        plant=options.plant,
        plant_options=options.plant_options,
        start_ned=(first[0], first[1], 0.0),
        start_yaw=request.reference.yaw_nodes()[0].yaw,
        key=None if request.key is None else request.key.key,
    )
    before = _file_number(request.log_path)
    with closing(simulated):
        try:
            return fly_lockstep(request, simulated, realtime=options.realtime, on_phase=on_phase)
        finally:
            if _file_number(request.log_path) not in (None, before):
                _write_truth(request.log_path, simulated.truth())


def _file_number(path: Path) -> int | None:
    """Return the inode of the file at `path`, or None if there is no file."""
    return path.stat().st_ino if path.exists() else None


def _write_truth(log: Path, truth: dict[str, object]) -> None:
    """Write the sealed truth beside the log, with the log's id. Only checks open it."""
    import json

    from trimtab.host.base.artefacts import content_id, write_atomic

    record = {**truth, "log": content_id(log.read_bytes())}
    text = json.dumps(record, indent=2, sort_keys=True) + "\n"
    write_atomic(log.with_name(log.name + ".truth.json"), text, force=True)


def _provenance(options: FlyOptions, flight: int) -> dict[str, str]:
    """Return version, git state and command. The command names the index of the flight even by default."""
    import sys

    from trimtab.host.base import artefacts

    arguments = artefacts.without_options(sys.argv[1:], _LEFT_OUT_WITH_VALUE, _LEFT_OUT)
    if options.flight is None:
        arguments += ["--flight", str(flight)]
    provenance = {"version": artefacts.version(), "command": artefacts.public_command(arguments)}
    git = artefacts.git_state()
    return provenance | {"git": git} if git is not None else provenance
