"""Short names for the messages of the dialect; addresses; heartbeats.

Messages take their fields by position, in the order of `dialect/trimtab.xml`, or by name. Text fields are
bytes. `mavlink` holds the constants of the dialect (`mavlink.MAV_CMD_NAV_LAND`).
"""

from __future__ import annotations

from enum import IntEnum

from trimtab.protocol.generated import trimtab as mavlink
from trimtab.protocol.generated.frames import DIALECT_VERSION
from trimtab.protocol.stream import SIGNED_FLAG

Message = mavlink.MAVLink_message
Station = tuple[int, int]
"""MAVLink system and component of a sender of messages."""

Heartbeat = mavlink.MAVLink_heartbeat_message
Ping = mavlink.MAVLink_ping_message
ParamRequestRead = mavlink.MAVLink_param_request_read_message
ParamRequestList = mavlink.MAVLink_param_request_list_message
ParamValue = mavlink.MAVLink_param_value_message
ParamSet = mavlink.MAVLink_param_set_message
SysStatus = mavlink.MAVLink_sys_status_message
ParamError = mavlink.MAVLink_param_error_message
Attitude = mavlink.MAVLink_attitude_message
AttitudeQuaternion = mavlink.MAVLink_attitude_quaternion_message
LocalPositionNed = mavlink.MAVLink_local_position_ned_message
GlobalPosition = mavlink.MAVLink_global_position_int_message
SetGpsGlobalOrigin = mavlink.MAVLink_set_gps_global_origin_message
GpsGlobalOrigin = mavlink.MAVLink_gps_global_origin_message
Altitude = mavlink.MAVLink_altitude_message
VfrHud = mavlink.MAVLink_vfr_hud_message
Odometry = mavlink.MAVLink_odometry_message
BatteryStatus = mavlink.MAVLink_battery_status_message
ExtendedSysState = mavlink.MAVLink_extended_sys_state_message
HomePosition = mavlink.MAVLink_home_position_message
MessageInterval = mavlink.MAVLink_message_interval_message
RequestDataStream = mavlink.MAVLink_request_data_stream_message
MissionRequestList = mavlink.MAVLink_mission_request_list_message
MissionCount = mavlink.MAVLink_mission_count_message
MissionClearAll = mavlink.MAVLink_mission_clear_all_message
MissionAck = mavlink.MAVLink_mission_ack_message
LogRequestList = mavlink.MAVLink_log_request_list_message
LogEntry = mavlink.MAVLink_log_entry_message
SerialControl = mavlink.MAVLink_serial_control_message
FileTransfer = mavlink.MAVLink_file_transfer_protocol_message
SetPositionTarget = mavlink.MAVLink_set_position_target_local_ned_message
SetAttitudeTarget = mavlink.MAVLink_set_attitude_target_message
CommandLong = mavlink.MAVLink_command_long_message
CommandInt = mavlink.MAVLink_command_int_message
CommandAck = mavlink.MAVLink_command_ack_message
Timesync = mavlink.MAVLink_timesync_message
VisionPositionEstimate = mavlink.MAVLink_vision_position_estimate_message
AttPosMocap = mavlink.MAVLink_att_pos_mocap_message
AutopilotVersion = mavlink.MAVLink_autopilot_version_message
SetupSigning = mavlink.MAVLink_setup_signing_message
StatusText = mavlink.MAVLink_statustext_message
FcControl = mavlink.MAVLink_fc_control_message
FcEstimate = mavlink.MAVLink_fc_estimate_message
FcObserver = mavlink.MAVLink_fc_observer_message
FcRotors = mavlink.MAVLink_fc_rotors_message
FcStatus = mavlink.MAVLink_fc_status_message
RadioStats = mavlink.MAVLink_radio_stats_message
UploadBegin = mavlink.MAVLink_upload_begin_message
UploadChunk = mavlink.MAVLink_upload_chunk_message
UploadStatus = mavlink.MAVLink_upload_status_message
UploadVerdict = mavlink.MAVLink_upload_verdict_message
UploadCommit = mavlink.MAVLink_upload_commit_message
UploadAbort = mavlink.MAVLink_upload_abort_message

