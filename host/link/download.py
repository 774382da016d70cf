"""Download of blobs from the vehicle over MAVLink FTP, in pieces that each fit a radio frame."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from trimtab.host.base.artefacts import content_id
from trimtab.host.base.errors import LinkError, UsageError
from trimtab.host.link.client import Client
from trimtab.host.link.drivers import run_lockstep, run_port
from trimtab.host.link.keys import StationKey
from trimtab.host.link.ports import open_port
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import PATIENCE_US, FindVehicle, FreshStatus, Task
from trimtab.host.link.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.ftp import Error, Opcode, Packet
from trimtab.protocol.messages import Message
from trimtab.protocol.stream import OVERHEAD_BYTES, SIGNATURE_BYTES
from trimtab.protocol.uwb_pieces import FRAME_BYTES

PIECE_BYTES = FRAME_BYTES - OVERHEAD_BYTES - 3 - 12
"""File bytes in one answer: a radio frame less message overhead, target (3 bytes), FTP header (12 bytes).

Signed answers hold SIGNATURE_BYTES fewer.
"""
WINDOW = 8
"""Greatest number of pieces requested and not yet received."""
RETRY_US = 250_000
SESSIONS = range(64, 192)
"""FTP session numbers to choose from, by the time.

Programs with the same MAVLink address then rarely use the same number. Other programs count from 0.
"""


@dataclass(frozen=True, kw_only=True)
class OnBoard:
    """A blob slot on the vehicle: its kind, whether it is staged or live, and its path."""

    kind: Kind
    staged: bool
    path: str

    @property
    def suffix(self) -> str:
        """File suffix: `.ref` or `.ff`."""
        return self.path[self.path.rindex(".") :]


NAMES = {
    "reference": OnBoard(kind=Kind.REFERENCE, staged=False, path="/ref/live.ref"),
    "feedforward": OnBoard(kind=Kind.FEEDFORWARD, staged=False, path="/ff/live.ff"),
    "staged-reference": OnBoard(kind=Kind.REFERENCE, staged=True, path="/ref/staged.ref"),
    "staged-feedforward": OnBoard(kind=Kind.FEEDFORWARD, staged=True, path="/ff/staged.ff"),
}
"""Slots that `trimtab download` can read, by name."""


def id_on_board(status: m.FcStatus, slot: OnBoard) -> str | None:
    """Return the id (12 hex digits) of the blob in a slot, as the status reports it; None if it is empty."""
    if slot.staged:
        blob_id = bytes(status.staged_id) if status.staged_kind == slot.kind else b""
    else:
        blob_id = bytes(status.reference_id if slot.kind is Kind.REFERENCE else status.feedforward_id)
    return blob_id.hex() if any(blob_id) else None


class ReadFile(Task):
    """Read a file on the vehicle.

    The result is its bytes, or None if the file does not exist. Raises LinkError if the vehicle does not
    answer. The task closes its FTP session at the end and does not wait for the confirmation.
    """

    wants = (m.FileTransfer,)

    def __init__(self, path: str) -> None:
        super().__init__()
        self.repeated = 0
        self._path = path
        self._number = self._session = 0
        self._size: int | None = None
        self._pieces: dict[int, bytes] = {}
        self._asked_us: dict[int, int] = {}
        self._heard_us = 0
        self._piece_bytes = PIECE_BYTES

    def begin(self, client: Client, now_us: int) -> None:
        self._heard_us = now_us
        self._piece_bytes = PIECE_BYTES - (0 if client.key is None else SIGNATURE_BYTES)
        # Avoid the numbers of an earlier run: the vehicle may still hold answers to them.
        self._number = now_us // 1000 & 0xFFFF
        self._session = SESSIONS[now_us // 1000 % len(SESSIONS)]
        self.advance(client, now_us)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.FileTransfer)
        answer = Packet.decode(bytes(message.payload))
        to_us = (message.target_system, message.target_component) == m.HOST
        if not to_us or answer.session != self._session:
            return
        if answer.request == Opcode.OPEN_FILE_RO and self._size is None:
            self._opened(answer, now_us)
        elif answer.request == Opcode.READ_FILE and self._size is not None:
            self._read(answer, now_us)
        if not self.done:
            self.advance(client, now_us)
        if self.done and self._size is not None:
            self._ask(client, Opcode.TERMINATE_SESSION)

    def advance(self, client: Client, now_us: int) -> None:
        if now_us - self._heard_us >= PATIENCE_US:
            received = len(self._pieces) * self._piece_bytes
            raise LinkError(
                f"{self._path}: the download stopped after {received} bytes; check the link and try again"
            )
        if self._size is None:
            data = self._path.encode()
            self._ask(client, Opcode.OPEN_FILE_RO, size=len(data), data=data)
            self.deadline_us = now_us + RETRY_US
            return
        room = WINDOW
        for offset in range(0, self._size, self._piece_bytes):
            if offset in self._pieces:
                continue
            if now_us - self._asked_us.get(offset, -RETRY_US) >= RETRY_US:
                self.repeated += offset in self._asked_us
                self._asked_us[offset] = now_us
                self._ask(client, Opcode.READ_FILE, size=self._piece_bytes, offset=offset)
            room -= 1
            if room == 0:
                break
        waiting = [us for offset, us in self._asked_us.items() if offset not in self._pieces]
        self.deadline_us = min(waiting, default=now_us) + RETRY_US

    def _opened(self, answer: Packet, now_us: int) -> None:
        self._heard_us = now_us
        if answer.opcode == Opcode.NAK:
            error = answer.data[0] if answer.data else 0
            if error == Error.FILE_NOT_FOUND:
                self.finish(None)
                return
            raise LinkError(f"{self._path}: the vehicle cannot open it (error {error}); try again later")
        self._size = int.from_bytes(answer.data[:4], "little")

    def _read(self, answer: Packet, now_us: int) -> None:
        assert self._size is not None
        if answer.opcode == Opcode.NAK:
            raise LinkError(f"{self._path}: the vehicle closed the file during the download; try again")
        if answer.offset in self._pieces or answer.offset not in self._asked_us:
            return
        if len(answer.data) != min(self._piece_bytes, self._size - answer.offset):
            return
        self._heard_us = now_us
        self._pieces[answer.offset] = answer.data
        if sum(map(len, self._pieces.values())) == self._size:
            self.finish(b"".join(self._pieces[offset] for offset in sorted(self._pieces)))

    def _ask(
        self, client: Client, opcode: Opcode, *, size: int = 0, offset: int = 0, data: bytes = b""
    ) -> None:
        self._number = self._number + 1 & 0xFFFF
        request = Packet(
            number=self._number, session=self._session, opcode=opcode, size=size, offset=offset, data=data
        )
        client.send(m.FileTransfer(0, *m.VEHICLE, request.encode()))


@dataclass(frozen=True, kw_only=True)
class Download:
    """One download: slot name, id and bytes of the blob, duration, and number of pieces requested again."""

    name: str
    id: str
    data: bytes
    seconds: float
    repeated: int

    def to_json(self) -> dict[str, Any]:
        """Return the answer of `trimtab download --json`, without the file name."""
        return {
            "name": self.name,
            "id": self.id,
            "bytes": len(self.data),
            "seconds": self.seconds,
            "pieces_repeated": self.repeated,
        }


def read_back(session: Session, name: str, status: m.FcStatus, port: str) -> Generator[Task, Any, Download]:
    """Download the blob in the slot `name` and check it against the id in `status`. For session scripts.

    Raises UsageError if the slot is empty, LinkError if the download fails or its bytes have another id.
    """
    slot = NAMES[name]
    expected = id_on_board(status, slot)
    begin_us = session.now_us
    task = ReadFile(slot.path)
    data: bytes | None = None if expected is None else (yield task)
    if data is None or expected is None:
        raise UsageError(f"{port}: no {name} on board; send one with trimtab upload")
    received = content_id(data)
    if received != expected:
        raise LinkError(
            f"{port}: expected {name} {expected} but received {received}; "
            "it changed during the download, try again"
        )
    seconds = (session.now_us - begin_us) * 1e-6
    return Download(name=name, id=expected, data=data, seconds=seconds, repeated=task.repeated)


def download_session(
    name: str,
    port: str,
    on_phase: Callable[[str], None] | None = None,
    *,
    key: StationKey | None = None,
) -> Session:
    """Return a session that downloads a blob from the vehicle at a port; its result is a Download."""

    def script(session: Session) -> Generator[Task, Any, Download]:
        yield FindVehicle(port)
        status = yield FreshStatus()
        if on_phase is not None:
            on_phase(f"reading {name}")
        return (yield from read_back(session, name, status, port))

    return Session(script, key=key)


def download_port(
    name: str,
    port: str,
    on_phase: Callable[[str], None] | None = None,
    *,
    key: StationKey | None = None,
) -> Download:
    """Download a blob from the vehicle at a serial port, in real time.

    Raises UsageError, LinkError or KeyboardInterrupt.
    """
    session = download_session(name, port, on_phase, key=key)
    with contextlib.closing(open_port(port)) as line:
        run_port(session, line)
    return session.outcome()


def download_lockstep(name: str, vehicle: Vehicle, *, key: StationKey | None = None) -> Download:
    """Download a blob from a vehicle in this process."""
    session = download_session(name, "vehicle", key=key)
    run_lockstep(session, vehicle)
    return session.outcome()
