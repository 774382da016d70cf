"""Flights of the demo: a simulated vehicle in a world of which only name and seed are known.

A flight depends only on reference, feed-forward and flight index, not on earlier flights.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from types import MappingProxyType
from typing import Any

from trimtab.host.base import artefacts
from trimtab.host.base.errors import FlightFailed
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import FlightEnded, fly_lockstep
from trimtab.host.link.host_control import HostControl
from trimtab.host.link.simulated import write_truth
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.upload import UploadResult, upload_port
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Blob, FeedForward, Reference

WORLD = "drawn-several"
"""World with two or three effects, drawn from the seed."""


@dataclass(frozen=True, kw_only=True)
class Airfield:
    """Simulated site of flights: vehicle, name and seed of the world, and session entries for the logs.

    force: whether a log replaces an existing one.
    """

    vehicle: Vehicle
    world: str
    world_seed: int
    session: Mapping[str, str]
    force: bool = True

    def simulator(self) -> Any:
        """Return the class of the simulated vehicles."""
        return vehicle_class()

    def check(self) -> None:
        """Raise ConfigurationError if there is no such world."""
        self.simulator().create(self.vehicle, world=self.world, world_seed=self.world_seed).close()

    def power_up(self, reference: Reference, flight: int) -> Any:
        """Return a simulated vehicle below the reference's first node."""
        north, east = reference.nodes_ned()[0].state[:2]
        return self.simulator().create(
            self.vehicle,
            world=self.world,
            world_seed=self.world_seed,
            flight=flight,
            start_ned=(north, east, 0.0),
            start_yaw=reference.yaw_nodes()[0].yaw,
        )

    def fly(
        self,
        reference: Reference,
        flight: int,
        log: Path,
        *,
        feedforward: FeedForward | None = None,
        parameters: Mapping[str, float] = MappingProxyType({}),
        control: HostControl | None = None,
        model_id: str | None = None,
    ) -> FlightResult:
        """Fly with a new vehicle after uploading the blobs in lock-step, and return the result.

        parameters: values to set on board before the flight, instead of the vehicle file's. control:
        controller on the host, instead of the law on board.
        """
        with closing(self.power_up(reference, flight)) as simulated:
            return self.fly_with(
                simulated,
                reference,
                flight,
                log,
                feedforward=feedforward,
                parameters=parameters,
                control=control,
                model_id=model_id,
                upload=True,
            )

    def fly_with(  # noqa: PLR0913 (one keyword for each choice)
        self,
        simulated: Any,
        reference: Reference,
        flight: int,
        log: Path,
        *,
        feedforward: FeedForward | None = None,
        parameters: Mapping[str, float] = MappingProxyType({}),
        control: HostControl | None = None,
        model_id: str | None = None,
        upload: bool = False,
    ) -> FlightResult:
        """Fly with a powered-up vehicle, seal its truth beside the log, and return the result.

        Raises FlightFailed if the flight ends in failsafe or early; the log is readable in that case too.
        """
        with closing(artefacts.reserve_log(log, self.force)) as part:
            request = FlightRequest(
                vehicle=self.vehicle,
                reference=reference,
                feedforward=feedforward,
                log_path=log,
                log_part=part,
                port="simulated vehicle",
                upload=upload,
                parameters=parameters,
                model_id=model_id,
                control=control,
                session={**self.session, "flight": str(flight)},
            )
            try:
                return fly_lockstep(request, simulated)
            except FlightEnded as ended:
                raise FlightFailed(f"flight {flight}: {ended}") from ended
            finally:
                write_truth(part, simulated.truth())


def upload_through_pty(simulated: Any, blob: Blob) -> tuple[str, UploadResult]:
    """Upload a blob through a pseudo-terminal in real time. Return the pty's name and the result.

    The bytes pass through pyserial, as with hardware.
    """
    stop = Event()
    address: Future[str] = Future()
    with ThreadPoolExecutor(max_workers=1) as server:
        served = server.submit(simulated.serve, port="pty", stop=stop.is_set, ready=address.set_result)
        try:
            wait((served, address), return_when=FIRST_COMPLETED)
            if not address.done():
                served.result()
            result = upload_port(blob, address.result())
        finally:
            stop.set()
    served.result()
    return address.result(), result
