"""What the vehicle answers: commands, parameters, clock comparison, version, echo, uploads.

One handler a message type. Handlers return nothing; their answers go out through `send`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from firmware_model.flight import Flight
from firmware_model.parameters import ParameterValues, index_of, name_at
from firmware_model.supervisor import Event, State
from firmware_model.telemetry import heartbeat
from protocol import messages as m
from protocol.messages import Message, mavlink
from protocol.upload import ReceiverEvent, UploadReceiver

VALUES_PER_LOOK = 2
"""PARAM_VALUEs sent at each look while a list goes out: 200 a second."""
TEXT_BYTES = 50
SOFTWARE_VERSION = 0x00_01_00_FF
"""0.1.0, official."""

_ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
_NOT_NOW = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
_UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
_FAILED = mavlink.MAV_RESULT_FAILED
_WARNING = mavlink.MAV_SEVERITY_WARNING
_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
)


@dataclass(frozen=True, kw_only=True)
class Identity:
    """Who this is: uid of the power-up, id of the vehicle file it was set up for (6 B)."""

    uid: int
    vehicle_id: bytes

    def __post_init__(self) -> None:
        if not 0 <= self.uid < 1 << 144:
            raise ValueError(f"uid must have at most 18 bytes, not {self.uid:#x}")
        if len(self.vehicle_id) != 6:
            raise ValueError(f"vehicle_id must have 6 bytes, not {len(self.vehicle_id)}")


class Services:
    """Handlers of what arrives.

    Args:
        send: puts a message on the line. on_upload: is told what became of uploads; on_limits: that what
        references are checked by has changed.
        status: the present FC_STATUS.
    """

    def __init__(
        self,
        *,
        flight: Flight,
        parameters: ParameterValues,
        upload: UploadReceiver,
        identity: Identity,
        send: Callable[[Message], None],
        status: Callable[[int], Message],
        on_upload: Callable[[ReceiverEvent], None],
        on_limits: Callable[[], None],
    ) -> None:
        self._flight = flight
        self._parameters = parameters
        self._upload = upload
        self._identity = identity
        self._send = send
        self._status = status
        self._on_upload = on_upload
        self._on_limits = on_limits
        self._listing: deque[int] = deque()
        self._handlers: dict[type, Callable[[Any, int], None]] = {
            m.Timesync: self._timesync,
            m.Ping: self._ping,
            m.CommandLong: self._command,
            m.ParamRequestList: self._param_list,
            m.ParamRequestRead: self._param_read,
            m.ParamSet: self._param_set,
            m.UploadBegin: self._upload_message,
            m.UploadChunk: self._upload_message,
            m.UploadCommit: self._upload_message,
            m.UploadAbort: self._upload_message,
        }
        self._commands: dict[int, Callable[[Any, int], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            mavlink.MAV_CMD_MISSION_START: lambda _, now_us: self._event(Event.START, now_us),
            mavlink.MAV_CMD_NAV_LAND: lambda _, now_us: self._event(Event.LAND, now_us),
            mavlink.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._request_version,
            mavlink.MAV_CMD_USER_1: self._commit,
        }

    def receive(self, message: Message, now_us: int) -> None:
        """Nothing comes back; the message has been handled if it is for this vehicle and of a known kind."""
        if message.get_srcSystem() == m.VEHICLE[0]:
            return
        target = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if target not in (0, m.VEHICLE[0]) or component not in (0, m.VEHICLE[1]):
            return
        self._flight.host_heard(now_us)
        handler = self._handlers.get(type(message))
        if handler is not None:
            handler(message, now_us)

    def look(self, now_us: int) -> None:
        """Nothing comes back; sends what is due: list entries, upload reports."""
        for _ in range(min(VALUES_PER_LOOK, len(self._listing))):
            self._send_value(self._listing.popleft())
        deadline_us = self._upload.next_deadline_us()
        if deadline_us is not None and now_us >= deadline_us:
            self._take(self._upload.advance(now_us), now_us)

    def text(self, severity: int, text: str) -> None:
        """Nothing comes back; people read `text`, or its first 50 bytes."""
        data = text.encode()[:TEXT_BYTES].decode(errors="ignore").encode()
        self._send(m.StatusText(severity, data))

    # Small services.

    def _timesync(self, message: m.Timesync, now_us: int) -> None:
        if message.tc1 == 0:
            self._send(m.Timesync(1000 * now_us, message.ts1))

    def _ping(self, message: m.Ping, now_us: int) -> None:
        if message.target_system == 0:
            asker = (message.get_srcSystem(), message.get_srcComponent())
            self._send(m.Ping(message.time_usec, message.seq, *asker))

    def _version(self) -> Message:
        identity = self._identity
        return m.AutopilotVersion(
            _CAPABILITIES,
            SOFTWARE_VERSION,
            0,
            0,
            0,
            list(identity.vehicle_id + bytes(2)),
            [0] * 8,
            [0] * 8,
            m.VENDOR_ID,
            m.DIALECT_VERSION,
            identity.uid & (1 << 64) - 1,
            list(identity.uid.to_bytes(18, "little")),
        )

    # Parameters.

    def _param_list(self, message: m.ParamRequestList, now_us: int) -> None:
        self._listing = deque(range(len(self._parameters)))

    def _param_read(self, message: m.ParamRequestRead, now_us: int) -> None:
        index = message.param_index if message.param_index >= 0 else index_of(message.param_id)
        if index is not None and name_at(index) is not None:
            self._send_value(index)

    def _param_set(self, message: m.ParamSet, now_us: int) -> None:
        """Set in standby alone; the answer is the value on board, whatever became of the request."""
        name = message.param_id
        index = index_of(name)
        if index is None:
            self.text(_WARNING, f"no parameter {name}")
            return
        if self._flight.state is not State.STANDBY:
            self.text(_WARNING, f"{name} kept: set in standby only")
        else:
            self._set(name, message.param_value)
        self._send_value(index)

    def _set(self, name: str, value: float) -> None:
        parameters = self._parameters
        before = (parameters.airframe, parameters.limits)
        try:
            parameters.set(name, value)
        except ValueError as error:
            self.text(_WARNING, str(error))
            return
        self._flight.configure()
        if (parameters.airframe, parameters.limits) != before:
            self._on_limits()

    def _send_value(self, index: int) -> None:
        name = name_at(index)
        if name is not None:
            value, count = self._parameters[name], len(self._parameters)
            self._send(m.ParamValue(name.encode(), value, _REAL32, count, index))

    # Commands.

    def _command(self, message: m.CommandLong, now_us: int) -> None:
        act = self._commands.get(message.command)
        result = _UNSUPPORTED if act is None else act(message, now_us)
        asker = (message.get_srcSystem(), message.get_srcComponent())
        self._send(m.CommandAck(message.command, result, 0, 0, *asker))

    def _event(self, event: Event, now_us: int) -> int:
        reason = self._flight.command(event, now_us)
        if reason is None:
            return _ACCEPTED
        self.text(_WARNING, f"{event.name.lower()} refused: {reason}")
        return _NOT_NOW

    def _arm(self, message: m.CommandLong, now_us: int) -> int:
        if message.param1 > 0.5:
            return self._event(Event.ARM, now_us)
        return self._event(Event.KILL if message.param2 == m.FORCE else Event.DISARM, now_us)

    def _terminate(self, message: m.CommandLong, now_us: int) -> int:
        return self._event(Event.KILL, now_us) if message.param1 > 0.5 else _ACCEPTED

    def _request(self, message: m.CommandLong, now_us: int) -> int:
        wanted = message.param1
        if wanted == m.AutopilotVersion.id:
            self._send(self._version())
        elif wanted == m.FcStatus.id:
            self._send(self._status(now_us))
        elif wanted == m.Heartbeat.id:
            self._send(heartbeat(self._flight))
        else:
            return _UNSUPPORTED
        return _ACCEPTED

    def _request_version(self, message: m.CommandLong, now_us: int) -> int:
        self._send(self._version())
        return _ACCEPTED

    def _commit(self, message: m.CommandLong, now_us: int) -> int:
        """Commit by MAV_CMD_USER_1: the id's 12 hex digits as three 16-bit numbers."""
        parts = (message.param1, message.param2, message.param3)
        if not all(math.isfinite(part) and 0 <= part <= 0xFFFF for part in parts):
            return mavlink.MAV_RESULT_DENIED
        id_bytes = b"".join(int(part).to_bytes(2, "big") for part in parts)
        result, events = self._upload.commit(id_bytes, now_us)
        self._take(events, now_us)
        if result is m.UploadResult.OK:
            return _ACCEPTED
        return _NOT_NOW if result is m.UploadResult.BUSY else _FAILED

    # Uploads.

    def _upload_message(self, message: Message, now_us: int) -> None:
        self._take(self._upload.receive(message, now_us), now_us)

    def _take(self, events: list[ReceiverEvent], now_us: int) -> None:
        for event in events:
            self._on_upload(event)
        for answer in self._upload.send(now_us):
            self._send(answer)
