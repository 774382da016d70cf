"""Position on the globe: the local position, placed at the origin that the parameters ORIGIN_ name.

Stock clients wait for such a position. The room has no satellites: the place is that of the parameters, and
the motion is that of the poses. All message functions take (flight, now_us, battery_v).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import matrix_to_euler, quat_to_matrix
from trimtab.protocol import messages as m

EARTH_RADIUS_M = 6_371_000.0
"""Radius of the sphere on which small distances become degrees, as in PX4."""
DEGREE = 10_000_000
"""A degree in the unit of latitudes and longitudes."""
_TERRAIN_UNKNOWN = -1001.0
_CLEARANCE_UNKNOWN = -1.0
_SPEED_MAX = 0x7FFF

Place = tuple[int, int, int]
"""Latitude and longitude in 1e-7 deg, altitude above mean sea level in mm."""


def origin(parameters: Mapping[str, float]) -> Place:
    """Return the place of the local frame's origin."""
    latitude = DEGREE * int(parameters["ORIGIN_LAT_DEG"]) + int(parameters["ORIGIN_LAT_E7"])
    longitude = DEGREE * int(parameters["ORIGIN_LON_DEG"]) + int(parameters["ORIGIN_LON_E7"])
    return latitude, longitude, round(1e3 * parameters["ORIGIN_ALT"])


def origin_parameters(place: Place) -> dict[str, float]:
    """Return the parameters ORIGIN_ of a place, by name."""
    latitude_deg, latitude_rest = divmod(place[0], DEGREE)
    longitude_deg, longitude_rest = divmod(place[1], DEGREE)
    return {
        "ORIGIN_LAT_DEG": latitude_deg,
        "ORIGIN_LAT_E7": latitude_rest,
        "ORIGIN_LON_DEG": longitude_deg,
        "ORIGIN_LON_E7": longitude_rest,
        "ORIGIN_ALT": 1e-3 * place[2],
    }


def place_of(parameters: Mapping[str, float], p_ned: Sequence[float]) -> Place:
    """Return the place of a local position in m; 0 for each number of a position that is not finite."""
    latitude, longitude, altitude_mm = origin(parameters)
    if not all(math.isfinite(x) for x in p_ned):
        return 0, 0, 0
    north, east, down = p_ned
    degrees_per_m = math.degrees(1.0 / EARTH_RADIUS_M)
    shrink = math.cos(math.radians(latitude / DEGREE))
    longitude += round(DEGREE * degrees_per_m * east / shrink)
    half_turn = 180 * DEGREE
    longitude = (longitude + half_turn) % (2 * half_turn) - half_turn
    return latitude + round(DEGREE * degrees_per_m * north), longitude, altitude_mm - round(1e3 * down)


def global_position(flight: Flight, now_us: int, battery_v: float) -> m.GlobalPosition:
    """Return GLOBAL_POSITION_INT."""
    memory = flight.outputs["memory"].tolist()
    p_ned = memory[law.EST_P]
    north, east, down = (_bounded(100.0 * v, _SPEED_MAX) for v in memory[law.EST_V])
    height_mm = _bounded(1e3 * _height_above_home(flight, p_ned), 0x7FFF_FFFF)
    heading_cdeg = round(100.0 * heading_deg(flight)) % 36_000
    boot_ms = now_us // 1000 & 0xFFFF_FFFF
    place = place_of(flight.parameters, p_ned)
    return m.GlobalPosition(boot_ms, *place, height_mm, north, east, down, heading_cdeg)


def gps_global_origin(flight: Flight, now_us: int, battery_v: float) -> m.GpsGlobalOrigin:
    """Return GPS_GLOBAL_ORIGIN."""
    return m.GpsGlobalOrigin(*origin(flight.parameters), now_us)


def altitude(flight: Flight, now_us: int, battery_v: float) -> m.Altitude:
    """Return ALTITUDE. Heights above terrain and below the vehicle are not known."""
    p_ned = flight.outputs["memory"].tolist()[law.EST_P]
    height, relative = -p_ned[2], _height_above_home(flight, p_ned)
    above_sea = flight.parameters["ORIGIN_ALT"] + height
    return m.Altitude(now_us, height, above_sea, height, relative, _TERRAIN_UNKNOWN, _CLEARANCE_UNKNOWN)


def vfr_hud(flight: Flight, now_us: int, battery_v: float) -> m.VfrHud:
    """Return VFR_HUD. There is no air speed."""
    memory = flight.outputs["memory"].tolist()
    north, east, down = memory[law.EST_V]
    throttle = sum(flight.outputs["motor_command"]) / 4
    altitude_m = flight.parameters["ORIGIN_ALT"] - memory[law.EST_P][2]
    heading = round(heading_deg(flight)) % 360
    return m.VfrHud(0.0, math.hypot(north, east), heading, _bounded(100.0 * throttle, 100), altitude_m, -down)


def heading_deg(flight: Flight) -> float:
    """Return the heading, 0 at north and growing to the east; 0 if the attitude is not finite."""
    R = quat_to_matrix(FLOAT, flight.outputs["memory"].tolist()[law.EST_Q])
    yaw = matrix_to_euler(FLOAT, R)[2]
    return math.degrees(yaw) if math.isfinite(yaw) else 0.0


def _height_above_home(flight: Flight, p_ned: Sequence[float]) -> float:
    home = flight.home_ned
    return (p_ned[2] if home is None else home[2]) - p_ned[2]


def _bounded(value: float, most: int) -> int:
    """Return the nearest whole number of magnitude up to `most`; 0 if the value is not finite."""
    return max(-most, min(most, round(value))) if math.isfinite(value) else 0
