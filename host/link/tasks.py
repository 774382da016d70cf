"""What a host asks of a vehicle, each a small state machine that asks again until it is answered or gives up.

A task queues messages through the client and sees those it names in `wants`. It ends with a `result`, or
raises one of `trimtab.host.base.errors` out of `receive` or `advance`.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from math import isfinite
from typing import Any

from trimtab.host.base.errors import LinkError, Refused
from trimtab.host.link.client import NEVER_US, Client
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Blob
from trimtab.protocol.messages import Message, UploadState, mavlink
from trimtab.protocol.parameter_wire import decode, encode, type_of
from trimtab.protocol.parameters import BY_NAME, NAME_MAX, equal, float32
from trimtab.protocol.upload import SenderState, UploadSender
from trimtab.protocol.upload.transfer import tag_of

PATIENCE_US = 5_000_000
RETRY_US = 300_000
_VEHICLE_SYSTEM = m.VEHICLE[0]
TEXT_WAIT_US = 150_000
"""Time after a refusal in which the vehicle's own words may still arrive."""


class Task:
    """A task before it has begun; `deadline_us` is when `advance` wants to be called at the latest."""

    wants: tuple[type[Message], ...] = ()

    def __init__(self) -> None:
        self.done = False
        self.result: Any = None
        self.deadline_us = NEVER_US

    def begin(self, client: Client, now_us: int) -> None:
        """Queues the first messages."""
        self.deadline_us = now_us

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        """Take a message of one of the wanted types."""

    def advance(self, client: Client, now_us: int) -> None:
        """Take note of the time."""

    def finish(self, result: Any = None) -> None:
        """End the task."""
        self.result = result
        self.done = True
        self.deadline_us = NEVER_US


@dataclass(frozen=True, kw_only=True)
class Identity:
    """Who answered: id of the vehicle file it was set up for, uid of its power-up (hex)."""

    vehicle_id: str
    uid: str


class FindVehicle(Task):
    """Result: the Identity of the vehicle at the port. Raises LinkError where none of ours is.

    Parameters
    ----------
    port
        how messages call the port.
    """

    wants = (m.Heartbeat, m.AutopilotVersion)

    def __init__(self, port: str, patience_us: int = PATIENCE_US) -> None:
        super().__init__()
        self._port = port
        self._patience_us = patience_us
        self._end_us = NEVER_US
        self._met = False

    def begin(self, client: Client, now_us: int) -> None:
        self._end_us = now_us + self._patience_us
        self.deadline_us = now_us

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        if isinstance(message, m.Heartbeat):
            self._meet(client, message, now_us)
        elif isinstance(message, m.AutopilotVersion) and message.vendor_id == m.VENDOR_ID:
            self._check_dialect(message.product_id)
            uid = int.from_bytes(bytes(message.uid2), "little") or message.uid
            vehicle_id = bytes(message.flight_custom_version)[:6].hex()
            self.finish(Identity(vehicle_id=vehicle_id, uid=f"{uid:016x}"))

    def _meet(self, client: Client, message: m.Heartbeat, now_us: int) -> None:
        version = m.dialect_version(message)
        if version is None:
            raise LinkError(
                f"{self._port}: a MAVLink vehicle, but none that speaks Trimtab's dialect; check the port"
            )
        self._check_dialect(version)
        if not self._met:
            self._met = True
            self._end_us = now_us + self._patience_us
            self._ask(client, now_us)

    def _check_dialect(self, version: int) -> None:
        if version != m.DIALECT_VERSION:
            raise LinkError(
                f"{self._port}: the vehicle speaks version {version} of the dialect, this trimtab version "
                f"{m.DIALECT_VERSION}; bring both to the same release"
            )

    def _ask(self, client: Client, now_us: int) -> None:
        client.send(_command(mavlink.MAV_CMD_REQUEST_MESSAGE, (m.AutopilotVersion.id,)))
        self.deadline_us = min(now_us + RETRY_US, self._end_us)

    def advance(self, client: Client, now_us: int) -> None:
        if now_us >= self._end_us:
            raise LinkError(f"{self._port}: {self._why(client)}")
        if self._met:
            self._ask(client, now_us)
        else:
            self.deadline_us = self._end_us

    def _why(self, client: Client) -> str:
        seconds = f"{self._patience_us / 1e6:g} s"
        if self._met:
            return "the vehicle's heartbeat arrives but it answers nothing; check the way to it"
        if client.others:
            systems = ", ".join(map(str, sorted(client.others)))
            return (
                f"no vehicle of ours (MAVLink system {_VEHICLE_SYSTEM}) in {seconds}, only system {systems}; "
                "check the port"
            )
        if client.heard_us is not None:
            return f"a vehicle is heard, but no heartbeat of it came in {seconds}; check the way to it"
        if client.ground_radio:
            return f"the radio answers, but no vehicle was heard in {seconds}; is it on?"
        if client.codec.bad_bytes:
            return (
                f"no vehicle, {client.codec.bad_bytes} bytes of something else in {seconds}; "
                "check port and baud rate"
            )
        return f"no vehicle, nothing was received in {seconds}; check the port and that the vehicle is on"