VEHICLE = (1, mavlink.MAV_COMP_ID_AUTOPILOT1)
"""System and component of the flight processor, for standard messages."""
VEHICLE_FAST = (1, mavlink.MAV_COMP_ID_USER1)
"""Sender of FC_CONTROL, FC_ESTIMATE, FC_OBSERVER and FC_ROTORS, which overtake others in the radio."""
VEHICLE_PRIVATE = (1, mavlink.MAV_COMP_ID_USER2)
"""Sender of the vehicle's other private messages. Stock clients do not count unknown messages as received."""
PRIVATE_ID_MIN = 52100
"""Least message id of the private dialect."""
VEHICLE_RADIO = (1, mavlink.MAV_COMP_ID_TELEMETRY_RADIO)
HOST = (255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
HOST_RADIO = (255, mavlink.MAV_COMP_ID_TELEMETRY_RADIO)
CAMERAS = (254, 1)
"""System and component of the motion capture system, which sends poses to the host."""

NO_TICK = 0xFFFF_FFFF
"""No tick: FC_STATUS.reference_tick before it is known, FC_STATUS.swap_tick without an agreed swap, and
UPLOAD_COMMIT.at_tick for an immediate commit.
"""
NO_NODE = 0xFFFF
"""UPLOAD_VERDICT.node if the verdict concerns no node."""
FORCE = 21196.0
"""COMMAND_LONG.param2 of MAV_CMD_COMPONENT_ARM_DISARM that forces a disarm in flight."""

_OLD_MARK = 0x54  # top byte of custom_mode up to dialect version 2
_MARK = 0x15  # bits 10 to 15 of custom_mode, above six bits of dialect version and four of state
_MARK_SHIFT, _VERSION_SHIFT, _VERSION_MASK = 10, 4, 0x3F
_AUTO, _OFFBOARD = 4, 6
_PX4_MODES: dict[int, tuple[int, int]] = {
    mavlink.TRIMTAB_STATE_TAKEOFF: (_AUTO, 2),
    mavlink.TRIMTAB_STATE_TRACKING: (_AUTO, 4),
    mavlink.TRIMTAB_STATE_HOLD: (_AUTO, 3),
    mavlink.TRIMTAB_STATE_LANDING: (_AUTO, 6),
    mavlink.TRIMTAB_STATE_FAILSAFE: (_AUTO, 6),
    mavlink.TRIMTAB_STATE_OFFBOARD: (_OFFBOARD, 0),
}
"""PX4's main and sub mode (takeoff, mission, hold, land, offboard) by state; any other state is READY."""
_PX4_READY = (_AUTO, 1)
VENDOR_ID = 0x5454
"""AUTOPILOT_VERSION.vendor_id of a Trimtab vehicle; its product_id is the dialect version."""
SIMULATED_BOARD = 0x53_49_4D_00
"""AUTOPILOT_VERSION.board_version of a simulated vehicle. 0 leaves open whether the vehicle is simulated; any
other number is that of a board of hardware."""


class UploadState(IntEnum):
    """UPLOAD_STATUS.state: the receiver's state of the blob that the message concerns."""

    IDLE = mavlink.TRIMTAB_UPLOAD_IDLE
    RECEIVING = mavlink.TRIMTAB_UPLOAD_RECEIVING
    STAGED = mavlink.TRIMTAB_UPLOAD_STAGED
    REFUSED = mavlink.TRIMTAB_UPLOAD_REFUSED
    LIVE = mavlink.TRIMTAB_UPLOAD_LIVE
    SCHEDULED = mavlink.TRIMTAB_UPLOAD_SCHEDULED


class UploadResult(IntEnum):
    """UPLOAD_STATUS.result: the receiver's response to the last message about the blob."""

    OK = mavlink.TRIMTAB_UPLOAD_RESULT_OK
    TOO_LARGE = mavlink.TRIMTAB_UPLOAD_RESULT_TOO_LARGE
    BAD_KIND = mavlink.TRIMTAB_UPLOAD_RESULT_BAD_KIND
    BAD_REQUEST = mavlink.TRIMTAB_UPLOAD_RESULT_BAD_REQUEST
    CORRUPT = mavlink.TRIMTAB_UPLOAD_RESULT_CORRUPT
    UNKNOWN = mavlink.TRIMTAB_UPLOAD_RESULT_UNKNOWN
    BUSY = mavlink.TRIMTAB_UPLOAD_RESULT_BUSY
    REFUSED = mavlink.TRIMTAB_UPLOAD_RESULT_REFUSED
    NOT_CONTINUOUS = mavlink.TRIMTAB_UPLOAD_RESULT_NOT_CONTINUOUS
    TOO_LATE = mavlink.TRIMTAB_UPLOAD_RESULT_TOO_LATE


def vehicle_heartbeat(state: int, *, armed: bool, failsafe: bool = False) -> Heartbeat:
    """Return the heartbeat of a Trimtab vehicle in `state` (TRIMTAB_STATE, 0..15).

    The upper half of custom_mode is PX4's, which stock clients decode: sub mode in bits 24 to 31, main mode
    in bits 16 to 23. The lower half, which PX4 reserves, holds a mark, the dialect version and the state.
    """
    mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    if failsafe:
        status = mavlink.MAV_STATE_CRITICAL
    elif armed:
        status = mavlink.MAV_STATE_ACTIVE
    else:
        status = mavlink.MAV_STATE_BOOT if state == mavlink.TRIMTAB_STATE_BOOT else mavlink.MAV_STATE_STANDBY
    main_mode, sub_mode = _PX4_MODES.get(state, _PX4_READY)
    custom_mode = sub_mode << 24 | main_mode << 16 | _identification() | state
    return Heartbeat(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC, mode, custom_mode, status, 3)


def host_heartbeat() -> Heartbeat:
    """Return the heartbeat of a ground station."""
    mode, status = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mavlink.MAV_STATE_ACTIVE
    return Heartbeat(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, mode, _identification(), status, 3)


def station_name(station: Station) -> str:
    """Return system and component of a station as a text."""
    return "{}:{}".format(*station)


def sender_of(message: Message) -> Station:
    """Return system and component of the sender of a message."""
    data = message.get_msgbuf()
    if data:  # received
        return data[5], data[6]
    return message.get_srcSystem(), message.get_srcComponent()


def is_signed(message: Message) -> bool:
    """Return whether a received message has a signature. Whether it is correct is the codec's business."""
    return bool(message.get_header().incompat_flags & SIGNED_FLAG)


def is_own_host(heartbeat: Heartbeat) -> bool:
    """Return whether the sender is Trimtab's ground station, which understands the private messages."""
    return heartbeat.autopilot == mavlink.MAV_AUTOPILOT_INVALID and _is_marked(heartbeat.custom_mode)


def dialect_version(heartbeat: Heartbeat) -> int | None:
    """Return the dialect version of the heartbeat's sender, or None if it is not a Trimtab vehicle.

    The private messages can be read only if the version equals DIALECT_VERSION.
    """
    if heartbeat.autopilot != mavlink.MAV_AUTOPILOT_GENERIC:
        return None
    if heartbeat.custom_mode >> 24 == _OLD_MARK:
        return (heartbeat.custom_mode >> 16) & 0xFF
    if not _is_marked(heartbeat.custom_mode):
        return None
    return heartbeat.custom_mode >> _VERSION_SHIFT & _VERSION_MASK


def is_vehicle(heartbeat: Heartbeat) -> bool:
    """Return whether the sender is a flight controller of any make rather than part of a ground station."""
    return heartbeat.autopilot != mavlink.MAV_AUTOPILOT_INVALID


def _identification() -> int:
    """Return mark and dialect version at their place in custom_mode."""
    return _MARK << _MARK_SHIFT | DIALECT_VERSION << _VERSION_SHIFT


def _is_marked(custom_mode: int) -> bool:
    return (custom_mode & 0xFFFF) >> _MARK_SHIFT == _MARK
