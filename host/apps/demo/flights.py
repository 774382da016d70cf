"""The demo's flights: a simulated vehicle in a world that this side knows by name and seed only.

A flight is a function of reference, feed-forward and flight index; nothing is carried from one to the next.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

from trimtab.host.base import artefacts
from trimtab.host.base.errors import FlightFailed
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import FlightEnded, fly_lockstep
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.upload import UploadResult, upload_port
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Blob, FeedForward, Reference

TRUTH_SUFFIX = ".truth.json"


@dataclass(frozen=True, kw_only=True)
class Airfield:
    """Where plans are flown: vehicle, name and seed of the world, and what logs may say of the session."""

    vehicle: Vehicle
    world: str
    world_seed: int
    session: Mapping[str, str]

    def check(self) -> None:
        """Raise ConfigurationError if there is no such world."""
        vehicle_class().create(self.vehicle, world=self.world, world_seed=self.world_seed).close()

    def power_up(self, reference: Reference, flight: int) -> Any:
        """Return a simulated vehicle below the reference's first node."""
        north, east = reference.nodes_ned()[0].state[:2]
        return vehicle_class().create(
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
        model_id: str | None = None,
    ) -> FlightResult:
        """Return the result of a flight with a vehicle of its own, blobs uploaded in lock-step before it."""
        with closing(self.power_up(reference, flight)) as simulated:
            return self.fly_with(
                simulated, reference, flight, log, feedforward=feedforward, model_id=model_id, upload=True
            )

    def fly_with(
        self,
        simulated: Any,
        reference: Reference,
        flight: int,
        log: Path,
        *,
        feedforward: FeedForward | None = None,
        model_id: str | None = None,
        upload: bool = False,
    ) -> FlightResult:
        """Return the result of a flight with a powered-up vehicle; its truth is sealed beside the log.

        Raises FlightFailed where it ends in failsafe or early; the log is readable then too.
        """
        order = FlightRequest(
            vehicle=self.vehicle,
            reference=reference,
            feedforward=feedforward,
            log_path=log,
            port="simulated vehicle",
            upload=upload,
            model_id=model_id,
            session={**self.session, "flight": str(flight)},
        )
        before = _file_number(log)
        try:
            return fly_lockstep(order, simulated)
        except FlightEnded as ended:
            raise FlightFailed(f"flight {flight}: {ended}") from ended
        finally:
            if _file_number(log) not in (None, before):
                _seal(simulated.truth(), log)


def upload_through_pty(simulated: Any, blob: Blob) -> tuple[str, UploadResult]:
    """Return the pty's name and the upload's result: the vehicle stands by in real time at a pseudo terminal.

    The bytes go through pyserial, as they would to hardware.
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


def _file_number(path: Path) -> int | None:
    """Return what tells the file at `path` from one that replaces it while it is there; None for no file."""
    return path.stat().st_ino if path.exists() else None


def _seal(truth: Mapping[str, Any], log: Path) -> None:
    """Write what the world held beside the log, tied to it by its id. Only checks open it."""
    record = {**truth, "log": artefacts.content_id(log.read_bytes())}
    text = json.dumps(record, indent=2, sort_keys=True) + "\n"
    artefacts.write_atomic(log.with_name(log.name + TRUTH_SUFFIX), text, force=True)
