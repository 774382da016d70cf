"""Services that the vehicle does not have: missions, logs on board, a shell. Requests end at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink

_NO_SHELL = b"no shell on this vehicle; use its parameters and commands\n"
_DATA_BYTES = 70


class AbsentServices:
    """Handlers that answer requests of these services.

    Parameters
    ----------
    send
        Sends a message.
    """

    def __init__(self, send: Callable[[Message], None]) -> None:
        self._send = send

    def handlers(self) -> dict[type, Callable[[Any, int], None]]:
        """Return the handlers by message type. Each gets a message and the time."""
        return {
            m.MissionRequestList: self._mission_list,
            m.MissionCount: self._mission_upload,
            m.MissionClearAll: self._mission_clear,
            m.LogRequestList: self._log_list,
            m.SerialControl: self._serial,
        }

    def _mission_list(self, message: m.MissionRequestList, now_us: int) -> None:
        self._send(m.MissionCount(*m.sender_of(message), 0, message.mission_type))

    def _mission_upload(self, message: m.MissionCount, now_us: int) -> None:
        """Refuse a mission, geofence or list of rally points before its first item."""
        self._send(m.MissionAck(*m.sender_of(message), mavlink.MAV_MISSION_UNSUPPORTED, message.mission_type))

    def _mission_clear(self, message: m.MissionClearAll, now_us: int) -> None:
        self._send(m.MissionAck(*m.sender_of(message), mavlink.MAV_MISSION_ACCEPTED, message.mission_type))

    def _log_list(self, message: m.LogRequestList, now_us: int) -> None:
        self._send(m.LogEntry(0, 0, 0, 0, 0))

    def _serial(self, message: m.SerialControl, now_us: int) -> None:
        """Answer a line for the shell, or for any other device, that there is none."""
        if message.count == 0 or message.flags & mavlink.SERIAL_CONTROL_FLAG_REPLY:
            return
        reply, data = mavlink.SERIAL_CONTROL_FLAG_REPLY, list(_NO_SHELL.ljust(_DATA_BYTES, b"\0"))
        target = m.sender_of(message)
        self._send(m.SerialControl(message.device, reply, 0, 0, len(_NO_SHELL), data, *target))
