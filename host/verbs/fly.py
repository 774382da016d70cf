"""`trimtab fly`: fly a reference, simulated or at a port, and log the flight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from trimtab.host.api.fly import CAMERA_DELAY_MS, fly
from trimtab.host.verbs.options import (
    AcceptUndecided,
    Force,
    Json,
    KeyFile,
    Output,
    Trust,
    VehicleName,
    WorkspaceFolder,
)
from trimtab.host.workspace import DEFAULT_VEHICLE, open_workspace

if TYPE_CHECKING:
    from trimtab.host.link.summary import FlightResult


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
        Physics of your own, path.py:Class. With `world`, it acts out that world.
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
    autopilot
        px4 or ardupilot: stream setpoints to that autopilot instead of an upload. Without --port, a simulated
        vehicle stands in for it.
    yes
        Arm another autopilot at a port without asking: you state that the room is clear.
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
    autopilot: Literal["px4", "ardupilot"] | None = None
    yes: Annotated[bool, Parameter(negative="")] = False
    key: KeyFile = None
    output: Output = None
    force: Force = False
    json: Json = False
    workspace: WorkspaceFolder = None
    trust: Trust = False


DEFAULTS = FlyOptions()


def command(reference: Path, *, options: FlyOptions = DEFAULTS) -> None:
    """Fly a reference and write its log.

    Without --port a simulated vehicle flies, in lock-step and as fast as the machine allows.

    Parameters
    ----------
    reference
        Reference to fly, a .ref file.
    """
    import sys

    from trimtab.host.base.output import warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.link.drivers import Interrupts
    from trimtab.host.link.flight import ON_REQUEST
    from trimtab.host.link.fly import FlightEnded, FlightInterrupted
    from trimtab.host.verbs.confirm import ask_at_terminal

    parameters = _parameters(options.parameter)
    asks = options.autopilot is not None and options.port is not None
    ask = ask_at_terminal if asks and sys.stdin is not None and sys.stdin.isatty() else None
    try:  # outside the progress bar, which holds stdout while it is shown
        with Progress(f"flying {reference.name}", enabled=False if asks else None) as bar:

            def on_phase(phase: str) -> None:
                bar.advance(1.0, phase)
                if asks:  # line by line: a person is asked in between
                    warn(phase)
                elif phase == ON_REQUEST:
                    warn("landing; Ctrl-C again leaves the vehicle to its failsafe")

            result = fly(
                reference,
                vehicle=options.vehicle,
                world=options.world,
                seed=options.seed,
                world_seed=options.world_seed,
                flight=options.flight,
                log=options.output,
                force=options.force,
                port=options.port,
                mocap=options.mocap,
                mocap_delay_ms=options.mocap_delay_ms,
                plant=options.plant,
                plant_options=options.plant_options,
                realtime=options.realtime,
                as_flashed=options.as_flashed,
                parameters=parameters,
                feedforward=options.feedforward,
                controller=options.controller,
                model=options.model,
                accept_undecided=options.accept_undecided,
                then=options.then,
                at_s=options.at,
                key=options.key,
                autopilot=options.autopilot,
                ask=ask,
                confirmed=options.yes,
                workspace=open_workspace(options.workspace, trusted=options.trust),
                command=sys.argv[1:],
                on_phase=on_phase,
                on_late=warn,
            )
    except (FlightEnded, FlightInterrupted) as ended:
        with Interrupts():  # a key that is held down must not suppress the answer
            _answer(ended.result, options.json)
        raise
    _answer(result, options.json)


def _answer(result: FlightResult, as_json: bool) -> None:
    """Print the result."""
    from trimtab.host.base.output import emit, say

    say(*result.to_lines())
    emit(result.to_dict(), as_json)


def _parameters(assignments: tuple[str, ...]) -> dict[str, float]:
    """Return the values by name of NAME=VALUE texts. Raises UsageError for one without a number."""
    from trimtab.host.base.errors import UsageError

    values = {}
    for text in assignments:
        name, _, value = text.partition("=")
        if not value:
            raise UsageError(f"--parameter {text}: no value; give NAME=VALUE")
        try:
            values[name] = float(value)
        except ValueError:
            raise UsageError(f"--parameter {text}: {value} is not a number; give NAME=VALUE") from None
    return values
