"""A vehicle of a few lines that answers over bytes, for testing the host's side alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.link.session import Script, Session
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.upload import UploadReceiver, Verdict

STEP_US = 1000


class FakeVehicle:
    """Answers what a session asks. What `drop` says is lost in either direction.

    Attributes:
        parameters: on board. refuse: result of commands by number, asked anew each time. heard: all messages.
        clock_offset_us: vehicle clock minus host clock. verdict: of the check of blobs.
        upload: its end of uploads.
    """

    def __init__(self) -> None:
        self.parameters: dict[str, float] = {"MASS": 0.752, "POS_P_N": 6.0, "LAND_SPEED": 0.5}
        self.refuse: Callable[[int], int] = lambda number: mavlink.MAV_RESULT_ACCEPTED
        self.text = ""
        self.heard: list[Message] = []
        self.clock_offset_us = 0
        self.beats = True
        self.answers = True
        self.heartbeat = m.vehicle_heartbeat(1, armed=False)
        self.product_id = m.DIALECT_VERSION
        self.board_version = 0
        self.drop: Callable[[], bool] = lambda: False
        self.verdict = Verdict(ok=True)
        self.store = ReferenceStore()
        self.upload = UploadReceiver(
            self.store,
            check=lambda kind, blob: self.verdict,
            may_commit=lambda kind: True,
            capacity=65536,
        )
        self._codec = Codec(*m.VEHICLE)
        self._out: list[bytes] = []
        self._beat_us = 0
        self.number = 0

    def run(self, now_us: int, data: bytes) -> bytes:
        """Bytes for the host: the answers to `data`, and what is due."""
        for message in self._codec.decode(data):
            self.heard.append(message)
            if self.answers and not self.drop():
                self._handle(message, now_us)
        if self.beats and now_us >= self._beat_us:
            self._beat_us = now_us + 1_000_000
            self.send(self.heartbeat)
        for message in self.upload.send(now_us):
            self.send(message)
        out, self._out = self._out, []
        return b"".join(out)

    def send(self, message: Message) -> None:
        data = self._codec.encode(message)
        if not self.drop():
            self._out.append(data)

    def _handle(self, message: Any, now_us: int) -> None:
        if isinstance(message, m.Timesync) and message.tc1 == 0:
            self.send(m.Timesync((now_us + self.clock_offset_us) * 1000, message.ts1))
        elif isinstance(message, m.ParamRequestList):
            for index in range(len(self.parameters)):
                self._send_value(index)
        elif isinstance(message, m.ParamRequestRead):
            self._send_value(message.param_index)
        elif isinstance(message, m.ParamSet):
            names = list(self.parameters)
            if message.param_id in names:
                if message.param_value < 100.0:
                    self.parameters[message.param_id] = message.param_value
                self._send_value(names.index(message.param_id))
        elif isinstance(message, m.CommandLong):
            self._command(message)
        else:
            self.upload.receive(message, now_us)

    def _send_value(self, index: int) -> None:
        name, value = list(self.parameters.items())[index]
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        self.send(m.ParamValue(name.encode(), value, kind, len(self.parameters), index))

    def _command(self, message: m.CommandLong) -> None:
        if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE and message.param1 == m.AutopilotVersion.id:
            version, unused = [*bytes.fromhex("0123456789ab"), 0, 0], [0] * 8
            uid = [*(7).to_bytes(8, "little"), *bytes(10)]
            product = (m.VENDOR_ID, self.product_id)
            numbers = (0, 0, 0, 0, self.board_version)
            self.send(m.AutopilotVersion(*numbers, version, unused, unused, *product, 7, uid))
        result = self.refuse(message.command)
        if result != mavlink.MAV_RESULT_ACCEPTED and self.text:
            self.send(m.StatusText(4, self.text.encode()))
        self.send(m.CommandAck(message.command, result, 0, 0, *m.HOST))


def run(
    script: Callable[[Session], Script],
    vehicle: FakeVehicle | None,
    *,
    until_s: float = 60.0,
    delay_us: int = 3000,
    datagrams: Sequence[tuple[int, bytes]] = (),
) -> Session:
    """The session after its script has ended, over a line that delays both ways by `delay_us`."""
    session = Session(script)
    up: list[tuple[int, bytes]] = []
    down: list[tuple[int, bytes]] = []
    waiting = list(datagrams)
    now_us = 0
    while not session.done:
        if now_us > until_s * 1e6:
            raise AssertionError(f"the script has not ended after {until_s} s")
        arrived = b"".join(data for due_us, data in down if due_us <= now_us)
        down = [(due_us, data) for due_us, data in down if due_us > now_us]
        poses = [data for due_us, data in waiting if due_us <= now_us]
        waiting = waiting[len(poses) :]
        if arrived or poses or now_us >= session.next_deadline_us:
            out = session.step(now_us, arrived, poses)
            if out:
                up.append((now_us + delay_us, out))
        if vehicle is not None:
            data = b"".join(data for due_us, data in up if due_us <= now_us)
            up = [(due_us, data) for due_us, data in up if due_us > now_us]
            answer = vehicle.run(now_us, data)
            if answer:
                down.append((now_us + delay_us, answer))
        now_us += STEP_US
    return session


@pytest.fixture
def fake() -> FakeVehicle:
    return FakeVehicle()


@pytest.fixture(name="run")
def _run() -> Callable[..., Session]:
    return run
