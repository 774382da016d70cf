"""Standard MAVLink telemetry messages of the vehicle.

All functions take (flight, now_us, battery_v). A NaN of an invalid estimate is sent unchanged.
"""

from __future__ import annotations

import math

from trimtab.firmware_model.flight.condition_monitor import FLOOR_HEIGHT
from trimtab.firmware_model.flight.failsafe import Failsafe
from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import mat_t_vec, matrix_to_euler, quat_to_matrix
from trimtab.firmware_model.services.global_position import place_of
from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink

_ALWAYS = (
    mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
)
_GYRO = mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
_MOCAP = mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
_BATTERY = mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
_PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_FENCE = mavlink.MAV_SYS_STATUS_GEOFENCE
_GLOBAL = mavlink.MAV_SYS_STATUS_SENSOR_GPS  # MAVSDK's is_global_position_ok
_PRESENT = _ALWAYS | _GYRO | _MOCAP | _GLOBAL | _BATTERY | _FENCE | _PREARM

_LANDED = {
    State.BOOT: mavlink.MAV_LANDED_STATE_ON_GROUND,
    State.STANDBY: mavlink.MAV_LANDED_STATE_ON_GROUND,
    State.ARMED: mavlink.MAV_LANDED_STATE_ON_GROUND,
    State.TAKEOFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    State.LANDING: mavlink.MAV_LANDED_STATE_LANDING,
    State.FAILSAFE: mavlink.MAV_LANDED_STATE_LANDING,
}
"""Landed state by flight state. In all other states the height decides: offboard may start on the floor."""
_MV_MAX = 0xFFFE
_NOT_MEASURED = -1
_TEMPERATURE_NONE = 0x7FFF
_CELL_NONE = 0xFFFF


def sys_status(flight: Flight, now_us: int, battery_v: float) -> m.SysStatus:
    """Return SYS_STATUS.

    The gyro is healthy once calibrated, vision while poses arrive, and the pre-arm check if it passes. The
    bit of the GPS says that the position on the globe is valid: gyro and vision are healthy. The geofence is
    healthy until the vehicle leaves it: MAVProxy reports any other value as a breach.
    """
    health = _ALWAYS | _BATTERY
    if flight.failsafe is not Failsafe.GEOFENCE:
        health |= _FENCE
    if flight.calibration.bias is not None:
        health |= _GYRO
    if flight.has_pose(now_us):
        health |= _MOCAP | (_GLOBAL if health & _GYRO else 0)
    if not flight.arming_reasons(now_us):
        health |= _PREARM
    millivolts, percent = _millivolts(battery_v), _percent(flight, battery_v)
    return m.SysStatus(_PRESENT, _PRESENT, health, 0, millivolts, _NOT_MEASURED, percent, 0, 0, 0, 0, 0, 0)


def battery_status(flight: Flight, now_us: int, battery_v: float) -> m.BatteryStatus:
    """Return BATTERY_STATUS: total voltage as one cell, and charge as a linear function of the voltage."""
    percent = _percent(flight, battery_v)
    low = percent == 0
    return m.BatteryStatus(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        _TEMPERATURE_NONE,
        [_millivolts(battery_v), *(_CELL_NONE,) * 9],
        _NOT_MEASURED,
        _NOT_MEASURED,
        _NOT_MEASURED,
        percent,
        0,
        mavlink.MAV_BATTERY_CHARGE_STATE_LOW if low else mavlink.MAV_BATTERY_CHARGE_STATE_OK,
        [0, 0, 0, 0],
        0,
        0,
    )


def extended_sys_state(flight: Flight, now_us: int, battery_v: float) -> m.ExtendedSysState:
    """Return EXTENDED_SYS_STATE: on the ground, taking off, in the air or landing."""
    landed = _LANDED.get(flight.state)
    if landed is None:
        on_floor = flight.height_m < FLOOR_HEIGHT
        landed = mavlink.MAV_LANDED_STATE_ON_GROUND if on_floor else mavlink.MAV_LANDED_STATE_IN_AIR
    return m.ExtendedSysState(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)


def home_position(flight: Flight, now_us: int, battery_v: float) -> m.HomePosition:
    """Return HOME_POSITION: start of the last take-off, or the estimate before the first."""
    memory = flight.outputs["memory"].tolist()
    x, y, z = flight.home_ned or memory[law.EST_P]
    place = place_of(flight.parameters, (x, y, z))
    return m.HomePosition(*place, x, y, z, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, now_us)


def attitude(flight: Flight, now_us: int, battery_v: float) -> m.Attitude:
    """Return ATTITUDE: roll, pitch and yaw of FRD in NED, and the body rate."""
    R = quat_to_matrix(FLOAT, flight.outputs["memory"].tolist()[law.EST_Q])
    roll, pitch, yaw = matrix_to_euler(FLOAT, R)
    p, q, r = _rate(flight)
    return m.Attitude(_boot_ms(now_us), roll, pitch, yaw, p, q, r)


def attitude_quaternion(flight: Flight, now_us: int, battery_v: float) -> m.AttitudeQuaternion:
    """Return ATTITUDE_QUATERNION, w first."""
    w, x, y, z = flight.outputs["memory"].tolist()[law.EST_Q]
    p, q, r = _rate(flight)
    return m.AttitudeQuaternion(_boot_ms(now_us), w, x, y, z, p, q, r, [0.0] * 4)


def local_position(flight: Flight, now_us: int, battery_v: float) -> m.LocalPositionNed:
    """Return LOCAL_POSITION_NED."""
    memory = flight.outputs["memory"].tolist()
    x, y, z = memory[law.EST_P]
    vx, vy, vz = memory[law.EST_V]
    return m.LocalPositionNed(_boot_ms(now_us), x, y, z, vx, vy, vz)


def odometry(flight: Flight, now_us: int, battery_v: float) -> m.Odometry:
    """Return ODOMETRY: pose in local NED, velocity in body FRD, unknown covariances."""
    memory = flight.outputs["memory"].tolist()
    x, y, z = memory[law.EST_P]
    attitude = memory[law.EST_Q]
    u, v, w = mat_t_vec(quat_to_matrix(FLOAT, attitude), memory[law.EST_V])
    p, q, r = _rate(flight)
    unknown = [math.nan, *(0.0,) * 20]
    world, body = mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED
    return m.Odometry(now_us, world, body, x, y, z, attitude, u, v, w, p, q, r, unknown, unknown, 0, 0, 0)


def _rate(flight: Flight) -> list[float]:
    bias = flight.outputs["memory"].tolist()[law.EST_BIAS]
    return [g - b for g, b in zip(flight.gyro, bias, strict=True)]


def _boot_ms(now_us: int) -> int:
    return now_us // 1000 & 0xFFFF_FFFF


def _millivolts(battery_v: float) -> int:
    return min(_MV_MAX, max(0, round(1000.0 * battery_v))) if math.isfinite(battery_v) else 0


def _percent(flight: Flight, battery_v: float) -> int:
    """Return the charge in percent by voltage, from BAT_EMPTY_V to BAT_FULL_V; -1 if it is undefined."""
    empty, full = flight.parameters["BAT_EMPTY_V"], flight.parameters["BAT_FULL_V"]
    if not full > empty or not math.isfinite(battery_v):
        return _NOT_MEASURED
    return round(100.0 * min(1.0, max(0.0, (battery_v - empty) / (full - empty))))
