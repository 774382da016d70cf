"""Message handlers, one for each message type.

This module handles TIMESYNC, PING, version requests, the origin's place and uploads. Other modules handle
parameters, commands, setpoints, telemetry for other stations, files, and what the vehicle does not have.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.services.absent import AbsentServices
from trimtab.firmware_model.services.commands import Commands
from trimtab.firmware_model.services.files import BlobFiles
from trimtab.firmware_model.services.ftp import FtpServer
from trimtab.firmware_model.services.global_position import gps_global_origin
from trimtab.firmware_model.services.intake import Intake
from trimtab.firmware_model.services.ownership import Ownership
from trimtab.firmware_model.services.parameter_service import ParameterService
from trimtab.firmware_model.services.setpoint_service import SetpointService
from trimtab.firmware_model.services.streams import Streams
from trimtab.firmware_model.services.telemetry import heartbeat
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.upload import ReceiverEvent, UploadReceiver

TEXT_BYTES = 50
SOFTWARE_VERSION = 0x00_02_00_FF
"""AUTOPILOT_VERSION.flight_sw_version: major 0, minor 2, patch 0, type 255 (official)."""

_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT  # a client without it reports a misleading reason
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_FTP
    | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
)


@dataclass(frozen=True, kw_only=True)
class Identity:
    """Identity of a power-up: its unique id, the id (6 B) of the vehicle's file, and the board's version."""

    uid: int
    vehicle_id: bytes
    board_version: int

    def __post_init__(self) -> None:
        if not 0 <= self.uid < 1 << 144:
            raise ValueError(f"uid must have at most 18 bytes, not {self.uid:#x}")
        if len(self.vehicle_id) != 6:
            raise ValueError(f"vehicle_id must have 6 bytes, not {len(self.vehicle_id)}")


@dataclass(frozen=True, kw_only=True)
class Hooks:
    """Functions that the handlers call.

    send: sends a message. status: returns FC_STATUS at a time in us. battery_v: returns the battery voltage.
    on_upload: receives each event of an upload. on_limits: called after a change of the limits that
    references are checked against. on_parameter: receives name and value of a parameter that was set.
    on_reboot: receives the time at which a reboot was accepted.
    on_key_setup: handles SETUP_SIGNING. is_authentic: returns whether a message is signed, or there is no
    key.
    """

    send: Callable[[Message], None]
    status: Callable[[int], Message]
    battery_v: Callable[[], float]
    on_upload: Callable[[ReceiverEvent], None]
    on_limits: Callable[[], None]
    on_parameter: Callable[[str, float], None]
    on_reboot: Callable[[int], None]
    on_key_setup: Callable[[m.SetupSigning, int], None]
    is_authentic: Callable[[Message], bool]


class Handlers:
    """Handlers of received messages.

    `streams` is the telemetry for stations other than Trimtab's host. `ownership` says who may act on the
    vehicle.
    """

    def __init__(
        self,
        *,
        flight: Flight,
        parameters: ParameterValues,
        upload: UploadReceiver,
        store: ReferenceStore,
        identity: Identity,
        hooks: Hooks,
    ) -> None:
        send = hooks.send
        self._flight = flight
        self._upload = upload
        self._identity = identity
        self._send = send
        self._on_upload = hooks.on_upload
        self._intake = Intake()
        self.ownership = Ownership(flight=flight, text=self.text)
        self._is_authentic = hooks.is_authentic
        self._parameter_service = ParameterService(
            flight=flight,
            ownership=self.ownership,
            parameters=parameters,
            send=send,
            text=self.text,
            on_set=hooks.on_parameter,
            on_limits=hooks.on_limits,
        )
        self.streams = Streams(
            flight=flight, send=send, battery_v=hooks.battery_v, may_act=self.ownership.may_act
        )
        files = BlobFiles(store=store, upload=upload, text=self.text, on_upload=self.report_upload)
        self._ftp = FtpServer(files, send=send, may_write=self.ownership.may_act)
        setpoints = SetpointService(take=flight.setpoint, text=self.text)
        commands = self._commands(hooks)
        self._handlers: dict[type, Callable[[Any, int], None]] = {
            m.Timesync: self._timesync,
            m.Ping: self._ping,
            m.SetupSigning: hooks.on_key_setup,
            m.CommandLong: commands.long,
            m.SetPositionTarget: self._from_owner(setpoints.position),
            m.SetAttitudeTarget: self._from_owner(setpoints.attitude),
            m.CommandInt: commands.int,
            m.Heartbeat: self.streams.heartbeat,
            m.RequestDataStream: self.streams.data_stream,
            m.SetGpsGlobalOrigin: self._set_origin,
            **AbsentServices(send).handlers(),
            m.FileTransfer: self._ftp.receive,
            m.ParamRequestList: self._parameter_service.list,
            m.ParamRequestRead: self._parameter_service.read,
            m.ParamSet: self._parameter_service.set,
            m.UploadBegin: self._upload_message,
            m.UploadChunk: self._upload_message,
            m.UploadCommit: self._upload_message,
            m.UploadAbort: self._upload_message,
        }

    def _commands(self, hooks: Hooks) -> Commands:
        """Return the handler of commands."""
        return Commands(
            flight=self._flight,
            ownership=self.ownership,
            upload=self._upload,
            send=self._send,
            text=self.text,
            requests={
                m.AutopilotVersion.id: lambda now_us: self._version(),
                m.FcStatus.id: hooks.status,
                m.Heartbeat.id: lambda now_us: heartbeat(self._flight),
                **self.streams.requests(),
            },
            on_upload=self.report_upload,
            more={
                **self.streams.commands(),
                mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: lambda message, now_us: self._reboot(
                    message, now_us, hooks.on_reboot
                ),
            },
        )

    def receive(self, message: Message, now_us: int) -> None:
        """Handle a message that addresses this vehicle. Unknown types are ignored."""
        if message.get_srcSystem() == m.VEHICLE[0]:
            return
        target = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if target not in (0, m.VEHICLE[0]) or component not in (0, m.VEHICLE[1]):
            return
        station = m.sender_of(message)
        authentic = self._is_authentic(message)
        if authentic:
            self.ownership.hear(station, now_us)
        other = not authentic or not self.ownership.takes_part(station)
        if not self._intake.admit(message, now_us, other=other):
            return
        handler = self._handlers.get(type(message))
        if handler is not None:
            handler(message, now_us)

    def _from_owner(self, take: Callable[[Any, int], None]) -> Callable[[Any, int], None]:
        """Return a handler that passes on the setpoints of stations that may send them."""

        def handle(message: Any, now_us: int) -> None:
            if self.ownership.admit_setpoint(m.sender_of(message)):
                take(message, now_us)

        return handle

    def update(self, now_us: int) -> None:
        """Send the messages that are due: parameter lists, telemetry, files and upload reports."""
        self._parameter_service.update()
        self.streams.update(now_us)
        self._ftp.update(now_us)
        deadline_us = self._upload.next_deadline_us()
        if deadline_us is not None and now_us >= deadline_us:
            self.report_upload(self._upload.advance(now_us), now_us)

    def text(self, severity: int, text: str) -> None:
        """Send `text` as STATUSTEXT messages of at most TEXT_BYTES."""
        for line in textwrap.wrap(text, TEXT_BYTES):
            self._send(m.StatusText(severity, line.encode("ascii", errors="replace")))

    def report_upload(self, events: list[ReceiverEvent], now_us: int) -> None:
        """Report the events of an upload to the owner and send its answers."""
        for event in events:
            self._on_upload(event)
        for answer in self._upload.send(now_us):
            self._send(answer)

    # Small services.

    def _reboot(self, message: m.CommandLong, now_us: int, on_reboot: Callable[[int], None]) -> int:
        """Reboot for param1 = 1, only while disarmed. 0 does nothing; a shutdown is not supported."""
        if message.param1 == 0.0:
            return mavlink.MAV_RESULT_ACCEPTED
        if message.param1 != 1.0:
            return mavlink.MAV_RESULT_UNSUPPORTED
        if self._flight.state not in (State.BOOT, State.STANDBY):
            self.text(mavlink.MAV_SEVERITY_WARNING, f"reboot refused: {self._flight.state.name.lower()}")
            return mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        self.text(mavlink.MAV_SEVERITY_NOTICE, "rebooting")
        on_reboot(now_us)
        return mavlink.MAV_RESULT_ACCEPTED

    def _timesync(self, message: m.Timesync, now_us: int) -> None:
        if message.tc1 == 0:
            self._send(m.Timesync(1000 * now_us, message.ts1))

    def _ping(self, message: m.Ping, now_us: int) -> None:
        if message.target_system == 0:
            self._send(m.Ping(message.time_usec, message.seq, *m.sender_of(message)))

    def _set_origin(self, message: m.SetGpsGlobalOrigin, now_us: int) -> None:
        place = (message.latitude, message.longitude, message.altitude)
        self._parameter_service.set_origin(place, m.sender_of(message), now_us)
        self._send(gps_global_origin(self._flight, now_us, 0.0))

    def _version(self) -> Message:
        identity = self._identity
        return m.AutopilotVersion(
            _CAPABILITIES,
            SOFTWARE_VERSION,
            0,
            0,
            identity.board_version,
            list(identity.vehicle_id + bytes(2)),
            [0] * 8,
            [0] * 8,
            m.VENDOR_ID,
            m.DIALECT_VERSION,
            identity.uid & (1 << 64) - 1,
            list(identity.uid.to_bytes(18, "little")),
        )

    # Uploads.

    def _upload_message(self, message: Message, now_us: int) -> None:
        if self.ownership.admit(m.sender_of(message), "upload"):
            self.report_upload(self._upload.receive(message, now_us), now_us)
