"""Whether an imported flight and the vehicle file contradict each other."""

from __future__ import annotations

from collections.abc import Sequence

from trimtab.host.base.errors import UsageError
from trimtab.host.imports.recording import ImportFormatError
from trimtab.host.log import Flight
from trimtab.host.vehicle.check import Check, Verdict
from trimtab.host.vehicle.log_check import check_flight

REFUSED = ("order", "spins")
"""What tracing cannot recover from: it would name effects for a wrong column."""

REMEDIES = {
    "thrust": "check the mass, the unit of the commands and their zero and full values",
    "thrust-slope": "check the zero and full values of the commands",
    "force-x": "check the body axes and the mounting of the sensor",
    "force-y": "check the body axes and the mounting of the sensor",
    "torque-roll": "check inertia and arm",
    "torque-pitch": "check inertia and arm",
    "torque-yaw": "check inertia and the torque of the rotors",
}


def check_fit(flight: Flight, source: str) -> list[str]:
    """Return a line for each figure of the flight that differs from the vehicle file.

    Raises ImportFormatError if the motors are in another order or turn the other way. A flight too short or
    too gentle to tell gives no line.
    """
    try:
        found = check_flight(flight)
    except UsageError:
        return []
    wrong = [name for name in REFUSED if name in found.differing]
    if wrong:
        told = found.assignment.to_json()
        raise ImportFormatError(f"{source}: {_motors(wrong, told['order'], told['spins'])}")
    return [_line(found, name, flight) for name in found.differing if name in REMEDIES]


def _motors(wrong: Sequence[str], order: Sequence[int] | None, spins: Sequence[str] | None) -> str:
    """Return which motor columns turn the vehicle as it turned."""
    if "order" in wrong and order is not None:
        columns = ", ".join(str(k) for k in order)
        return (
            f"the motor columns are in another order: rotors 1 to 4 of the vehicle file are columns {columns}"
            "; name them in that order"
        )
    assert spins is not None
    return (
        f"the rotors spin {', '.join(spins)}, not as the vehicle file says; correct its spins or the columns"
    )


def _line(found: Check, name: str, flight: Flight) -> str:
    """Return a figure that differs, its range and the remedy."""
    figure = next(f for f in found.figures if f.name == name and f.verdict is Verdict.DIFFERS)
    return (
        f"{name} is {figure.value:.3g}, but {flight.vehicle.name} expects {figure.low:.3g} to "
        f"{figure.high:.3g}: {REMEDIES[name]}"
    )
