"""Tasks before another autopilot flies: find it, check it, ask a person, choose its mode."""

from __future__ import annotations

from typing import Any

from trimtab.host.autopilot.checks import problems
from trimtab.host.autopilot.flight import SETPOINT_US
from trimtab.host.autopilot.kinds import AutopilotKind
from trimtab.host.autopilot.setpoints import Setpoint
from trimtab.host.autopilot.situation import Situation
from trimtab.host.base.errors import FlightFailed, LinkError, Refused, UsageError
from trimtab.host.link.client import Client
from trimtab.host.link.flight_request import Ask
from trimtab.host.link.tasks import PATIENCE_US, RETRY_US, Task, command_message
from trimtab.host.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import Message, mavlink

INTERVALS_US: dict[int, int] = {
    m.LocalPositionNed.id: 50_000,
    m.Attitude.id: 50_000,
    m.SysStatus.id: 500_000,
    m.ExtendedSysState.id: 500_000,
}
"""Intervals of messages that the host asks for, by message id."""
ASK_US = 1_000_000
"""Interval of these requests until all of these messages arrive."""
READY_US = 1_000_000
"""Time for which nothing may speak against arming."""
READY_MAX_US = 15_000_000
"""Longest wait for that."""
LEAD_US = 1_200_000
"""Time of streaming before the mode is chosen; PX4 wants more than a second."""


class FindAutopilot(Task):
    """Find the autopilot at the port. Raises LinkError if there is none, UsageError for another make."""

    wants = (m.Heartbeat,)

    def __init__(self, situation: Situation, port: str) -> None:
        super().__init__()
        self._situation, self._port = situation, port

    def begin(self, client: Client, now_us: int) -> None:
        self.deadline_us = now_us + PATIENCE_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.Heartbeat)
        kind = self._situation.kind
        if m.dialect_version(message) is not None:
            raise UsageError(
                f"{self._port}: this is a vehicle of Trimtab's own firmware, not {kind.title}; "
                "leave out --autopilot"
            )
        if message.autopilot != kind.number:
            raise UsageError(
                f"{self._port}: the autopilot is number {message.autopilot} of MAV_AUTOPILOT, not "
                f"{kind.number} ({kind.title}); give the right --autopilot"
            )
        self._situation.receive(message, now_us)
        self.finish()

    def advance(self, client: Client, now_us: int) -> None:
        seconds = f"{PATIENCE_US / 1e6:g} s"
        if client.others:
            systems = ", ".join(map(str, sorted(client.others)))
            why = f"only MAVLink system {systems}; set its system id to {m.VEHICLE[0]}"
        elif client.codec.bad_bytes:
            why = f"but {client.codec.bad_bytes} other bytes; check port and baud rate, and choose MAVLink 2"
        else:
            why = "nothing was received; check the port and that it is on"
        raise LinkError(f"{self._port}: no autopilot in {seconds}, {why}")


