"""Fly a reference, simulated or at a port, and log the flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from trimtab.host.api.load import vehicle_of
from trimtab.host.base.errors import UsageError
from trimtab.host.workspace import DEFAULT_VEHICLE, Workspace, open_workspace

if TYPE_CHECKING:
    from trimtab.host.base.parts import PartFile
    from trimtab.host.link.flight_request import Ask
    from trimtab.host.link.host_control import FlownBy
    from trimtab.host.link.keys import StationKey
    from trimtab.host.link.simulated import Simulation
    from trimtab.host.link.summary import FlightResult
    from trimtab.host.models.model import Model
    from trimtab.host.vehicle import Vehicle
    from trimtab.protocol.blobs import Reference

CAMERA_DELAY_MS = 4.0
_LEFT_OUT_WITH_VALUE = ("-o", "--output", "--key")
_LEFT_OUT = ("--json", "--force", "--realtime")
"""Options that do not change the flight, and the key, which leaves no trace in a log."""


def fly(  # noqa: PLR0913 (one keyword for each choice)
    reference: str | Path,
    *,
    vehicle: Vehicle | str | Path = DEFAULT_VEHICLE,
    world: str | Path | None = None,
    seed: int = 0,
    world_seed: int = 0,
    flight: int | None = None,
    log: str | Path | None = None,
    force: bool = False,
    port: str | None = None,
    mocap: str | None = None,
    mocap_delay_ms: float = CAMERA_DELAY_MS,
    plant: str | None = None,
    plant_options: str | Path | None = None,
    realtime: bool = False,
    as_flashed: bool = False,
    parameters: Mapping[str, float] = MappingProxyType({}),
    feedforward: str | Path | None = None,
    controller: str | None = None,
    model: Model | str | Path | None = None,
    accept_undecided: bool = False,
    then: str | Path | None = None,
    at_s: float | None = None,
    key: str | Path | None = None,
    autopilot: str | None = None,
    ask: Ask | None = None,
    confirmed: bool = False,
    workspace: str | Path | Workspace | None = None,
    command: Sequence[str] | None = None,
    on_phase: Callable[[str], None] = lambda _: None,
    on_late: Callable[[str], None] = lambda _: None,
) -> FlightResult:
    """Fly a reference and write its log, as `trimtab fly` does.

    Without a port a simulated vehicle flies, in lock-step and as fast as the machine allows. What its world
    really held is written to `<log>.truth.json`; neither the result nor the log holds any of it.

    Parameters
    ----------
    reference
        File of the reference, .ref.
    vehicle
        Vehicle, or the name or path of its file.
    world
        World to simulate, by name or path. Default: the empty world.
    seed
        Seed of the host. The log contains it.
    world_seed
        Seed of the simulated world. The log does not contain it.
    flight
        Index of the flight. Flights with the same seeds and another index share the world, but not the noise.
        Default: the first index whose log does not exist, or 0 with `log` or `force`.
    log
        Flight log to write. Default: NAME-FLIGHT.mcap in the current folder, with the reference file's name.
    force
        Overwrite the log.
    port
        Serial port of a real or served vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    mocap
        Address at which the camera system's poses arrive, udp://HOST:PORT. Goes with `port`.
    mocap_delay_ms
        Minimum time from a camera's exposure to the arrival of its pose, ms.
    plant
        Physics of your own, path.py:Class. With `world`, it acts out that world.
    plant_options
        TOML file that the plant receives.
    realtime
        Run the simulation at the speed of the wall clock.
    as_flashed
        Fly with parameters on board that differ from the vehicle file.
    parameters
        Values to set on board before the flight, by parameter name, instead of the vehicle file's.
    feedforward
        Feed-forward to fly with, a .ff file.
    controller
        Controller that flies, by name or path of its file. Default: the law on board.
    model
        Model, or its file, with the residual that the controller predicts with.
    accept_undecided
        Also use a model whose verdict is undecided.
    then
        File of the reference that takes over in flight.
    at_s
        Time at which it takes over, s of the first reference. Default: the latest time possible.
    key
        Key file, if the vehicle has a key.
    autopilot
        "px4" or "ardupilot": stream setpoints to that autopilot instead of an upload. Without a port, a
        simulated vehicle stands in for it.
    ask
        Shows lines to a person before another autopilot at a port is armed. Returns a function that returns
        the answer, None before there is one.
    confirmed
        Arm without asking: you state that the room is clear.
    workspace
        Folder with vehicles, effects and controllers of yours. Default: the current folder.
    command
        Words of the command line, recorded in the log. Default: those of the equivalent `trimtab fly`.
    on_phase
        Called with the name of each phase of the flight as it begins.
    on_late
        Called with a line when real time cannot be kept: as it begins, while it lasts, and when it is over.

    Returns
    -------
    FlightResult
        Tracking error in m, saturation, link quality, and how the flight ended. `log` is the path to read.

    Raises
    ------
    UsageError, ConfigurationError
        If a file cannot be used or options do not go together. Nothing is written.
    FlightEnded
        If the flight ended before its reference did. `result` holds what was measured; the log is kept.
    LinkError
        If there is no vehicle at the port, or if it does not answer.
    Refused
        If the vehicle refuses the reference or to arm.
    """
    from trimtab.host.autopilot.kinds import autopilot_kind
    from trimtab.host.link.blob_files import model_of, read_feedforward, read_reference
    from trimtab.host.link.drivers import Interrupts
    from trimtab.host.link.flight_request import FlightRequest
    from trimtab.host.link.fly import FlightEnded, FlightInterrupted, fly_port
    from trimtab.host.link.simulated import Simulation, fly_simulated

    path = Path(reference)
    space = open_workspace(workspace)
    simulation = Simulation(
        world=world,
        world_seed=world_seed,
        plant=plant,
        plant_options=plant_options,
        plant_trusted=space.trusted,
        realtime=realtime,
    )
    _check(simulation, port, mocap, mocap_delay_ms, min(seed, world_seed, flight or 0))
    kind = None if autopilot is None else autopilot_kind(autopilot)
    if kind is not None:
        given = {
            "--as-flashed": as_flashed,
            "--parameter": parameters,
            "--feedforward": feedforward,
            "--controller": controller,
            "--model": model,
            "--then": then,
            "--key": key,
        }
        _check_autopilot(given, asks=port is None or confirmed or ask is not None)
    airframe = vehicle_of(vehicle, space)
    blob = read_reference(path)
    forward = None if feedforward is None else read_feedforward(feedforward)
    following = None if then is None else read_reference(then)
    by = _flown_by(controller, model, accept_undecided, airframe, space, forward is not None)
    words = command or _equivalent_command(
        path,
        vehicle=airframe.name,
        port=port,
        mocap=mocap,
        mocap_delay_ms=f"{mocap_delay_ms:g}",
        seed=seed,
        as_flashed=as_flashed,
        parameter=[f"{name}={value:g}" for name, value in parameters.items()],
        feedforward=feedforward,
        controller=controller,
        model=model if isinstance(model, str | Path | None) else f"{model.id}.model.toml",
        accept_undecided=accept_undecided,
        then=then,
        at=at_s,
        autopilot=autopilot,
        yes=confirmed,
    )
    swap_us, station = _swap_us(blob, following, at_s), _key(key, port)
    part, index = _reserved(path, flight, log, force)
    if flight is None or command is None:
        words = [*words, "--flight", str(index)]
    with closing(part):
        request = FlightRequest(
            vehicle=airframe,
            reference=blob,
            feedforward=forward,
            log_path=part.target,
            log_part=part,
            port=port or "simulated vehicle",
            cameras=mocap or "the camera system",
            upload=port is None,
            as_flashed=as_flashed,
            parameters={**by.parameters, **_checked(parameters)},
            model_id=model_of(path),
            session={"seed": str(seed), "flight": str(index), **_provenance(words)},
            camera_delay_us=None if port is None else round(1000 * mocap_delay_ms),
            then=following,
            swap_us=swap_us,
            control=by.control,
            key=station,
            autopilot=kind,
            ask=None if port is None or confirmed else ask,
        )
        try:
            if port is not None and mocap is not None:
                result = fly_port(request, port, mocap, on_phase=on_phase, on_late=on_late)
            else:
                result = fly_simulated(request, simulation, index, on_phase, on_late)
        except (FlightEnded, FlightInterrupted) as ended:
            with Interrupts():  # a key that is held down must not suppress the result
                ended.result = _with_clearance(ended.result, path)
            raise
    return _with_clearance(result, path)


def _check(simulation: Simulation, port: str | None, mocap: str | None, delay_ms: float, least: int) -> None:
    """Refuse values out of range and options that do not go together. Raises UsageError.

    least: the least of the seeds and the index of the flight.
    """
    if (port is None) != (mocap is None):
        raise UsageError("give --port and --mocap together: poses reach the vehicle only through this host")
    if port is not None and not simulation.is_default:
        raise UsageError("--port flies the vehicle at the port; leave out world, plant and --realtime")
    if least < 0:
        raise UsageError("a seed or flight index is negative; give 0 or more")
    if not 0.0 <= delay_ms <= 1000.0:
        raise UsageError(f"--mocap-delay-ms {delay_ms:g} is out of range; give 0 to 1000")


def _check_autopilot(given: Mapping[str, object], *, asks: bool) -> None:
    """Refuse options that another autopilot cannot follow. Raises UsageError.

    asks: whether somebody confirms, or need not.
    """
    useless = ", ".join(option for option, value in given.items() if value)
    if useless:
        raise UsageError(f"--autopilot flies by the autopilot's own law; leave out {useless}")
    if not asks:
        raise UsageError("nobody is asked before the vehicle is armed; run it in a terminal, or add --yes")


def _reserved(
    reference: Path, flight: int | None, log: str | Path | None, force: bool
) -> tuple[PartFile, int]:
    """Return the file of the log, which no other process writes, and the index of the flight.

    Without an index, it is the first one that has no log, not even a part of one; it is 0 if the log has a
    name of its own or may be overwritten. Raises UsageError.
    """
    from trimtab.host.base.artefacts import reserve_log
    from trimtab.host.base.parts import NameTaken

    if flight is not None or log is not None or force:
        index = flight or 0
        return reserve_log(log or _default_log(reference, index), force), index
    for index in count():
        with suppress(NameTaken):
            return reserve_log(_default_log(reference, index)), index
    raise AssertionError("there is no last index")


def _default_log(reference: Path, flight: int) -> Path:
    return Path(f"{reference.stem}-{flight}.mcap")


def _swap_us(first: Reference, then: Reference | None, at_s: float | None) -> int:
    """Return when `then` takes over, us of the first reference; 0 without it. Raises UsageError."""
    from trimtab.host.link.swap import swap_time_us

    if then is None:
        if at_s is not None:
            raise UsageError("--at needs --then: it is the time at which that reference takes over")
        return 0
    if at_s is not None and not math.isfinite(1e6 * at_s):
        raise UsageError(f"--at {at_s:g} is not a time; give seconds of the first reference")
    return swap_time_us(first, then, None if at_s is None else round(1e6 * at_s))


def _key(path: str | Path | None, port: str | None) -> StationKey | None:
    """Return the key in a file. A simulated flight holds the same key and reads no wall clock."""
    if path is None:
        return None
    from trimtab.host.link.drivers import wall_timestamp
    from trimtab.host.link.keys import read_key, use_key

    return read_key(Path(path)) if port is None else use_key(Path(path), wall_timestamp())


def _flown_by(
    controller: str | None,
    model: Model | str | Path | None,
    accept_undecided: bool,
    vehicle: Vehicle,
    space: Workspace,
    has_feedforward: bool,
) -> FlownBy:
    """Return what controller and model mean. Raises UsageError and what reading them raises."""
    from trimtab.host.link.host_control import FlownBy

    if controller is None:
        if model is not None:
            raise UsageError("--model needs --controller: it is the model that the controller predicts with")
        return FlownBy()
    from trimtab.host.link.controllers import flown_by
    from trimtab.host.models.accepted import accepted_model

    accepted = None
    if model is not None:
        accepted = accepted_model(model, accept_undecided, vehicle_id=vehicle.id)
    return flown_by(
        controller,
        space.controller(controller),
        vehicle,
        feedforward=has_feedforward,
        model=accepted,
        effects=space.effects(),
    )


def _checked(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the values by name. Raises UsageError for an unknown name or a value out of range."""
    from trimtab.protocol.parameters import BY_NAME

    values = {}
    for name, value in parameters.items():
        if name not in BY_NAME:
            raise UsageError(f"--parameter {name}={value:g}: there is no parameter {name}; give NAME=VALUE")
        try:
            values[name] = BY_NAME[name].check(value)
        except ValueError as error:
            raise UsageError(f"--parameter {name}={value:g}: {error}; give NAME=VALUE") from None
    return values


