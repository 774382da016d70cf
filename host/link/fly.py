"""Flights and uploads from beginning to end, for verbs and whoever else has something to fly."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from host.errors import FlightFailed
from host.link.drivers import DriveStatistics, run_lockstep, run_port
from host.link.flight import FlightDirector, FlightOrder
from host.link.ports import Cameras, open_port
from host.link.session import Session
from host.link.summary import FlightResult, summarise
from host.link.tasks import FindVehicle, Identity, SendBlob, Task, check_same_vehicle
from host.link.vehicle import Vehicle
from protocol.blobs import Blob


class FlightEnded(FlightFailed):
    """A flight that did not fly its reference to the end; `result` is what there is, the log is kept."""

    def __init__(self, message: str, result: FlightResult) -> None:
        super().__init__(message)
        self.result = result


def fly_lockstep(
    order: FlightOrder,
    vehicle: Vehicle,
    *,
    realtime: bool = False,
    on_phase: Callable[[str], None] | None = None,
) -> FlightResult:
    """The result of flying `order` with a vehicle in this process; the vehicle stays open.

    Raises FlightEnded, TrimtabError, KeyboardInterrupt after the log is closed, or what the vehicle raises.
    """
    director = FlightDirector(order, on_phase)
    try:
        driven = run_lockstep(
            director.session, vehicle, realtime=realtime, interrupt=director.interrupt if realtime else None
        )
    except Exception as error:
        director.abandon(error)
        raise
    finally:
        director.close()
    return _conclude(director, order, driven)


def fly_port(
    order: FlightOrder,
    port: str,
    mocap: str,
    *,
    on_phase: Callable[[str], None] | None = None,
) -> FlightResult:
    """The result of flying `order` at a serial port in real time; poses arrive at the `mocap` URL.

    Raises as `fly_lockstep` does. At Ctrl-C the vehicle lands first; at the second it is left to itself.
    """
    director = FlightDirector(order, on_phase)
    with contextlib.closing(Cameras(mocap)) as cameras, contextlib.closing(open_port(port)) as line:
        try:
            driven = run_port(director.session, line, cameras, interrupt=director.interrupt)
        finally:
            director.close()
    return _conclude(director, order, driven)


def _conclude(director: FlightDirector, order: FlightOrder, driven: DriveStatistics) -> FlightResult:
    """The result of a session that is done, or its error."""
    error = director.session.error
    if error is not None:
        if director.log_open and isinstance(error, Exception):
            error.add_note(f"the log up to there is {order.log_path}")
        raise error
    result = summarise(director, order.log_path, driven)
    end = director.end
    assert end is not None
    if end.interrupted:
        raise KeyboardInterrupt
    if end.failsafe is not None:
        raise FlightEnded(
            f"the flight ended in failsafe: {end.failsafe}; its log is {order.log_path}", result
        )
    if not end.whole:
        raise FlightEnded(f"the flight ended before its reference did; its log is {order.log_path}", result)
    return result


@dataclass(frozen=True, kw_only=True)
class UploadResult:
    """One upload: kind and id of the blob, time, frames sent and how many of them again."""

    kind: str
    id: str
    seconds: float
    frames_sent: int
    frames_repeated: int

    def to_json(self) -> dict[str, Any]:
        """The answer of `trimtab upload --json`."""
        return {
            "kind": self.kind,
            "id": self.id,
            "seconds": self.seconds,
            "frames_sent": self.frames_sent,
            "frames_repeated": self.frames_repeated,
        }


def upload_session(blob: Blob, port: str, on_phase: Callable[[str], None] | None = None) -> Session:
    """A session that makes `blob` live on the vehicle at a port; its result is an UploadResult."""

    def script(session: Session) -> Generator[Task, Any, UploadResult]:
        say = on_phase or (lambda phase: None)
        kind = blob.KIND.name.lower()
        identity: Identity = yield FindVehicle(port)
        check_same_vehicle(identity, blob.vehicle_id, what=f"the {kind}", port=port)
        say(f"sending {kind} {blob.id}")
        begin_us = session.now_us
        sender = yield SendBlob(blob.to_bytes(), blob.KIND, what=f"{kind} {blob.id}")
        return UploadResult(
            kind=kind,
            id=blob.id,
            seconds=(session.now_us - begin_us) * 1e-6,
            frames_sent=sender.messages_sent,
            frames_repeated=sender.chunks_repeated,
        )

    return Session(script)


def upload_port(blob: Blob, port: str, on_phase: Callable[[str], None] | None = None) -> UploadResult:
    """The result of an upload at a serial port in real time. Raises Refused, LinkError or UsageError."""
    session = upload_session(blob, port, on_phase)
    with contextlib.closing(open_port(port)) as line:
        run_port(session, line)
    return _uploaded(session)


def upload_lockstep(
    blob: Blob, vehicle: Vehicle, on_phase: Callable[[str], None] | None = None
) -> UploadResult:
    """The same with a vehicle in this process."""
    session = upload_session(blob, "vehicle", on_phase)
    run_lockstep(session, vehicle)
    return _uploaded(session)


def _uploaded(session: Session) -> UploadResult:
    if session.error is not None:
        raise session.error
    result = session.result
    assert isinstance(result, UploadResult)
    return result
