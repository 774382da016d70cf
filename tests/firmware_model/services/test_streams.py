"""Stock telemetry: silent for Trimtab's own host, at modest rates for others, within its share of the air."""

import math
from array import array

import pytest

from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.services.streams import (
    GROUPS,
    INTERVAL_MAX_US,
    PERIODIC_INTERVALS_US,
    STATION_US,
    STREAMS,
)
from trimtab.protocol import messages as m
from trimtab.protocol.generated.frames import MESSAGES
from trimtab.protocol.messages import mavlink

STATION = (245, 190)
SET, GET, REQUEST = 511, 510, 512
KINDS = {number: mavlink.mavlink_map[number] for number in STREAMS}
STATUS_SHARE = 50 * 116
"""Bytes a second that the air budget of docs/concepts/link.md leaves for status."""


def beat():
    return m.Heartbeat(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


def counts(line):
    return {number: len(line.received(kind)) for number, kind in KINDS.items()}


def acks(line):
    return [(a.command, a.result, (a.target_system, a.target_component)) for a in line.received(m.CommandAck)]


def with_station(line, seconds):
    for _ in range(round(seconds)):
        line.send(beat(), source=STATION)
        line.run(1.0)


def test_nothing_of_it_is_sent_while_trimtab_alone_speaks(make_line):
    silent, line = make_line(), make_line()
    silent.run(4.0)
    for _ in range(4):
        line.send(m.host_heartbeat())
        line.run(1.0)
    assert set(counts(line).values()) == {0}
    assert line.bytes_heard == silent.bytes_heard


def test_station_heard_gets_default_rates_and_its_leaving_ends_them(make_line):
    line = make_line()
    line.run(0.5)
    with_station(line, 4)
    heard = counts(line)
    for number, stream in STREAMS.items():
        wanted = 0 if stream.default_us < 0 else 4e6 / stream.default_us
        assert heard[number] == pytest.approx(wanted, abs=1.0), MESSAGES[number]
    line.run(STATION_US * 1e-6)
    before = counts(line)
    line.run(3.0)
    assert counts(line) == before


def test_home_is_told_where_a_takeoff_moves_it_to_stations_that_are_there(make_session):
    session = make_session()
    session.body.p[0] = 0.4
    session.send(beat())
    session.run(1.0)
    assert session.received(m.HomePosition) == []
    for command in (400, 22):
        session.command(command, 1.0)
        session.send(beat())
        session.run(0.3)
    session.run_to(State.HOLD)
    (home,) = session.received(m.HomePosition)
    assert (home.x, home.y, home.z) == pytest.approx((0.4, 0.0, 0.0), abs=0.02)


def test_another_vehicle_on_the_air_is_no_station(make_line):
    line = make_line()
    line.send(m.vehicle_heartbeat(1, armed=False), source=(2, 1))
    line.run(2.0)
    assert set(counts(line).values()) == {0}


def test_messages_say_what_the_vehicle_does(make_session, make_blob):
    session = make_session()
    session.run(0.5)
    session.put(make_blob())
    session.take_off()
    session.run_to(State.TRACKING)
    session.run(0.5)
    session.inbox.clear()
    for number in STREAMS:
        if number != m.Odometry.id:  # fits no frame
            session.command(REQUEST, float(number))
    session.run(0.2)
    (local,) = session.received(m.LocalPositionNed)
    near = min(session.received(m.FcEstimate), key=lambda e: abs(e.tick - local.time_boot_ms))
    assert (local.x, local.z) == pytest.approx((near.p[0], near.p[2]), abs=0.02)
    assert math.hypot(local.vx, local.vy, local.vz) > 0.1
    (attitude,) = session.received(m.Attitude)
    (quaternion,) = session.received(m.AttitudeQuaternion)
    w, x, y, z = quaternion.q1, quaternion.q2, quaternion.q3, quaternion.q4
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = math.asin(2 * (w * y - z * x))
    assert (attitude.yaw, attitude.pitch) == pytest.approx((yaw, pitch), abs=0.03)
    assert attitude.yaw == pytest.approx(0.2, abs=0.05)
    (landed,) = session.received(m.ExtendedSysState)
    assert landed.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR
    (home,) = session.received(m.HomePosition)
    assert (home.x, home.y, home.z) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    (system,) = session.received(m.SysStatus)
    healthy = system.onboard_control_sensors_health
    for sensor in ("3D_GYRO", "VISION_POSITION", "BATTERY"):
        assert healthy & getattr(mavlink, f"MAV_SYS_STATUS_SENSOR_{sensor}")
    assert (system.voltage_battery, system.battery_remaining) == (16_800, 100)
    (battery,) = session.received(m.BatteryStatus)
    assert (battery.voltages[0], battery.battery_remaining) == (16_800, 100)


def test_odometry_has_velocity_in_the_body_frame(make_rig):
    rig = make_rig()
    rig.track()
    rig.run(1.0)
    odometry = STREAMS[m.Odometry.id].make(rig.flight, rig.now_us, 16.8)
    local = STREAMS[m.LocalPositionNed.id].make(rig.flight, rig.now_us, 16.8)
    assert isinstance(odometry, m.Odometry)
    assert isinstance(local, m.LocalPositionNed)
    speed = math.hypot(local.vx, local.vy, local.vz)
    assert math.hypot(odometry.vx, odometry.vy, odometry.vz) == pytest.approx(speed, rel=1e-6)
    assert speed > 0.5
    # Yaw is 0.2: what is north in the world is ahead and to the left of the body.
    assert odometry.vx == pytest.approx(local.vx * math.cos(0.2), rel=0.05)
    assert odometry.vy == pytest.approx(-local.vx * math.sin(0.2), abs=0.05)


def test_prearm_check_is_healthy_only_where_arming_would_be_accepted(make_session):
    session = make_session()
    check = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    session.mocap = False
    session.run(1.0)
    for command in (401, REQUEST):
        session.command(command, float(m.SysStatus.id))
    session.run(0.2)
    assert not session.received(m.SysStatus)[-1].onboard_control_sensors_health & check
    assert session.received(m.CommandAck)[0].result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert any("no mocap" in text for text in session.texts())
    session.mocap = True
    session.run(0.2)
    session.command(401)
    session.command(REQUEST, float(m.SysStatus.id))
    session.run(0.2)
    assert session.received(m.SysStatus)[-1].onboard_control_sensors_health & check
    assert session.received(m.CommandAck)[-2].result == mavlink.MAV_RESULT_ACCEPTED


@pytest.mark.parametrize("number", STREAMS)
def test_interval_is_set_told_and_kept_above_its_floor(make_line, number):
    line = make_line()
    line.run(0.3)
    line.command(SET, float(number), 1.0, source=STATION)
    line.command(GET, float(number), source=STATION)
    line.run(0.1)
    (told,) = line.received(m.MessageInterval)
    assert (told.message_id, told.interval_us) == (number, STREAMS[number].min_us)
    assert acks(line) == [(SET, 0, STATION), (GET, 0, STATION)]
    line.inbox.clear()
    line.run(2.0)
    assert counts(line)[number] == pytest.approx(2e6 / STREAMS[number].min_us, abs=1.0)
    line.command(SET, float(number), -1.0, source=STATION)
    line.run(0.1)
    line.inbox.clear()
    line.run(1.0)
    assert counts(line)[number] == 0
    line.command(SET, float(number), 0.0, source=STATION)
    line.command(GET, float(number), source=STATION)
    line.run(0.1)
    assert line.received(m.MessageInterval)[-1].interval_us == STREAMS[number].default_us


@pytest.mark.parametrize(
    ("message", "interval", "result"),
    [(9999.0, 0.0, 3), (math.nan, 0.0, 3), (30.0, math.nan, 2), (30.0, -2.0, 2), (30.0, math.inf, 2)],
)
def test_interval_that_makes_no_sense_is_refused(make_line, message, interval, result):
    line = make_line()
    line.command(SET, message, interval, source=STATION)
    line.run(0.2)
    assert acks(line) == [(SET, result, STATION)]


def test_interval_of_an_unknown_message_is_zero_and_of_no_number_is_refused(make_line):
    line = make_line()
    line.command(GET, 9999.0)
    line.command(GET, math.nan)
    line.run(0.2)
    assert line.received(m.MessageInterval)[-1].interval_us == 0
    assert [result for _, result, _ in acks(line)] == [0, 2]


@pytest.mark.parametrize("kind", [m.FcControl, m.FcStatus])
def test_own_messages_can_be_slowed_but_neither_sped_up_nor_stopped(make_line, kind):
    line = make_line()
    line.run(0.3)
    line.command(SET, float(kind.id), 500_000.0, source=STATION)
    line.run(0.1)
    line.inbox.clear()
    line.run(2.0)
    assert len(line.received(kind)) == pytest.approx(4, abs=1)
    for wish, interval_us in (
        (1.0, PERIODIC_INTERVALS_US[kind.id]),
        (-1.0, 1_000_000),
        (0.0, PERIODIC_INTERVALS_US[kind.id]),
    ):
        line.command(SET, float(kind.id), wish, source=STATION)
        line.command(GET, float(kind.id), source=STATION)
        line.run(0.1)
        assert line.received(m.MessageInterval)[-1].interval_us == interval_us


def test_rates_asked_for_are_forgotten_once_the_station_is_gone(make_line):
    line = make_line()
    line.command(SET, float(m.FcControl.id), 1e6, source=STATION)
    line.command(SET, float(m.Odometry.id), 2e5, source=STATION)
    line.run(STATION_US * 1e-6 + 0.5)
    line.inbox.clear()
    line.run(1.0)
    assert len(line.received(m.FcControl)) == 100
    assert line.received(m.Odometry) == []


def test_data_stream_of_older_stations_sets_its_group(make_line):
    line = make_line()
    line.run(0.3)
    line.send(m.RequestDataStream(1, 1, mavlink.MAV_DATA_STREAM_POSITION, 10, 1), source=STATION)
    line.send(m.RequestDataStream(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 10, 0), source=STATION)
    line.run(2.0)
    heard = counts(line)
    assert heard[m.LocalPositionNed.id] == pytest.approx(20, abs=1)
    assert heard[m.Attitude.id] == heard[m.AttitudeQuaternion.id] == 0
    assert set(sum(GROUPS.values(), ())) <= set(STREAMS)


def test_all_of_it_at_its_greatest_rates_fits_the_status_share_of_the_air(make_line):
    line = make_line()
    line.run(1.0)
    before = line.bytes_heard
    line.run(2.0)
    quiet = line.bytes_heard - before
    for number in STREAMS:
        line.command(SET, float(number), 1.0, source=STATION)
    line.run(0.2)
    before = line.bytes_heard
    line.run(2.0)
    assert (line.bytes_heard - before - quiet) / 2.0 < 0.8 * STATUS_SHARE


def test_missions_are_none(make_line):
    line = make_line()
    line.send(m.MissionRequestList(1, 1, 0), m.MissionClearAll(1, 1, 0), source=STATION)
    line.run(0.2)
    (count,) = line.received(m.MissionCount)
    assert (count.count, count.target_system, count.target_component) == (0, *STATION)
    (ack,) = line.received(m.MissionAck)
    assert (ack.type, ack.target_system, ack.target_component) == (0, *STATION)


def test_command_int_is_taken_like_command_long(make_line):
    line = make_line()
    for command, first in ((REQUEST, 148.0), (9999, 0.0)):
        line.send(m.CommandInt(1, 1, 1, command, 0, 0, first, 0, 0, 0, 0, 0, 0.0), source=STATION)
    line.run(0.2)
    assert acks(line) == [(REQUEST, 0, STATION), (9999, 3, STATION)]
    assert len(line.received(m.AutopilotVersion)) == 1


def test_interval_without_end_is_bounded_by_what_an_answer_can_say(make_line):
    line = make_line()
    line.run(0.5)
    for command, *more in ((SET, 1e12), (GET,)):
        line.command(command, float(m.Attitude.id), *more)
        line.run(0.1)
    (answer,) = line.received(m.MessageInterval)
    assert (answer.message_id, answer.interval_us) == (m.Attitude.id, INTERVAL_MAX_US)
    assert line.flight.outbox.unsendable == 0


def test_estimate_that_is_broken_ends_nothing(make_line):
    """What can carry it goes out as it is; the rest is counted, not sent."""
    line = make_line()
    line.run(1.0)
    line.flight.flight._memory[0:13] = memoryview(array("d", [math.nan] * 13))
    with_station(line, 2)
    assert math.isnan(line.received(m.Attitude)[-1].roll)
    assert math.isnan(line.received(m.LocalPositionNed)[-1].x)
    assert line.flight.state is State.STANDBY


def test_landed_state_in_offboard_is_told_by_height(make_session):
    session = make_session()
    session.run(1.0)
    session.command(400, 1.0)
    session.run_to(State.ARMED, 1.0)

    def stream(height, seconds):
        for _ in range(round(10 * seconds)):
            session.send(m.SetPositionTarget(0, 1, 1, 1, 0b1101_1100_0111, 0, 0, 0, 0, 0, -height, *[0] * 5))
            session.run(0.1)

    def landed():
        session.command(REQUEST, float(m.ExtendedSysState.id))
        session.run(0.1)
        return session.received(m.ExtendedSysState)[-1].landed_state

    stream(0.0, 0.2)
    session.command(176, 1.0, 6.0)
    stream(0.0, 1.0)
    assert session.flight.state is State.OFFBOARD
    assert landed() == mavlink.MAV_LANDED_STATE_ON_GROUND
    stream(0.5, 2.0)
    assert landed() == mavlink.MAV_LANDED_STATE_IN_AIR
