"""Tasks: requests to a vehicle. Each is a small state machine that repeats its request until it is answered.

A task queues messages through the client and receives the types listed in `wants`. It ends with a `result`,
or raises one of `trimtab.host.base.errors` from `receive` or `advance`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from trimtab.host.base.errors import LinkError, Refused
from trimtab.host.link.client import NEVER_US, Client
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.signing import Verdict

PATIENCE_US = 5_000_000
RETRY_US = 300_000
_VEHICLE_SYSTEM = m.VEHICLE[0]
TEXT_WAIT_US = 150_000
"""Time after a refusal in which the status text with the reason may still arrive."""


class Task:
    """Base class of tasks. `deadline_us` is the latest time of the next call of `advance`."""

    wants: tuple[type[Message], ...] = ()

    def __init__(self) -> None:
        self.done = False
        self.result: Any = None
        self.deadline_us = NEVER_US

    def begin(self, client: Client, now_us: int) -> None:
        """Queue the first messages."""
        self.deadline_us = now_us

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        """Process a message of one of the types in `wants`."""

    def advance(self, client: Client, now_us: int) -> None:
        """Act on the time: repeat a request or give up."""

    def finish(self, result: Any = None) -> None:
        """End the task with a result."""
        self.result = result
        self.done = True
        self.deadline_us = NEVER_US


@dataclass(frozen=True, kw_only=True)
class Identity:
    """Identity of a vehicle: id of the vehicle file it was set up with, and uid of its power-up (hex).

    simulated: whether its firmware says that it is; None if the firmware leaves that open.
    """

    vehicle_id: str
    uid: str
    simulated: bool | None = None


class FindVehicle(Task):
    """Find the vehicle at the port. The result is its Identity. Raises LinkError if there is none.

    Parameters
    ----------
    port
        Name of the port in messages.
    accept_signed
        Without a key: also accept a vehicle that signs its messages. It obeys no commands then.
    """

    wants = (m.Heartbeat, m.AutopilotVersion)

    def __init__(self, port: str, patience_us: int = PATIENCE_US, *, accept_signed: bool = False) -> None:
        super().__init__()
        self._port = port
        self._patience_us = patience_us
        self._accept_signed = accept_signed
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
            board = message.board_version
            simulated = None if board == 0 else board == m.SIMULATED_BOARD
            self.finish(Identity(vehicle_id=vehicle_id, uid=f"{uid:016x}", simulated=simulated))

    def _meet(self, client: Client, message: m.Heartbeat, now_us: int) -> None:
        version = m.dialect_version(message)
        if version is None:
            raise LinkError(
                f"{self._port}: this MAVLink vehicle does not speak Trimtab's dialect; check the port, or "
                "fly PX4 and ArduPilot with --autopilot"
            )
        self._check_dialect(version)
        if m.is_signed(message) and client.key is None and not self._accept_signed:
            raise LinkError(
                f"{self._port}: the vehicle obeys only messages that are signed; give its key with --key FILE"
            )
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
        client.send(command_message(mavlink.MAV_CMD_REQUEST_MESSAGE, (m.AutopilotVersion.id,)))
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
            return "the vehicle's heartbeat arrives but it does not answer; check the uplink"
        if client.key is not None and (problem := _key_problem(client, client.key.name)):
            return problem
        if client.others:
            systems = ", ".join(map(str, sorted(client.others)))
            return (
                f"no Trimtab vehicle (MAVLink system {_VEHICLE_SYSTEM}) in {seconds}, only system {systems}; "
                "check the port"
            )
        if client.heard_us is not None:
            return f"a vehicle sends messages, but no heartbeat arrived in {seconds}; check the link"
        if client.ground_radio:
            return f"the radio answers, but no vehicle was heard in {seconds}; is it on?"
        if client.codec.bad_bytes:
            return (
                f"no vehicle, but {client.codec.bad_bytes} bytes that are not MAVLink in {seconds}; "
                "check port and baud rate"
            )
        return f"no vehicle, nothing was received in {seconds}; check the port and that the vehicle is on"


def _key_problem(client: Client, name: str) -> str | None:
    """Return why messages arrived but none was accepted with the key of this name, or None."""
    verifier = client.codec.verifier
    if verifier is None or verifier.counts[Verdict.ACCEPTED]:
        return None
    if verifier.counts[Verdict.BAD_SIGNATURE]:
        return f"the vehicle has another key than {name}; give its own, or install this one by cable"
    if client.unsigned:
        return (
            f"the vehicle has no key; install {name} with `trimtab key install` by cable, or leave out --key"
        )
    return None


class Command(Task):
    """Send a command until the vehicle accepts it.

    Raises Refused with the vehicle's reason, or LinkError if the vehicle does not answer.

    Parameters
    ----------
    number
        MAV_CMD value.
    what
        Name of the action in messages.
    patience_us
        How long to repeat a command that is temporarily rejected.
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
        self._texts_before = client.text_count
        self._end_us = now_us + self._patience_us
        self._silent_us = now_us + PATIENCE_US
        self._send(client, now_us)

    def _send(self, client: Client, now_us: int) -> None:
        client.send(command_message(self._number, self._parameters, min(self._confirmation, 255)))
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
                raise Refused(f"the vehicle refuses to {self._what}: {self._reason(client)}")
            self._refused = None
        elif now_us >= self._silent_us:
            raise LinkError(f"the vehicle does not answer the command to {self._what}; check the link")
        self._send(client, now_us)

    def _reason(self, client: Client) -> str:
        """Return the reason from the vehicle's status text, or the result code if the text was lost."""
        texts = client.texts_since(self._texts_before)
        reasons = [text.partition("refused: ")[2] for text in texts if "refused: " in text]
        return (reasons or texts or [f"the reason was lost on the link, result {self._refused}"])[-1]


class FreshStatus(Task):
    """Wait for an FC_STATUS of a booted vehicle, which is the result. Raises LinkError if none arrives."""

    wants = (m.FcStatus,)

    def begin(self, client: Client, now_us: int) -> None:
        self._end_us = now_us + PATIENCE_US
        self.deadline_us = self._end_us

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.FcStatus)
        if message.state != mavlink.TRIMTAB_STATE_BOOT:
            self.finish(message)

    def advance(self, client: Client, now_us: int) -> None:
        raise LinkError("the vehicle reports no status, or does not finish booting; check the link")


class FreshEstimate(Task):
    """Wait for an FC_ESTIMATE, which is the result. Raises LinkError if none arrives."""

    wants = (m.FcEstimate,)

    def begin(self, client: Client, now_us: int) -> None:
        self.deadline_us = now_us + PATIENCE_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        self.finish(message)

    def advance(self, client: Client, now_us: int) -> None:
        raise LinkError("the vehicle sends no estimate; check the link")


class SettleClock(Task):
    """Wait until the clock comparison has settled. Raises LinkError if no answers come."""

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


def command_message(number: int, parameters: tuple[float, ...] = (), confirmation: int = 0) -> Message:
    """Return COMMAND_LONG for the vehicle; parameters that are not given are 0."""
    values = [float(value) for value in parameters] + [0.0] * (7 - len(parameters))
    return m.CommandLong(*m.VEHICLE, number, confirmation, *values)
