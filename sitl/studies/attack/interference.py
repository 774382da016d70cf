"""Kinds of interference: what a stranger sends to take a flight over, end it or change what is flown."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.parameter_wire import REAL32
from trimtab.protocol.parameters import BY_NAME
from trimtab.protocol.telemetry import decode_quaternion
from trimtab.sitl.studies.attack.stranger import Stranger

DELAY_US = 1_000_000
"""Time after the begin of tracking at which a stranger begins."""
REPEAT_US = 200_000
"""Interval at which a command is repeated, until it has been sent COMMANDS times."""
COMMANDS = 5
TARGET_NED = (2.5, 2.5, -2.5)
"""Setpoint of a stranger."""
AHEAD_US = 30_000
"""How far a stranger stamps its poses ahead of the vehicle's clock."""
DRIFT_M_S = 2.0
"""Speed at which a stranger's poses drift away, north."""
_OFFBOARD = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), 6.0)
_HOLD = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), 4.0, 3.0)
_POSITION_ONLY = 0b1011_1111_1000

Act = Callable[[Stranger], list[Message]]


def _tracked_us(stranger: Stranger) -> int:
    """Return for how long the vehicle has tracked; negative if it does not or did not."""
    status = stranger.status
    if status is None or status.reference_tick == m.NO_TICK:
        return -1
    return (status.tick - status.reference_tick) * 1000 if status.state > 1 else -1


def command(number: int, *values: float) -> Act:
    """Return what sends a command COMMANDS times, DELAY_US after tracking began."""
    sent: list[int] = []

    def act(stranger: Stranger) -> list[Message]:
        waiting = sent and stranger.now_us - sent[-1] < REPEAT_US
        if _tracked_us(stranger) < DELAY_US or len(sent) >= COMMANDS or waiting:
            return []
        sent.append(stranger.now_us)
        padded = (*values, *(0.0,) * (7 - len(values)))
        return [m.CommandLong(*m.VEHICLE, number, 0, *padded)]

    return act


def offboard(stranger: Stranger) -> list[Message]:
    """Stream setpoints to TARGET_NED and command OFFBOARD again and again."""
    tracked_us = _tracked_us(stranger)
    if tracked_us < DELAY_US:
        return []
    zeros = (0.0,) * 8
    setpoint = m.SetPositionTarget(
        0, *m.VEHICLE, mavlink.MAV_FRAME_LOCAL_NED, _POSITION_ONLY, *TARGET_NED, *zeros
    )
    messages: list[Message] = [setpoint]
    if tracked_us > DELAY_US + 600_000 and tracked_us % REPEAT_US < 10_000:
        messages.append(m.CommandLong(*m.VEHICLE, mavlink.MAV_CMD_DO_SET_MODE, 0, *_OFFBOARD, *(0.0,) * 5))
    return messages


def poses(stranger: Stranger) -> list[Message]:
    """Send poses that drift north, stamped AHEAD_US ahead of the vehicle's clock."""
    estimate, tracked_us = stranger.estimate, _tracked_us(stranger)
    if tracked_us < DELAY_US or estimate is None:
        return []
    north, east, down = estimate.p
    away = DRIFT_M_S * 1e-6 * min(tracked_us - DELAY_US, 200_000)
    t_us = estimate.tick * 1000 + AHEAD_US
    return [m.AttPosMocap(t_us, decode_quaternion(estimate.q), north + away, east, down)]


def parameter(name: str, value: float) -> Act:
    """Return what sets a parameter twice a second, in standby too."""

    def act(stranger: Stranger) -> list[Message]:
        if stranger.now_us % 500_000 >= 10_000:
            return []
        return [m.ParamSet(*m.VEHICLE, name.encode(), value, REAL32)]

    return act


def upload_abort(stranger: Stranger) -> list[Message]:
    """Abort the live and the staged blob while the vehicle tracks."""
    status = stranger.status
    if _tracked_us(stranger) < DELAY_US or status is None:
        return []
    digest = bytes(status.reference_id) + bytes(26)
    return [m.UploadAbort(m.VEHICLE[0], digest)]


def upload_swap(stranger: Stranger) -> list[Message]:
    """Begin an upload and commit it at a tick while the vehicle tracks."""
    status = stranger.status
    if _tracked_us(stranger) < DELAY_US or status is None:
        return []
    digest = bytes(range(32))
    return [
        m.UploadBegin(2_000, m.VEHICLE[0], mavlink.TRIMTAB_BLOB_REFERENCE, 90, 1, digest),
        m.UploadCommit(status.tick + 500, m.VEHICLE[0], mavlink.TRIMTAB_BLOB_REFERENCE, digest),
    ]


KINDS: Mapping[str, Callable[[], Act]] = {
    "hold": lambda: command(mavlink.MAV_CMD_DO_SET_MODE, *_HOLD),
    "land": lambda: command(mavlink.MAV_CMD_NAV_LAND),
    "disarm": lambda: command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0),
    "forced-disarm": lambda: command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, m.FORCE),
    "terminate": lambda: command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1.0),
    "arm": lambda: command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0),
    "takeoff": lambda: command(mavlink.MAV_CMD_NAV_TAKEOFF, *(0.0,) * 6, 3.0),
    "start": lambda: command(mavlink.MAV_CMD_MISSION_START),
    "offboard": lambda: offboard,
    "poses": lambda: poses,
    "parameter": lambda: parameter("POS_P_N", BY_NAME["POS_P_N"].default * 0.5),
    "upload-swap": lambda: upload_swap,
    "upload-abort": lambda: upload_abort,
}
"""Interference by name."""