class ReadParameters(Task):
    """Result: all parameters on board by name. Raises LinkError where they do not arrive."""

    wants = (m.ParamValue,)

    def __init__(self, patience_us: int = PATIENCE_US) -> None:
        super().__init__()
        self._patience_us = patience_us
        self._values: dict[int, tuple[str, float]] = {}
        self._count: int | None = None
        self._progress_us = 0

    def begin(self, client: Client, now_us: int) -> None:
        self._progress_us = now_us
        self._list(client, now_us)

    def _list(self, client: Client, now_us: int) -> None:
        client.send(m.ParamRequestList(*m.VEHICLE))
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.ParamValue)
        if message.param_index >= message.param_count:
            return
        self._count = message.param_count
        if message.param_index not in self._values:
            self._progress_us = now_us
        self._values[message.param_index] = (message.param_id, _value(message))
        # While the list flows nothing is asked again.
        self.deadline_us = now_us + RETRY_US
        if len(self._values) == self._count:
            self.finish(dict(self._values[index] for index in sorted(self._values)))

    def advance(self, client: Client, now_us: int) -> None:
        if now_us - self._progress_us >= self._patience_us:
            what = "none" if self._count is None else f"{len(self._values)} of {self._count}"
            raise LinkError(f"the vehicle's parameters do not arrive ({what} did); check the link")
        if self._count is None:
            self._list(client, now_us)
            return
        missing = [index for index in range(self._count) if index not in self._values]
        for index in missing[:8]:
            client.send(m.ParamRequestRead(*m.VEHICLE, b"", index))
        self.deadline_us = now_us + RETRY_US


class SetParameter(Task):
    """Result: the value on board. Raises Refused where the vehicle keeps another, LinkError on silence.

    Values are the same where they are in float32. ValueError where it is not finite, or no whole number where
    the table asks for one.
    """

    wants = (m.ParamValue,)

    def __init__(self, name: str, value: float, attempts: int = 10) -> None:
        super().__init__()
        if not 0 < len(name) <= NAME_MAX or not name.isascii():
            raise ValueError(f"a parameter's name has 1 to {NAME_MAX} ASCII characters, not {name!r}")
        self._name = name
        self._value = float32(value)
        self._type = type_of(BY_NAME.get(name))
        self._raw = encode(self._value, self._type)
        self._attempts = attempts

    def begin(self, client: Client, now_us: int) -> None:
        self._said = client.said
        self.advance(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        if self._attempts == 0:
            raise LinkError(f"{self._name} was set but the vehicle does not answer; check the link")
        self._attempts -= 1
        client.send(m.ParamSet(*m.VEHICLE, self._name.encode(), self._raw, self._type))
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.ParamValue)
        if message.param_id != self._name:
            return
        value = _value(message)
        if not isfinite(value) or not equal(value, self._value):
            said = " ".join(client.said_since(self._said))
            raise Refused(f"{self._name} stays {value:g} on board" + (f" ({said})" if said else ""))
        self.finish(value)


class Command(Task):
    """Result: None once the vehicle accepted. Raises Refused with the vehicle's words, LinkError on silence.

    Parameters
    ----------
    number
        MAV_CMD. what: how messages call it. patience_us: how long "not now" is asked again.
    """

    wants = (m.CommandAck,)

    def __init__(
        self, number: int, parameters: tuple[float, ...] = (), *, what: str, patience_us: int = 0
    ) -> None:
        super().__init__()
        self._number = number
        self._parameters = parameters
        self._what = what
        self._patience_us = patience_us
        self._end_us = 0
        self._silent_us = 0
        self._confirmation = 0
        self._refused: int | None = None

    def begin(self, client: Client, now_us: int) -> None:
        self._said = client.said
        self._end_us = now_us + self._patience_us
        self._silent_us = now_us + PATIENCE_US
        self._send(client, now_us)

    def _send(self, client: Client, now_us: int) -> None:
        client.send(_command(self._number, self._parameters, min(self._confirmation, 255)))
        self._confirmation += 1
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.CommandAck)
        if message.command != self._number or self.done:
            return
        self._silent_us = now_us + PATIENCE_US
        if message.result == mavlink.MAV_RESULT_ACCEPTED:
            self.finish()
        elif message.result != mavlink.MAV_RESULT_IN_PROGRESS:
            self._refused = message.result
            self.deadline_us = now_us + TEXT_WAIT_US

    def advance(self, client: Client, now_us: int) -> None:
        if self._refused is not None:
            later = self._refused == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
            if not later or now_us >= self._end_us:
                raise Refused(f"the vehicle refuses to {self._what}: {self._words(client)}")
            self._refused = None
        elif now_us >= self._silent_us:
            raise LinkError(f"the vehicle does not answer when told to {self._what}; check the link")
        self._send(client, now_us)

    def _words(self, client: Client) -> str:
        """Return the reason that the vehicle says with every refusal, unless the radio lost it."""
        said = client.said_since(self._said)
        reasons = [text.partition("refused: ")[2] for text in said if "refused: " in text]
        return (reasons or said or [f"its reason was lost on the way, result {self._refused}"])[-1]


