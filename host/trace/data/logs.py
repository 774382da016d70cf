"""Which logs belong together, and which effects they could show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.trace.data.signals import has_signals, signals
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.vehicle import Vehicle


def check_logs(flights: Sequence[Flight], held_out: Sequence[Flight], vehicle: Vehicle | None) -> Vehicle:
    """The one vehicle of all logs.

    Raises UsageError for a mixture, a log given twice or a held-out reference that was used, and
    TooLittleData for a log without poses or tracking phase.
    """
    first = vehicle or flights[0].vehicle
    seen: dict[str, Flight] = {}
    for flight in (*flights, *held_out):
        if flight.vehicle.id != first.id:
            raise LogsRefused(
                Code.MIXED_VEHICLES,
                f"{flight.path}: a log of vehicle {flight.vehicle.name} ({flight.vehicle.id}), "
                f"not of {first.name} ({first.id}): {_differences(flight.vehicle, first)}; "
                "trace each vehicle's logs apart",
            )
        if flight.id in seen:
            raise LogsRefused(
                Code.LOG_GIVEN_TWICE,
                f"{flight.path}: the same log as {seen[flight.id].path}; give it once",
            )
        seen[flight.id] = flight
        signals(flight)
    used = {flight.reference_id for flight in flights if flight.reference_id is not None}
    for flight in held_out:
        if flight.reference_id in used:
            raise LogsRefused(
                Code.HELD_OUT_REFERENCE_USED,
                f"{flight.path}: flies reference {flight.reference_id}, which is among the flights used; "
                "hold out flights of other references",
            )
    return first


def _differences(one: Vehicle, other: Vehicle) -> str:
    """Which entries of two vehicle files differ."""
    keys = [key for key in Vehicle.model_fields if getattr(one, key) != getattr(other, key)]
    return ", ".join(keys) + " differ"


def observable_effects(effects: Mapping[str, Effect], flights: Sequence[Flight]) -> dict[str, Effect]:
    """The effects that these flights could show by their signals: no sag where every battery stayed full."""
    return {name: effect for name, effect in effects.items() if has_signals(effect, flights)}
