"""Whether logs belong together, which are repeat flights, and which effects they can show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

from trimtab.host.effects import Effect
from trimtab.host.effects.unknowns import UNKNOWN
from trimtab.host.log import Flight, is_same_flight
from trimtab.host.trace.data.sets import unknowns_of_change
from trimtab.host.trace.data.signals import FlightData, has_signals, unknowns
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.vehicle import Vehicle

Drive = Literal["reference", "inputs"]
"""Data that drive a prediction: the reference of a whole flight, or the recorded inputs of a segment."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TraceData:
    """The flights of one trace, read once.

    Attributes
    ----------
    vehicle
        Vehicle of all flights.
    flights
        Flights in which effects are searched.
    held_out
        Flights that only the prediction error is computed on.
    unknown
        What at least one of the logs does not determine, as words of the metadata entry `unknown`, such as
        "torque".
    drive
        Data that can drive a prediction of all flights.
    repeat_flights
        Pairs of indices into `flights` that are repeat flights of each other.
    """

    vehicle: Vehicle
    flights: tuple[FlightData, ...]
    held_out: tuple[FlightData, ...]
    unknown: frozenset[str]
    drive: Drive
    repeat_flights: tuple[tuple[int, int], ...]

    def compared(self, baseline: int) -> TraceData:
        """Return the same flights as two sets, of which the first `baseline` flights are the first one.

        Their recorded inputs drive the predictions. Repeat flights are of one set: a change makes
        those of two sets differ.
        """
        return replace(
            self,
            drive="inputs",
            unknown=unknowns_of_change([data.flight for data in (*self.flights, *self.held_out)]),
            repeat_flights=tuple((a, b) for a, b in self.repeat_flights if (a < baseline) == (b < baseline)),
        )


def read_logs(flights: Sequence[Flight], held_out: Sequence[Flight], vehicle: Vehicle | None) -> TraceData:
    """Return the data of all flights, which must be of one vehicle.

    vehicle: the vehicle of the flights; that of the first flight if None. Raises LogsRefused for a log of
    another vehicle, a flight given twice, a held-out flight whose reference is also used, a log without poses
    or tracking phase, and one that declares unknown what has no name in `UNKNOWN`.
    """
    first = vehicle or flights[0].vehicle
    by_id: dict[str, FlightData] = {}
    for flight in (*flights, *held_out):
        if flight.vehicle.id != first.id:
            raise LogsRefused(
                Code.MIXED_VEHICLES,
                f"{flight.path}: a log of vehicle {flight.vehicle.name} ({flight.vehicle.id}), "
                f"not of {first.name} ({first.id}): {_differences(flight.vehicle, first)}; "
                "trace each vehicle's logs separately",
            )
        if undefined := unknowns([flight]) - set(UNKNOWN):
            raise LogsRefused(
                Code.UNDEFINED_UNKNOWN,
                f"{flight.path}: metadata entry unknown holds {', '.join(sorted(undefined))}, but only these "
                f"words are defined: {', '.join(UNKNOWN)}; import the log again",
            )
        for earlier in by_id.values():
            if is_same_flight(earlier.flight, flight):
                raise LogsRefused(
                    Code.LOG_GIVEN_TWICE,
                    f"{flight.path}: the same flight as {earlier.flight.path}; give it once",
                )
        by_id[flight.id] = FlightData.of(flight)
    used = {flight.reference_id for flight in flights if flight.reference_id is not None}
    for flight in held_out:
        if flight.reference_id in used:
            raise LogsRefused(
                Code.HELD_OUT_REFERENCE_USED,
                f"{flight.path}: flies reference {flight.reference_id}, as do flights that are not held out; "
                "hold out flights of other references",
            )
    return TraceData(
        vehicle=first,
        flights=tuple(by_id[flight.id] for flight in flights),
        held_out=tuple(by_id[flight.id] for flight in held_out),
        unknown=unknowns([*flights, *held_out]),
        drive=drive_of([*flights, *held_out]),
        repeat_flights=tuple(repeat_flights_of(flights)),
    )


def _differences(first: Vehicle, second: Vehicle) -> str:
    """Return which entries of two vehicle files differ, as text."""
    keys = [key for key in Vehicle.model_fields if getattr(first, key) != getattr(second, key)]
    return ", ".join(keys) + " differ"


def observable_effects(effects: Mapping[str, Effect], flights: Sequence[Flight]) -> dict[str, Effect]:
    """Return the effects whose required signals these flights contain.

    Battery sag, for example, is left out if every battery stayed full.
    """
    return {name: effect for name, effect in effects.items() if has_signals(effect, flights)}


def drive_of(flights: Sequence[Flight]) -> Drive:
    """Return "reference" if the law on board, which is logged, flew every reference, else "inputs"."""
    return "reference" if all(flight.flown_by_own_law for flight in flights) else "inputs"


def repeat_flights_of(flights: Sequence[Flight]) -> list[tuple[int, int]]:
    """Return the pairs of indices of repeat flights.

    Repeat flights fly the same reference with the same feed-forward, the same firmware parameters and the
    same controller on the host, if any. Under another control law the vehicle flies differently, so the model
    errors of two flights differ too.
    """
    keys = [
        (
            flight.reference_id,
            flight.metadata.get("feedforward_id"),
            flight.firmware_parameters,
            None if flight.host_control is None else flight.host_control.identity,
        )
        for flight in flights
    ]
    return [(a, b) for a, b in combinations(range(len(flights)), 2) if keys[a][0] and keys[a] == keys[b]]


def flights_by_reference(repeat_flights: Sequence[tuple[int, int]], count: int) -> list[list[int]]:
    """Return groups of indices of `count` flights: repeat flights together, any other flight alone.

    repeat_flights: pairs of indices of repeat flights.
    """
    group = list(range(count))
    for a, b in repeat_flights:
        group[b] = min(group[a], group[b])
    references: dict[int, list[int]] = {}
    for flight, first in enumerate(group):
        references.setdefault(first, []).append(flight)
    return list(references.values())
