"""Uploads from beginning to end, for verbs and whoever else has a blob for a vehicle."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from trimtab.host.base.errors import LinkError
from trimtab.host.link.download import NAMES, id_on_board, read_back
from trimtab.host.link.drivers import run_lockstep, run_port
from trimtab.host.link.ports import open_port
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import FindVehicle, FreshStatus, Identity, Task
from trimtab.host.link.upload_tasks import make_live
from trimtab.host.link.vehicle import Vehicle
from trimtab.host.link.whose import check_same_vehicle, neutral_feedforward
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Blob

STALE_MAX = 5
"""Statuses that may still be under way from before the commit."""


@dataclass(frozen=True, kw_only=True)
class UploadResult:
    """One upload: kind and id of the blob, time, frames sent and retransmitted.

    `read_back` says whether what is live was read back and is the same byte by byte.
    """

    kind: str
    id: str
    seconds: float
    frames_sent: int
    frames_repeated: int
    read_back: bool = False

    def to_json(self) -> dict[str, Any]:
        """Return the answer of `trimtab upload --json`."""
        return {
            "kind": self.kind,
            "id": self.id,
            "seconds": self.seconds,
            "frames_sent": self.frames_sent,
            "frames_repeated": self.frames_repeated,
            "read_back": self.read_back,
        }


def upload_session(
    wanted: Blob | None,
    port: str,
    on_phase: Callable[[str], None] | None = None,
    *,
    compare: bool = False,
) -> Session:
    """Return a session that makes a blob live on the vehicle at a port; its result is an UploadResult.

    None stands for the neutral feed-forward of whatever vehicle is there. `compare`: what is live afterwards
    is read back, and LinkError raised where it is another.
    """

    def script(session: Session) -> Generator[Task, Any, UploadResult]:
        say = on_phase or (lambda phase: None)
        identity: Identity = yield FindVehicle(port)
        blob = neutral_feedforward(identity.vehicle_id) if wanted is None else wanted
        kind = blob.KIND.name.lower()
        check_same_vehicle(identity, blob.vehicle_id, what=f"the {kind}", port=port)
        yield FreshStatus()
        say(f"sending {kind} {blob.id}")
        begin_us = session.now_us
        sender = yield from make_live(blob, f"{kind} {blob.id}")
        seconds = (session.now_us - begin_us) * 1e-6
        if compare:
            say(f"reading {kind} {blob.id} back")
            yield from _compare(session, blob, port)
        return UploadResult(
            kind=kind,
            id=blob.id,
            seconds=seconds,
            read_back=compare,
            frames_sent=sender.messages_sent,
            frames_repeated=sender.chunks_repeated,
        )

    return Session(script)


def _compare(session: Session, blob: Blob, port: str) -> Generator[Task, Any, None]:
    """Raise LinkError where what is live is not this blob byte by byte."""
    name = blob.KIND.name.lower()
    status: m.FcStatus = yield FreshStatus()
    for _ in range(STALE_MAX):
        if id_on_board(status, NAMES[name]) == blob.id:
            break
        status = yield FreshStatus()
    found = yield from read_back(session, name, status, port)
    if found.data != blob.to_bytes():
        raise LinkError(f"{port}: {name} {blob.id} reads back otherwise; upload it again")


def upload_port(
    blob: Blob | None,
    port: str,
    on_phase: Callable[[str], None] | None = None,
    *,
    compare: bool = False,
) -> UploadResult:
    """Return the result of an upload at a serial port in real time. Raises Refused, LinkError or UsageError.

    None: the neutral feed-forward. `compare`: read back what is live. At Ctrl-C, SIGTERM or SIGHUP the
    vehicle is told to forget what it was sent (KeyboardInterrupt); at a second Ctrl-C it is not.
    """
    session = upload_session(blob, port, on_phase, compare=compare)
    with contextlib.closing(open_port(port)) as line:
        run_port(session, line)
    return session.outcome()


def upload_lockstep(
    blob: Blob | None,
    vehicle: Vehicle,
    on_phase: Callable[[str], None] | None = None,
    *,
    compare: bool = False,
) -> UploadResult:
    """Return the same with a vehicle in this process."""
    session = upload_session(blob, "vehicle", on_phase, compare=compare)
    run_lockstep(session, vehicle)
    return session.outcome()
