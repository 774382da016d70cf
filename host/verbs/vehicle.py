"""`trimtab vehicle`: write a vehicle file from a few facts, and check one against a flight log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from trimtab.host.verbs.options import Force, Json, Output, Trust, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.vehicle.typical import Facts

command = App(name="vehicle", help="Write a vehicle file from a few facts, or check one against a flight.")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class NewOptions:
    """Options of `trimtab vehicle new`.

    Attributes
    ----------
    mass_kg
        Take-off mass with battery, kg, weighed.
    propeller
        Diameter and pitch in inches, such as 5x4.3, or only the diameter: 5, or 127mm.
    thrust_max_n
        Greatest thrust of one rotor, N, as the data sheet of motor and propeller states it.
    arm_m
        Distance from the centre to a rotor, m. A PX4 parameter file states it; this option then scales it.
    kv
        Speed constant of the motors, rpm/V.
    cells
        Cells of the battery in series.
    parameters
        Parameter file of PX4 or ArduPilot: rotor order, positions, spins, thrust curve, hover thrust.
    output
        Vehicle file to write. Default: vehicles/NAME.toml in the workspace.
    """

    mass_kg: float
    propeller: str
    thrust_max_n: float | None = None
    arm_m: float | None = None
    kv: float | None = None
    cells: int | None = None
    parameters: Path | None = None
    output: Output = None
    workspace: WorkspaceFolder = None
    json: Json = False
    force: Force = False


@command.command
def new(name: str, *, options: NewOptions) -> None:
    """Write a vehicle file from the facts that you know, with typical values for the rest.

    Parameters
    ----------
    name
        Name of the vehicle: letters, digits, - and _.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.vehicle import parse_vehicle
    from trimtab.host.vehicle.model import check_name
    from trimtab.host.vehicle.typical import typical_file
    from trimtab.host.workspace import open_workspace

    try:
        check_name(name)
    except ValueError as error:
        raise UsageError(str(error)) from None
    facts, notes = _facts(options)
    text = typical_file(name, facts)
    vehicle = parse_vehicle(text, name)
    target = options.output
    if target is None:
        target = open_workspace(options.workspace).root / "vehicles" / f"{name}.toml"
        target.parent.mkdir(exist_ok=True)
    if target.suffix != ".toml":
        from trimtab.host.base.errors import UsageError

        raise UsageError(f"{target}: a vehicle file's name ends in .toml")
    artefacts.write_atomic(target, text, options.force)
    say(f"{target}: {vehicle.name}, {vehicle.mass_kg:g} kg, id {vehicle.id}", *notes)
    guesses = [line.split(" ")[0] for line in text.splitlines() if " # guess" in line and "=" in line]
    emit(
        {"file": str(target), "vehicle": vehicle.name, "id": vehicle.id, "guessed": guesses, "notes": notes},
        options.json,
    )


def _facts(options: NewOptions) -> tuple[Facts, list[str]]:
    """Return the facts in the options and in the parameter file, and notes. Raises UsageError."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.vehicle.dumps import read_dump
    from trimtab.host.vehicle.typical import Facts, arm_length, check_range, parse_propeller, square_rotors

    propeller = parse_propeller(options.propeller)
    for key in ("mass_kg", "arm_m", "kv", "cells", "thrust_max_n"):
        option = f"--{key.replace('_', '-')}"
        value = getattr(options, key)
        if value is not None:
            check_range(key, value, option)
    dump = None if options.parameters is None else read_dump(options.parameters)
    arm_m = options.arm_m
    if arm_m is None and (dump is None or not dump.has_size):
        raise UsageError("give --arm-m, the distance from the centre to a rotor, m")
    known = {"mass_kg": options.mass_kg, "propeller": propeller}
    known |= {"kv_rpm_v": options.kv, "cells": options.cells, "thrust_max_n": options.thrust_max_n}
    if dump is None:
        assert arm_m is not None
        return Facts(**known, rotors=square_rotors(arm_m)), []
    rotors = dump.rotors if arm_m is None else dump.with_arm(arm_m)
    check_range("arm_m", arm_length(rotors), f"{options.parameters}: arms, or --arm-m, of")
    notes = [f"{dump.autopilot}: {dump.frame}"]
    if dump.pwm_us is not None:
        low, high = dump.pwm_us
        notes.append(f"motor commands 0 and 1 are pulses of {low:g} and {high:g} us")
    sources = [f"From {options.parameters.name if options.parameters else ''}: {note}." for note in notes]
    facts = Facts(
        **known,
        rotors=rotors,
        hover_share=dump.hover_share,
        thrust_curve=dump.thrust_curve,
        sources=sources,
    )
    return facts, notes


@command.command
def check(
    log: Path,
    *,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    workspace: WorkspaceFolder = None,
    trust: Trust = False,
    json: Json = False,
) -> None:
    """Check whether a vehicle file fits a flight log. The exit code is 1 if it does not.

    Parameters
    ----------
    log
        Flight log, flown or imported.
    vehicle
        Vehicle file, by name or path. Default: the one in the log.
    """
    from trimtab.host.base.errors import GateMissed
    from trimtab.host.base.output import emit, say
    from trimtab.host.log import read_flight
    from trimtab.host.vehicle.check import to_lines
    from trimtab.host.vehicle.log_check import check_flight
    from trimtab.host.workspace import open_workspace

    chosen = None if vehicle is None else open_workspace(workspace, trusted=trust).vehicle(vehicle)
    flight = read_flight(log)
    result = check_flight(flight, chosen)
    name = (chosen or flight.vehicle).name
    say(*to_lines(result))
    if declared := flight.metadata.get("unknown", ""):
        say(f"unknown: not judged, since the log leaves open {declared.replace(' ', ', ')}")
    answer = {
        "log": str(log),
        "vehicle": name,
        "fits": result.fits,
        "differing": result.differing,
        "figures": [figure.to_json() for figure in result.figures],
        **result.assignment.to_json(),
    }
    emit(answer, json)
    if not result.fits:
        raise GateMissed(
            f"{name} does not fit {log}: {', '.join(result.differing)}; correct the vehicle file"
        )
