"""Messages that an end with a key accepts without a signature. Everything else must be signed.

Each entry states what an attacker gains by sending the message. Nothing listed here moves the vehicle,
changes what is stored on board, or influences a failsafe.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink
from trimtab.protocol.stream import HEADER_BYTES, message_id

TO_VEHICLE: Mapping[int, str] = MappingProxyType(
    {
        m.Heartbeat.id: "stock telemetry, within its share of the air; the link is not kept alive",
        m.Ping.id: "an echo to the sender",
        m.Timesync.id: "the vehicle's clock to the sender; the vehicle's own clock is never set",
        m.ParamRequestList.id: "the parameters, which are sent at a limited rate",
        m.ParamRequestRead.id: "one parameter",
        m.MissionRequestList.id: "the answer that there are no missions",
        m.SetupSigning.id: "nothing over the radio; a new key over a cable, on the floor",
    }
)
"""Messages to the vehicle by id, with what they give an attacker."""

COMMANDS_TO_VEHICLE: Mapping[int, str] = MappingProxyType(
    {
        mavlink.MAV_CMD_REQUEST_MESSAGE: "one message of telemetry",
        mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: "version and id of the vehicle",
        mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: "an interval; it is not changed",
        mavlink.MAV_CMD_GET_HOME_POSITION: "the home position",
    }
)
"""Commands (COMMAND_LONG, COMMAND_INT) to the vehicle by number, with what they give an attacker."""

TO_HOST: Mapping[int, str] = MappingProxyType(
    {m.RadioStats.id: "wrong counters in the link report; the radios have no key"}
)
"""Messages to the host by id, with what they give an attacker."""

_COMMAND_AT = HEADER_BYTES + 28
"""Place of the command number in COMMAND_LONG and COMMAND_INT."""


def vehicle_accepts(message: bytes) -> bool:
    """Return whether a vehicle with a key accepts this unsigned message."""
    number = message_id(message)
    if number in (m.CommandLong.id, m.CommandInt.id):
        return command_number(message) in COMMANDS_TO_VEHICLE
    return number in TO_VEHICLE


def host_accepts(message: bytes) -> bool:
    """Return whether a host with a key accepts this unsigned message."""
    return message_id(message) in TO_HOST


def command_number(message: bytes) -> int:
    """Return the command in a complete COMMAND_LONG or COMMAND_INT, whose payload may be trimmed."""
    payload_end = HEADER_BYTES + message[1]
    return int.from_bytes(message[_COMMAND_AT : min(_COMMAND_AT + 2, payload_end)], "little")