class SendBlob(Task):
    """Result: the UploadSender once the blob is live. Raises Refused, or LinkError on silence."""

    wants = (m.UploadStatus, m.UploadVerdict)

    def __init__(self, blob: bytes, kind: int, *, what: str) -> None:
        super().__init__()
        self.sender = UploadSender(blob, kind)
        self._what = what

    def begin(self, client: Client, now_us: int) -> None:
        self._pump(client, now_us)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        if self.sender.receive(message, now_us):
            self._pump(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        self.sender.advance(now_us)
        self._pump(client, now_us)

    def _pump(self, client: Client, now_us: int) -> None:
        for message in self.sender.send(now_us):
            client.send(message)
        if self.sender.state is SenderState.DONE:
            self.finish(self.sender)
        elif self.sender.over:
            if self.sender.silent:
                raise LinkError(f"{self._what}: {self.sender.reason}; check the link and send it again")
            raise Refused(f"{self._what}: {self.sender.reason.strip()}")
        else:
            self.deadline_us = self.sender.next_deadline_us() or now_us


class AbortBlob(Task):
    """Result: None once the vehicle holds nothing of the blob any more, or does not say so."""

    wants = (m.UploadStatus,)

    def __init__(self, sender: UploadSender, attempts: int = 5) -> None:
        super().__init__()
        self._sender = sender
        self._attempts = attempts
        self._messages: list[Message] = []

    def begin(self, client: Client, now_us: int) -> None:
        self._sender.cancel(now_us)
        self._messages = self._sender.send(now_us)
        self.advance(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        if self._attempts == 0 or not self._messages:  # nothing to abort where the upload was over
            self.finish()
            return
        self._attempts -= 1
        for message in self._messages:
            client.send(message)
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.UploadStatus)
        if message.tag == tag_of(self._sender.digest) and message.state in (
            UploadState.IDLE,
            UploadState.LIVE,
        ):
            self.finish()


def make_live(blob: Blob, what: str) -> Generator[Task, Any, UploadSender]:
    """Yield the sender of a blob that is live now, for scripts; at Ctrl-C the vehicle is told to forget
    it.
    """
    task = SendBlob(blob.to_bytes(), blob.KIND, what=what)
    try:
        return (yield task)
    except KeyboardInterrupt:
        yield AbortBlob(task.sender)
        raise


class FreshStatus(Task):
    """Result: the first FC_STATUS of a vehicle that has booted. Raises LinkError where none arrives."""

    wants = (m.FcStatus,)

    def begin(self, client: Client, now_us: int) -> None:
        self._end_us = now_us + PATIENCE_US
        self.deadline_us = self._end_us

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.FcStatus)
        if message.state != mavlink.TRIMTAB_STATE_BOOT:
            self.finish(message)

    def advance(self, client: Client, now_us: int) -> None:
        raise LinkError("the vehicle reports no status, or never ends booting; check the link")


class SettleClock(Task):
    """Result: None once the clock comparison has settled. Raises LinkError where no answers come."""

    CHECK_US = 10_000

    def begin(self, client: Client, now_us: int) -> None:
        self._end_us = now_us + PATIENCE_US
        self.advance(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        if client.clock.settled:
            self.finish()
        elif now_us >= self._end_us:
            raise LinkError("the vehicle does not answer TIMESYNC; check the link")
        else:
            self.deadline_us = now_us + self.CHECK_US


def _value(message: m.ParamValue) -> float:
    """Return the value that a PARAM_VALUE stands for.

    Raises LinkError where its type is none that we know.
    """
    try:
        return decode(message.param_value, message.param_type)
    except ValueError as error:
        raise LinkError(f"{message.param_id} comes in a type we do not know ({error})") from None


def _command(number: int, parameters: tuple[float, ...] = (), confirmation: int = 0) -> Message:
    values = [float(value) for value in parameters] + [0.0] * (7 - len(parameters))
    return m.CommandLong(*m.VEHICLE, number, confirmation, *values)