class AwaitReady(Task):
    """Wait until nothing speaks against arming for READY_US. Raises Refused with the problem if that fails.

    Meanwhile asks for the messages that the flight needs.

    Parameters
    ----------
    patience_us
        Longest wait. 0: the first problem refuses.
    """

    CHECK_US = 50_000
    wants = Situation.wants

    def __init__(
        self,
        situation: Situation,
        reference: Reference,
        vehicle: Vehicle,
        patience_us: int = READY_MAX_US,
    ) -> None:
        super().__init__()
        self._situation, self._reference, self._vehicle = situation, reference, vehicle
        self._patience_us = patience_us

    def begin(self, client: Client, now_us: int) -> None:
        self._end_us = now_us + self._patience_us
        self._ask_us = self.deadline_us = self._problem_us = now_us

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        self._situation.receive(message, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        problem = next(problems(self._situation, self._reference, self._vehicle, now_us), None)
        if problem is not None:
            self._problem_us = now_us
        if now_us - self._problem_us >= READY_US:
            self.finish()
            return
        if problem is not None and now_us >= self._end_us:
            raise Refused(f"not armed: {problem}")
        if now_us >= self._ask_us:
            self._ask_us = now_us + ASK_US
            for number, interval_us in INTERVALS_US.items():
                client.send(command_message(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (number, interval_us)))
            if self._situation.simulated is None:
                client.send(command_message(mavlink.MAV_CMD_REQUEST_MESSAGE, (m.AutopilotVersion.id,)))
        self.deadline_us = now_us + self.CHECK_US


class Confirm(Task):
    """Wait for a person's answer. Raises FlightFailed if it is no."""

    CHECK_US = 50_000
    wants = Situation.wants

    def __init__(self, situation: Situation, ask: Ask, lines: tuple[str, ...]) -> None:
        super().__init__()
        self._situation, self._ask, self._lines = situation, ask, lines

    def begin(self, client: Client, now_us: int) -> None:
        self._answer = self._ask(self._lines)
        self.deadline_us = now_us

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        self._situation.receive(message, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        answer = self._answer()
        if answer is None:
            self.deadline_us = now_us + self.CHECK_US
        elif answer:
            self.finish()
        else:
            raise FlightFailed("not armed: the flight was not confirmed")


class ChooseMode(Task):
    """Choose the mode in which the autopilot follows setpoints. Raises Refused if it does not take it.

    For an autopilot that climbs by setpoints, run this within `Guarded`.
    """

    wants = (*Situation.wants, m.CommandAck)

    def __init__(self, situation: Situation) -> None:
        super().__init__()
        self._situation = situation

    def begin(self, client: Client, now_us: int) -> None:
        self._texts_before = client.text_count
        self._result: int | None = None
        self._end_us = now_us + LEAD_US + PATIENCE_US
        self.deadline_us = now_us + LEAD_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        if isinstance(message, m.CommandAck):
            if message.command == mavlink.MAV_CMD_DO_SET_MODE:
                self._result = message.result
            return
        self._situation.receive(message, now_us)
        accepted = self._result in (None, mavlink.MAV_RESULT_ACCEPTED)
        if self._situation.streamed and accepted and now_us >= self._end_us - PATIENCE_US:
            self.finish()

    def advance(self, client: Client, now_us: int) -> None:
        if now_us >= self._end_us:
            kind = self._situation.kind
            wanted = kind.mode_name(kind.streamed_mode)
            texts = client.texts_since(self._texts_before)
            why = texts[-1] if texts else f"it stays in {self._situation.mode_name()}"
            raise Refused(f"not armed: the autopilot does not go to {wanted}: {why}")
        client.send(command_message(mavlink.MAV_CMD_DO_SET_MODE, self._situation.kind.set_streamed_mode))
        self.deadline_us = min(now_us + RETRY_US, self._end_us)


class Guarded(Task):
    """Another task before or while the autopilot is armed, with all checks going on.

    Raises Refused on the first problem, or if the autopilot goes to a mode that the host did not choose: a
    pilot has it.

    Parameters
    ----------
    arming
        Whether the inner task arms. The autopilot must then be in the mode that follows setpoints, and the
        task also ends when a heartbeat says that it is armed.
    streams
        Whether to stream setpoints that hold the present pose.
    """

    def __init__(
        self,
        inner: Task,
        situation: Situation,
        reference: Reference,
        vehicle: Vehicle,
        *,
        arming: bool,
        streams: bool,
    ) -> None:
        super().__init__()
        self.wants = (*{*inner.wants, *Situation.wants},)
        self._inner, self._situation = inner, situation
        self._reference, self._vehicle = reference, vehicle
        self._arming, self._streams = arming, streams

    def begin(self, client: Client, now_us: int) -> None:
        pose = self._situation.pose
        assert pose is not None  # a check before this
        self._target = Setpoint(pose.p_ned, yaw=pose.yaw)
        self._next_us = now_us
        self._modes = {self._situation.kind.streamed_mode}
        if not self._arming and self._situation.mode is not None:
            self._modes.add(self._situation.mode)
        self._inner.begin(client, now_us)
        self._follow()

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        if isinstance(message, Situation.wants):
            self._situation.receive(message, now_us)
            if self._situation.mode not in self._modes:
                raise Refused(f"not armed: the autopilot went to {self._situation.mode_name()}")
        if self._arming and self._situation.armed:  # the acknowledgement may be lost
            self.finish()
            return
        if isinstance(message, self._inner.wants):
            self._inner.receive(client, message, now_us)
        self._follow()

    def advance(self, client: Client, now_us: int) -> None:
        situation = self._situation
        found = problems(situation, self._reference, self._vehicle, now_us, arming=self._arming)
        if (problem := next(found, None)) is not None:
            raise Refused(f"not armed: {problem}")
        if now_us >= self._next_us:
            self._next_us = now_us + SETPOINT_US
            if self._streams:
                client.send(self._target.message(now_us))
        if now_us >= self._inner.deadline_us:
            self._inner.advance(client, now_us)
        self._follow()

    def _follow(self) -> None:
        """Take over the result of the inner task, or its deadline if it comes first."""
        inner: Any = self._inner
        if inner.done:
            self.finish(inner.result)
        else:
            self.deadline_us = min(self._next_us, inner.deadline_us)


def confirmation_lines(
    kind: AutopilotKind, port: str, vehicle: Vehicle, reference: Reference, height_m: float
) -> tuple[str, ...]:
    """Return what a person is told before arming."""
    return (
        f"{kind.title} at {port} is ready: {vehicle.name}, reference {reference.id}, "
        f"{1e-6 * reference.duration_us:.1f} s, {height_m:.1f} m above the floor at its highest.",
        "Keep a remote control in hand that takes over by its mode switch. Ctrl-C lands the vehicle.",
    )
