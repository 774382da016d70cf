"""Speed of a complete simulated session, with radio and firmware."""

from __future__ import annotations

import tempfile
from contextlib import closing
from pathlib import Path

from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.plan import plan
from trimtab.host.route import load_route
from trimtab.host.vehicle import Vehicle

ROUTE = "pretzel"
_FLIGHTS = 3


def realtime_factor(vehicle: Vehicle) -> float:
    """Return simulated seconds over seconds, the best of three flights of a shipped route in lock-step."""
    reference = plan(load_route(ROUTE), vehicle, kind="min-snap").reference
    north, east = reference.nodes_ned()[0].state[:2]
    found = []
    with tempfile.TemporaryDirectory(prefix="trimtab-bench-") as folder:
        for flight in range(_FLIGHTS):
            simulated = vehicle_class().create(vehicle, flight=flight, start_ned=(north, east, 0.0))
            request = FlightRequest(
                vehicle=vehicle, reference=reference, log_path=Path(folder) / f"flight-{flight}.mcap"
            )
            with closing(simulated):
                found.append(fly_lockstep(request, simulated).realtime_factor)
    return max(found)
