"""Complete uploads of a blob, to a vehicle in this process or at a serial port."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from trimtab.host.base.errors import LinkError
from trimtab.host.link.download import NAMES, id_on_board, read_back
from trimtab.host.link.drivers import run_lockstep, run_port
from trimtab.host.link.keys import StationKey
from trimtab.host.link.ports import open_port
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import FindVehicle, FreshStatus, Identity, Task
from trimtab.host.link.upload_tasks import make_live
from trimtab.host.link.vehicle import Vehicle
from trimtab.host.link.vehicle_match import check_same_vehicle, neutral_feedforward
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Blob

STALE_MAX = 5
"""Greatest number of statuses that may arrive late, from before the commit."""


@dataclass(frozen=True, kw_only=True)
class UploadResult:
    """One upload: kind and id of the blob, duration, frames sent and retransmitted.

    `read_back`: the live blob was read back and is identical byte by byte.
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
    key: StationKey | None = None,
) -> Session:
    """Return a session that makes a blob live on the vehicle at a port; its result is an UploadResult.

    If `wanted` is None, the session uploads the neutral feed-forward for the vehicle that answers. With
    `compare`, it reads the live blob back and raises LinkError if it differs.
    """

    def script(session: Session) -> Generator[Task, Any, UploadResult]:
        notify = on_phase or (lambda phase: None)
        identity: Identity = yield FindVehicle(port)
        blob = neutral_feedforward(identity.vehicle_id) if wanted is None else wanted
        kind = blob.KIND.name.lower()
        check_same_vehicle(identity, blob.vehicle_id, what=f"the {kind}", port=port)
        yield FreshStatus()
        notify(f"sending {kind} {blob.id}")
        begin_us = session.now_us
        sender = yield from make_live(blob, f"{kind} {blob.id}")
        seconds = (session.now_us - begin_us) * 1e-6
        if compare:
            notify(f"reading {kind} {blob.id} back")
            yield from _compare(session, blob, port)
        return UploadResult(
            kind=kind,
            id=blob.id,
            seconds=seconds,
            read_back=compare,
            frames_sent=sender.messages_sent,
            frames_repeated=sender.chunks_repeated,
        )

    return Session(script, key=key)


def _compare(session: Session, blob: Blob, port: str) -> Generator[Task, Any, None]:
    """Read the live blob back. Raise LinkError if it is not identical byte by byte."""
    name = blob.KIND.name.lower()
    status: m.FcStatus = yield FreshStatus()
    for _ in range(STALE_MAX):
        if id_on_board(status, NAMES[name]) == blob.id:
            break
        status = yield FreshStatus()
    download = yield from read_back(session, name, status, port)
    if download.data != blob.to_bytes():
        raise LinkError(f"{port}: {name} {blob.id} differs when read back; upload it again")


def upload_port(
    blob: Blob | None,
    port: str,
    on_phase: Callable[[str], None] | None = None,
    *,
    compare: bool = False,
    key: StationKey | None = None,
) -> UploadResult:
    """Upload a blob at a serial port in real time. Raises Refused, LinkError or UsageError.

    If `blob` is None, upload the neutral feed-forward. With `compare`, read the live blob back. At Ctrl-C,
    SIGTERM or SIGHUP the upload is cancelled on board (KeyboardInterrupt); at a second Ctrl-C it is not.
    """
    session = upload_session(blob, port, on_phase, compare=compare, key=key)
    with contextlib.closing(open_port(port)) as line:
        run_port(session, line)
    return session.outcome()


def upload_lockstep(
    blob: Blob | None,
    vehicle: Vehicle,
    on_phase: Callable[[str], None] | None = None,
    *,
    compare: bool = False,
    key: StationKey | None = None,
) -> UploadResult:
    """Upload a blob to a vehicle in this process."""
    session = upload_session(blob, "vehicle", on_phase, compare=compare, key=key)
    run_lockstep(session, vehicle)
    return session.outcome()
