"""Which logs belong together, and which effects they could show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.trace.data.signals import FlightData, has_signals, unknowns
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.vehicle import Vehicle

Drive = Literal["reference", "inputs"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TraceData:
    """The flights of one trace, read once.

    flights: those that effects are looked for in; held_out: those that the answer is scored on; unknown: what
    any of the logs declares unknown; drive: what all of them can be predicted from; repeat_flights: pairs of indices
    into `flights` that repeat each other.
    """

    vehicle: Vehicle
    flights: tuple[FlightData, ...]
    held_out: tuple[FlightData, ...]
    unknown: frozenset[str]
    drive: Drive
    repeat_flights: tuple[tuple[int, int], ...]


def read_logs(flights: Sequence[Flight], held_out: Sequence[Flight], vehicle: Vehicle | None) -> TraceData:
    """Return the data of all flights, of one vehicle.

    Raises LogsRefused for a mixture, a log given twice or a held-out reference that was used, and
    LogsRefused for a log without poses or tracking phase.
    """
    first = vehicle or flights[0].vehicle
    by_id: dict[str, FlightData] = {}
    for flight in (*flights, *held_out):
        if flight.vehicle.id != first.id:
            raise LogsRefused(
                Code.MIXED_VEHICLES,
                f"{flight.path}: a log of vehicle {flight.vehicle.name} ({flight.vehicle.id}), "
                f"not of {first.name} ({first.id}): {_differences(flight.vehicle, first)}; "
                "trace each vehicle's logs apart",
            )
        if flight.id in by_id:
            raise LogsRefused(
                Code.LOG_GIVEN_TWICE,
                f"{flight.path}: the same log as {by_id[flight.id].flight.path}; give it once",
            )
        by_id[flight.id] = FlightData.of(flight)
    used = {flight.reference_id for flight in flights if flight.reference_id is not None}
    for flight in held_out:
        if flight.reference_id in used:
            raise LogsRefused(
                Code.HELD_OUT_REFERENCE_USED,
                f"{flight.path}: flies reference {flight.reference_id}, which is among the flights used; "
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


def _differences(one: Vehicle, other: Vehicle) -> str:
    """Which entries of two vehicle files differ."""
    keys = [key for key in Vehicle.model_fields if getattr(one, key) != getattr(other, key)]
    return ", ".join(keys) + " differ"


def observable_effects(effects: Mapping[str, Effect], flights: Sequence[Flight]) -> dict[str, Effect]:
    """Return the effects that these flights could show by their signals: no sag where every battery stayed
    full.
    """
    return {name: effect for name, effect in effects.items() if has_signals(effect, flights)}


def drive_of(flights: Sequence[Flight]) -> Drive:
    """How these flights can be predicted: "reference" where all have one and the law on board, else
    "inputs".
    """
    known = all(f.reference is not None and f.firmware_parameters is not None for f in flights)
    return "reference" if known else "inputs"


def repeat_flights_of(flights: Sequence[Flight]) -> list[tuple[int, int]]:
    """Pairs of indices of flights of the same reference under the same feed-forward and firmware parameters.

    A law that holds the vehicle closer repeats other errors of the model than one that does not.
    """
    keys = [
        (flight.reference_id, flight.metadata.get("feedforward_id"), flight.firmware_parameters)
        for flight in flights
    ]
    return [(a, b) for a, b in combinations(range(len(flights)), 2) if keys[a][0] and keys[a] == keys[b]]


def strata_of(repeat_flights: Sequence[tuple[int, int]], count: int) -> list[list[int]]:
    """Return indices of `count` flights, those of one reference together; all that have no twin together."""
    group = list(range(count))
    for a, b in repeat_flights:
        group[b] = min(group[a], group[b])
    found: dict[int, list[int]] = {}
    for flight, first in enumerate(group):
        found.setdefault(first, []).append(flight)
    alone = [flight for flights in found.values() if len(flights) == 1 for flight in flights]
    return [flights for flights in found.values() if len(flights) > 1] + ([alone] if alone else [])
