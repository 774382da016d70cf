"""Position on the globe: the local position at the place that the parameters ORIGIN_ give."""

import math

import pytest

from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.services.global_position import origin, origin_parameters, place_of
from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink
from trimtab.protocol.parameters import DEFAULTS, complete

STATION = (245, 190)
REQUEST = 512
METRES_PER_DEGREE = 111_194.93  # of a circle of 6371 km


@pytest.mark.parametrize(
    "place",
    [
        (473977420, 85455940, 488000),
        (-1, -1, -1000),
        (-335000001, 1799999999, 0),
        (859999999, -1800000000, 1),
    ],
)
def test_origin_keeps_every_digit_in_float32_parameters(place):
    assert origin(complete(origin_parameters(place))) == place


def test_place_of_a_position_is_north_east_and_above_of_the_origin():
    latitude, longitude, altitude_mm = place_of(DEFAULTS, (1000.0, -500.0, -2.5))
    at = origin(DEFAULTS)
    assert (latitude - at[0]) * 1e-7 * METRES_PER_DEGREE == pytest.approx(1000.0, abs=0.02)
    shrink = math.cos(math.radians(47.397742))
    assert (longitude - at[1]) * 1e-7 * METRES_PER_DEGREE * shrink == pytest.approx(-500.0, abs=0.02)
    assert altitude_mm - at[2] == 2500


def test_place_across_the_antimeridian_stays_within_half_a_turn():
    at = {**DEFAULTS, **origin_parameters((0, 1799999990, 0))}
    assert place_of(at, (0.0, 1.0, 0.0))[1] == pytest.approx(-1799999920, abs=1)


def test_position_that_is_not_finite_is_no_place():
    assert place_of(DEFAULTS, (math.nan, 0.0, 0.0)) == (0, 0, 0)


def test_stations_get_the_flight_on_the_globe(make_session, make_blob):
    session = make_session()
    session.put(make_blob())
    session.take_off()
    session.run_to(State.TRACKING)
    session.run(0.5)
    session.inbox.clear()
    for kind in (m.GlobalPosition, m.LocalPositionNed, m.Altitude, m.VfrHud, m.HomePosition, m.Attitude):
        session.command(REQUEST, float(kind.id))
    session.command(REQUEST, float(m.GpsGlobalOrigin.id))
    session.run(0.2)
    (globe,), (local,) = session.received(m.GlobalPosition), session.received(m.LocalPositionNed)
    place = place_of(DEFAULTS, (local.x, local.y, local.z))
    assert (globe.lat, globe.lon) == pytest.approx(place[:2], abs=2)  # 1e-7 deg are 11 mm
    assert globe.alt == pytest.approx(place[2], abs=20)
    assert globe.relative_alt == pytest.approx(-1e3 * local.z, abs=20)
    assert (globe.vx, globe.vy, globe.vz) == pytest.approx(
        (100 * local.vx, 100 * local.vy, 100 * local.vz), abs=8
    )
    assert abs(globe.vx) > 10
    (attitude,) = session.received(m.Attitude)
    assert globe.hdg == pytest.approx(100 * math.degrees(attitude.yaw), abs=100)
    (altitude,) = session.received(m.Altitude)
    assert altitude.altitude_amsl == pytest.approx(488.0 - local.z, abs=0.02)
    assert altitude.altitude_relative == pytest.approx(-local.z, abs=0.02)
    (hud,) = session.received(m.VfrHud)
    assert hud.groundspeed == pytest.approx(math.hypot(local.vx, local.vy), abs=0.1)
    assert hud.heading == pytest.approx(globe.hdg / 100, abs=1.0)
    assert 20 < hud.throttle < 80
    (home,) = session.received(m.HomePosition)
    assert (home.latitude, home.longitude) == pytest.approx(origin(DEFAULTS)[:2], abs=5)
    (told,) = session.received(m.GpsGlobalOrigin)
    assert (told.latitude, told.longitude, told.altitude) == origin(DEFAULTS)


def test_position_on_the_globe_is_valid_once_poses_come_and_the_gyro_is_calibrated(make_session):
    session = make_session()
    session.mocap = False

    def valid():
        session.command(REQUEST, float(m.SysStatus.id))
        session.run(0.2)
        healthy = session.received(m.SysStatus)[-1].onboard_control_sensors_health
        return bool(healthy & mavlink.MAV_SYS_STATUS_SENSOR_GPS)

    session.run(1.0)
    assert not valid()
    session.mocap = True
    session.run(0.2)
    assert valid()


def test_origin_is_set_in_standby_and_answered(make_line):
    line = make_line()
    line.run(0.3)
    line.send(m.SetGpsGlobalOrigin(1, -335000001, 1512345678, 12_500), source=STATION)
    line.run(0.1)
    (told,) = line.received(m.GpsGlobalOrigin)
    assert (told.latitude, told.longitude, told.altitude) == (-335000001, 1512345678, 12_500)
    assert origin(line.flight.parameters) == (-335000001, 1512345678, 12_500)
    line.send(m.SetGpsGlobalOrigin(1, 899999999, 0, 0), source=STATION)
    line.run(0.1)
    assert line.received(m.GpsGlobalOrigin)[-1].latitude == -335000001
    assert any("ORIGIN_LAT_DEG: 89 is outside" in text for text in line.texts())
