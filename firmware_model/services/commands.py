"""Command messages. COMMAND_ACK answers each command; a text gives the reason of a refusal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.phases import TAKEOFF_HEIGHT_MIN
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.services.ownership import Ownership
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.upload import ReceiverEvent, UploadReceiver

_ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
_NOT_NOW = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
_UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
_FAILED = mavlink.MAV_RESULT_FAILED
_WARNING = mavlink.MAV_SEVERITY_WARNING
_LOCAL_FRAMES = (
    mavlink.MAV_FRAME_LOCAL_NED,
    mavlink.MAV_FRAME_LOCAL_OFFSET_NED,
    mavlink.MAV_FRAME_BODY_NED,
)

_CUSTOM_MODE = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_MODES: dict[tuple[float, float | None], Event] = {
    (4.0, 3.0): Event.HOLD,
    (4.0, 6.0): Event.LAND,
    (6.0, None): Event.OFFBOARD,
    (9.0, 0.0): Event.LAND,
}
"""Events by PX4 main mode and sub mode; None stands for any sub mode. 9 is ArduCopter's LAND."""

Outcome = int | tuple[int, Message]
"""MAV_RESULT of a command, or MAV_RESULT and the message that the command asks for."""


class Commands:
    """Handlers of COMMAND_LONG and COMMAND_INT.

    Parameters
    ----------
    send
        Sends a message.
    text
        Sends severity and text to the host.
    requests
        Functions that make the messages for MAV_CMD_REQUEST_MESSAGE, by message id.
    on_upload
        Receives the events of a commit, and the time.
    more
        Handlers of further commands; each returns its outcome, given the message and the time.
    """

    def __init__(
        self,
        *,
        flight: Flight,
        ownership: Ownership,
        upload: UploadReceiver,
        send: Callable[[Message], None],
        text: Callable[[int, str], None],
        requests: Mapping[float, Callable[[int], Message]],
        on_upload: Callable[[list[ReceiverEvent], int], None],
        more: Mapping[int, Callable[[Any, int], Outcome]],
    ) -> None:
        self._flight = flight
        self._ownership = ownership
        self._upload = upload
        self._send = send
        self._text = text
        self._requests = requests
        self._on_upload = on_upload
        self._commands: dict[int, Callable[[Any, int], Outcome]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            mavlink.MAV_CMD_RUN_PREARM_CHECKS: self._check,
            mavlink.MAV_CMD_MISSION_START: lambda message, now_us: self._event(Event.START, message, now_us),
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_DO_SET_MODE: self._set_mode,
            mavlink.MAV_CMD_NAV_LAND: lambda message, now_us: self._event(Event.LAND, message, now_us),
            mavlink.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._request_version,
            mavlink.MAV_CMD_USER_1: self._commit,
            **more,
        }

    def long(self, message: m.CommandLong, now_us: int) -> None:
        """Execute or refuse a command, and acknowledge it. The message that it requests follows."""
        act = self._commands.get(message.command)
        outcome = _UNSUPPORTED if act is None else act(message, now_us)
        result, answer = outcome if isinstance(outcome, tuple) else (outcome, None)
        self._send(m.CommandAck(message.command, result, 0, 0, *m.sender_of(message)))
        if answer is not None:
            self._send(answer)

    def int(self, message: m.CommandInt, now_us: int) -> None:
        """Handle COMMAND_INT like COMMAND_LONG. x and y are 1e-4 m in a local frame, else ignored."""
        position = (math.nan, math.nan)
        if message.frame in _LOCAL_FRAMES:
            position = (1e-4 * message.x, 1e-4 * message.y)
        first = (message.param1, message.param2, message.param3, message.param4)
        target = (message.target_system, message.target_component)
        long = m.CommandLong(*target, message.command, 0, *first, *position, message.z)
        long._header.srcSystem, long._header.srcComponent = m.sender_of(message)
        self.long(long, now_us)

    def _event(
        self,
        event: Event,
        message: m.CommandLong,
        now_us: int,
        height_m: float | None = None,
        *,
        terminates: bool = False,
    ) -> int:
        station = m.sender_of(message)
        reason = self._ownership.refusal(event, station, now_us, terminates=terminates)
        if reason is None:
            reason = self._flight.handle_event(event, now_us, height_m, station)
        if reason is None:
            return _ACCEPTED
        self._text(_WARNING, f"{event.name.lower()} refused: {reason}")
        return _NOT_NOW

    def _arm(self, message: m.CommandLong, now_us: int) -> int:
        if not math.isfinite(message.param1):
            return mavlink.MAV_RESULT_DENIED
        if message.param1 > 0.5:
            return self._event(Event.ARM, message, now_us)
        return self._event(Event.KILL if message.param2 == m.FORCE else Event.DISARM, message, now_us)

    def _check(self, message: m.CommandLong, now_us: int) -> int:
        """Report every reason why arming would be refused, as texts."""
        if self._flight.state is not State.STANDBY:
            self._text(_WARNING, f"not in standby: {self._flight.state.name.lower()}")
            return _NOT_NOW
        reasons = self._flight.arming_reasons(now_us)
        for reason in reasons:
            self._text(_WARNING, f"not ready: {reason}")
        if not reasons:
            self._text(mavlink.MAV_SEVERITY_INFO, "ready to arm")
        return _NOT_NOW if reasons else _ACCEPTED

    def _take_off(self, message: m.CommandLong, now_us: int) -> int:
        height = message.param7
        if math.isnan(height) or height == 0.0:
            return self._event(Event.TAKEOFF, message, now_us)
        if not TAKEOFF_HEIGHT_MIN <= height < math.inf:
            return mavlink.MAV_RESULT_DENIED
        return self._event(Event.TAKEOFF, message, now_us, height)

    def _set_mode(self, message: m.CommandLong, now_us: int) -> int:
        named = bool(math.isfinite(message.param1) and int(message.param1) & _CUSTOM_MODE)
        event = _MODES.get((message.param2, message.param3)) or _MODES.get((message.param2, None))
        return self._event(event, message, now_us) if named and event is not None else _UNSUPPORTED

    def _terminate(self, message: m.CommandLong, now_us: int) -> int:
        if not message.param1 > 0.5:
            return _ACCEPTED
        return self._event(Event.KILL, message, now_us, terminates=True)

    def _request(self, message: m.CommandLong, now_us: int) -> Outcome:
        make = self._requests.get(message.param1)
        return _UNSUPPORTED if make is None else (_ACCEPTED, make(now_us))

    def _request_version(self, message: m.CommandLong, now_us: int) -> Outcome:
        return _ACCEPTED, self._requests[m.AutopilotVersion.id](now_us)

    def _commit(self, message: m.CommandLong, now_us: int) -> int:
        """Commit the staged blob by MAV_CMD_USER_1, which has the 12 hex digits of its id as three uint16."""
        if not self._ownership.admit(m.sender_of(message), "commit"):
            return _NOT_NOW
        parts = (message.param1, message.param2, message.param3)
        if not all(math.isfinite(part) and 0 <= part <= 0xFFFF for part in parts):
            return mavlink.MAV_RESULT_DENIED
        id_bytes = b"".join(int(part).to_bytes(2, "big") for part in parts)
        result, events = self._upload.commit(id_bytes, now_us)
        self._on_upload(events, now_us)
        if result is m.UploadResult.OK:
            return _ACCEPTED
        return _NOT_NOW if result is m.UploadResult.BUSY else _FAILED