def _equivalent_command(reference: Path, **options: object) -> list[str]:
    """Return the words of the `trimtab fly` that flies alike. None, False, 0 and defaults are left out."""
    defaults = {"vehicle": DEFAULT_VEHICLE, "mocap_delay_ms": f"{CAMERA_DELAY_MS:g}"}
    words = ["fly", str(reference)]
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        if value is True:
            words.append(option)
        elif isinstance(value, list):
            words += [word for each in value for word in (option, each)]
        elif value and value != defaults.get(name):
            words += [option, str(value)]
    return words


def _provenance(words: Sequence[str]) -> dict[str, str]:
    """Return program and command for the log."""
    from trimtab.host.base import artefacts

    words = artefacts.without_options(words, _LEFT_OUT_WITH_VALUE, _LEFT_OUT)
    return artefacts.log_provenance(words)


def _with_clearance(result: FlightResult, path: Path) -> FlightResult:
    """Return the result with the flight's distance from its route's obstacles.

    It stays empty if the plan's file beside the reference in `path` is missing or names none.
    """
    from trimtab.host.log import read_flight, topics
    from trimtab.host.log.tracking import within
    from trimtab.host.plan.files import read_course
    from trimtab.host.route.clearance import flown_clearance, has_obstacles

    course = read_course(path, result.reference)
    if course is None or not has_obstacles(course[0]) or result.tracking_max_m is None:
        return result
    flight = read_flight(result.log, leave_out=[topics.FC_CONTROL])
    assert flight.mocap is not None  # else it has no tracking error
    assert flight.tracking is not None
    keep = within(flight.mocap.t_us, flight.tracking)
    t_s = 1e-6 * (flight.mocap.t_us[keep] - flight.tracking[0])
    passed = flown_clearance(*course, t_s, flight.mocap.p[keep])
    return replace(result, clearance=tuple(passed))
