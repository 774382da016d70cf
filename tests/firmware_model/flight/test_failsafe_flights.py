"""Every row of the failsafe table in a flight, lock-step: what strikes, when, what is done, where it ends."""

from __future__ import annotations

import math

import pytest

from trimtab.firmware_model.flight.condition_monitor import FLOOR_HEIGHT
from trimtab.firmware_model.flight.failsafe import BY_EVENT, Action, Failsafe
from trimtab.firmware_model.flight.setpoints import AttitudeTarget
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink
from trimtab.protocol.parameters import DEFAULTS

NEVER = 10.0


def struck_after(rig, event, most_s=NEVER):
    """Seconds until the event's row has ended the flight."""
    row, start = BY_EVENT[event], rig.now_us
    rig.run(most_s, until=State.FAILSAFE)
    assert (rig.flight.failsafe, rig.flight.action) == (row.failsafe, row.action)
    assert rig.flight.conditions & 1 << row.failsafe
    assert row.text in rig.texts
    return 1e-6 * (rig.now_us - start)


def on_the_floor(rig, seconds=15.0):
    rig.run(seconds, until=State.STANDBY)
    rig.tick()
    assert max(rig.command) == 0.0


def landed_softly(rig):
    on_the_floor(rig)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert "no touchdown detected: motors off" not in rig.texts


def in_quick_flight(rig, make_track):
    """The rig, at the start of 3 m there and back in 1.6 s each."""
    rig.flight.reference = make_track(reach=3.0, seconds=1.6)
    rig.track()
    return rig


def test_imu_stuck_stops_the_motors_within_its_time(make_rig):
    rig = make_rig()
    rig.track()
    rig.run(0.7)
    rig.frozen = True
    assert DEFAULTS["FS_IMU_S"] < struck_after(rig, Event.IMU_STUCK) <= DEFAULTS["FS_IMU_S"] + 0.02
    assert rig.body.R[2][2] > 0.7  # before it has tipped over
    on_the_floor(rig)


def test_mocap_late_lands_in_place(make_rig):
    rig = make_rig(parameters={"FS_AGE_S": 0.04})
    rig.track()
    rig.run(0.2)
    rig.mocap_age_us = 50_000
    # The newest pose grows older until the next one, which comes old.
    assert struck_after(rig, Event.MOCAP_LATE) == pytest.approx(DEFAULTS["FS_LATE_S"] + 0.04, abs=0.03)
    landed_softly(rig)


@pytest.mark.parametrize("age_ms", [120, 145])
def test_mocap_that_stays_late_in_quick_flight_is_flown_and_landed_with(make_rig, make_track, age_ms):
    rig = in_quick_flight(make_rig(), make_track)
    rig.run(0.5)
    rig.mocap_age_us = 1_000 * age_ms
    tilt, off_m = 0.0, 0.0
    while rig.flight.state is not State.STANDBY:
        rig.run(0.01)
        tilt = max(tilt, math.degrees(math.acos(min(1.0, rig.body.R[2][2]))))
        off_m = max(off_m, math.dist(rig.estimate(), rig.body.p))
        assert rig.now_us < 20_000_000
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST
    assert BY_EVENT[Event.MOCAP_LATE].text in rig.texts
    assert tilt < 60.0  # 54 deg with poses in time
    assert off_m < 0.25
    landed_softly(rig)


@pytest.mark.parametrize("age_ms", [160, 195])
def test_mocap_too_late_for_the_estimate_is_a_loss_of_poses(make_rig, make_track, age_ms):
    rig = in_quick_flight(make_rig(), make_track)
    rig.run(0.5)
    rig.mocap_age_us = 1_000 * age_ms
    rig.run(1.0, until=State.FAILSAFE)
    assert (rig.flight.failsafe, rig.flight.action) == (Failsafe.MOCAP_LOST, Action.LEVEL_DESCENT)


def test_mocap_lost_and_then_late_is_the_level_descent(make_rig):
    rig = make_rig()
    rig.track()
    rig.mocap = False
    assert struck_after(rig, Event.MOCAP_LOST) == pytest.approx(DEFAULTS["FS_MOCAP_S"], abs=0.02)
    rig.run(1.0)
    assert rig.flight.action is Action.LEVEL_DESCENT


@pytest.mark.parametrize(
    ("high", "low"),
    [
        pytest.param(0.88, 1.04, id="a line that slackens"),
        pytest.param(1.05, 0.9, id="air that sinks below"),
        pytest.param(0.9, 0.9, id="weak rotors"),
    ],
)
def test_level_descent_ends_on_the_floor_where_thrust_is_worth_more_or_less_below(make_rig, high, low):
    rig = make_rig(reference=False)
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 2.0) is None

    def fly():
        share = min(max((-rig.body.p[2] - 0.5) / 1.5, 0.0), 1.0)
        rig.body.gain = low + (high - low) * share
        rig.run(0.01)

    while rig.flight.state is not State.HOLD:
        fly()
    for _ in range(100):
        fly()
    rig.mocap = False
    touched_us = None
    while rig.flight.state is not State.STANDBY:
        fly()
        if touched_us is None and rig.body.p[2] > -0.01:
            touched_us = rig.now_us
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST
    assert touched_us is not None
    assert rig.now_us - touched_us < 500_000
    landed_softly(rig)


def test_level_descent_rejects_the_poses_that_come_back(make_rig):
    rig = make_rig(reference=False)
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 2.0) is None
    rig.run(20.0, until=State.HOLD)
    rig.mocap = False
    rig.run(2.0, until=State.FAILSAFE)
    rig.mocap = True
    assert not rig.flight.pose(rig.now_us, rig.body.p, rig.body.quaternion(), rig.now_us)
    on_the_floor(rig)
    landed_softly(rig)
    rig.run(0.1)
    assert rig.flight.pose(rig.now_us, rig.body.p, rig.body.quaternion(), rig.now_us)


def test_landing_commanded_in_a_climb_near_the_floor_ends_on_the_floor(make_rig, make_body):
    """At the top of the climb the vehicle is low and slow, with the reference below it, but not carried."""
    rig = make_rig(
        body=make_body(gain=1.08), reference=False, parameters={"LAND_SPEED": 0.1, "LAND_STOP_SPEED": 0.3}
    )
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 1.0) is None
    while rig.body.p[2] > -0.12:
        rig.run(0.01)
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    while rig.flight.rotors_on:
        rig.run(0.01)
    assert rig.body.p[2] > -FLOOR_HEIGHT - 0.01


def test_level_descent_that_touches_as_velocity_is_given_up_is_noticed(make_rig):
    rig = make_rig(reference=False)
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 2.95) is None
    rig.run(20.0, until=State.HOLD)
    rig.run(1.0)
    rig.mocap = False
    while rig.body.p[2] < -0.01:
        rig.run(0.01)
    touched_us = rig.now_us
    on_the_floor(rig)
    assert rig.now_us - touched_us < 1_200_000
    landed_softly(rig)


@pytest.mark.parametrize("down_m", [0.7, 3.0, 7.0, 20.0])
@pytest.mark.parametrize("height_m", [0.3, 1.0, 1.5])
def test_one_pose_far_below_during_a_landing_does_not_stop_the_rotors(make_rig, height_m, down_m):
    rig = make_rig(reference=False)
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 2.0) is None
    rig.run(15.0, until=State.HOLD)
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    while -rig.body.p[2] > height_m:
        rig.run(0.01)
    n, e, d = rig.body.p
    assert not rig.flight.pose(rig.now_us - 1_000, (n, e, d + down_m), rig.body.quaternion(), rig.now_us)
    landed_softly(rig)
    assert rig.flight.failsafe is Failsafe.NONE


@pytest.mark.parametrize(
    "swapped",
    [
        pytest.param(lambda p, q: ((p[0] + 4.0, p[1], p[2]), q), id="another body"),
        pytest.param(lambda p, q: (p, (-q[3], q[2], -q[1], q[0])), id="markers swapped, half a turn"),
    ],
)
def test_poses_that_stay_far_from_the_estimate_are_a_loss_of_poses(make_rig, swapped):
    rig = make_rig()
    rig.track()
    rig.run(0.5)
    rig.mocap = False
    start_us = rig.now_us
    while rig.flight.state is not State.FAILSAFE:
        rig.run(0.01)
        rig.flight.pose(rig.now_us, *swapped(rig.body.p, rig.body.quaternion()), rig.now_us)
        assert rig.now_us - start_us <= 1e6 * DEFAULTS["FS_MOCAP_S"] + 30_000
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST
    assert math.dist(rig.estimate(), rig.body.p) < 0.15
    landed_softly(rig)


@pytest.mark.parametrize("stay_s", [0.0, 0.3, 0.6, 0.9, 1.2])
def test_poses_after_a_gap_in_quick_flight_are_taken_again(make_rig, make_track, stay_s):
    rig = in_quick_flight(make_rig(), make_track)
    rig.run(stay_s)
    while rig.flight.state is State.TRACKING:
        rig.mocap = False
        rig.run(0.45)
        rig.mocap = True
        rig.run(0.1)
        assert rig.now_us - rig.flight.monitor.pose_us < 30_000
    assert rig.flight.failsafe is Failsafe.NONE
    on_the_floor(rig)


@pytest.mark.parametrize("stay_s", [0.0, 0.5, 1.2])
def test_poses_that_stand_still_in_flight_are_a_loss_of_poses(make_rig, make_track, stay_s):
    rig = in_quick_flight(make_rig(), make_track)
    rig.run(stay_s)
    rig.mocap = False
    p, q, start_us = tuple(rig.body.p), rig.body.quaternion(), rig.now_us
    while rig.flight.state is not State.FAILSAFE:
        rig.run(0.01)
        rig.flight.pose(rig.now_us - 10_000, p, q, rig.now_us)
        assert rig.now_us - start_us <= 1e6 * DEFAULTS["FS_MOCAP_S"] + 30_000
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST
    assert math.dist(rig.estimate(), rig.body.p) < 0.15
    landed_softly(rig)


def test_gap_of_poses_that_is_flown_through_is_not_late_either(make_rig):
    rig = make_rig(parameters={"FS_LATE_S": 0.5})
    rig.track()
    for _ in range(3):
        rig.mocap = False
        rig.run(0.4)
        rig.mocap = True
        rig.run(0.2)
    assert rig.flight.failsafe is Failsafe.NONE


def test_geofence_left_lands_in_place(make_rig):
    rig = make_rig(parameters={"FENCE_N_MAX": 0.4, "FS_FENCE_M": 0.2})
    rig.track()  # the reference leads to 1.5 m
    while rig.body.p[0] < 0.6:
        rig.tick()
    assert struck_after(rig, Event.FENCE_LEFT) == pytest.approx(DEFAULTS["FS_FENCE_S"], abs=0.03)
    landed_softly(rig)


def test_geofence_ends_a_flight_by_rates_too(make_rig):
    rig = make_rig(reference=False, parameters={"FENCE_D_MIN": -2.0})
    rig.standby()
    rig.flight.handle_event(Event.ARM, rig.now_us)
    rig.flight.handle_event(Event.TAKEOFF, rig.now_us)
    rig.run(10.0, until=State.HOLD)
    rise = AttitudeTarget(thrust=0.25, rate=(0.0, 0.0, 0.0))
    rig.flight.setpoint(rise, rig.now_us)
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) is None
    highest = 0.0
    for _ in range(300):
        rig.flight.setpoint(rise, rig.now_us)
        rig.run(0.01)
        highest = max(highest, -rig.body.p[2])
    assert (rig.flight.state, rig.flight.failsafe) == (State.FAILSAFE, Failsafe.GEOFENCE)
    assert highest < 2.0 + 0.2  # it stops at the fence, not FS_FENCE_M past it
    landed_softly(rig)


def test_battery_low_lands_in_place(make_rig):
    rig = make_rig()
    rig.track()
    rig.battery_v = 12.0
    low = DEFAULTS["BAT_EMPTY_V"] + DEFAULTS["FS_BAT_SHARE"] * (
        DEFAULTS["BAT_FULL_V"] - DEFAULTS["BAT_EMPTY_V"]
    )
    expected = DEFAULTS["FS_BAT_S"] * math.log((16.8 - 12.0) / (low - 12.0))
    assert struck_after(rig, Event.BATTERY_LOW) == pytest.approx(expected, rel=0.02)
    landed_softly(rig)
    rig.run(0.2)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == "battery low: charge it"


def test_one_voltage_that_is_no_number_ends_nothing_and_hides_nothing(make_rig):
    rig = make_rig()
    rig.track()
    rig.battery_v = math.nan
    rig.run(0.05)
    rig.battery_v = 16.8
    rig.run(0.5)
    assert rig.flight.failsafe is Failsafe.NONE
    rig.battery_v = 12.0
    struck_after(rig, Event.BATTERY_LOW)


def test_motors_saturated_for_long_land_in_place(make_rig, make_body):
    """Rotors that carry it with little to spare, and then something that hangs on to it."""
    limits = {"THRUST_MAX": 2.5, "LIM_THR_HI": 1.0, "FS_SAT_S": 0.5}
    rig = make_rig(reference=False, parameters=limits, body=make_body(gain=2.5 / DEFAULTS["THRUST_MAX"]))
    rig.standby()
    rig.flight.handle_event(Event.ARM, rig.now_us)
    rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 3.0)
    rig.run(10.0, until=State.HOLD)
    assert rig.flight.saturated_ticks < 100
    rig.body.mass *= 1.5
    start, before = rig.now_us, rig.flight.saturated_ticks
    struck_after(rig, Event.SATURATED, 3.0)
    saturated = rig.flight.saturated_ticks - before
    assert 450 <= saturated <= 560  # ticks, one after the other
    assert rig.now_us - start < 1_500_000
    assert rig.body.p[2] < -1.0


def test_tilt_and_link_rows_strike_at_their_times(make_rig):
    rig = make_rig(parameters={"FS_TILT_DEG": 10.0})
    rig.track()
    while rig.body.R[2][2] > math.cos(math.radians(10.0)):
        rig.tick()
    assert struck_after(rig, Event.TILTED) == pytest.approx(DEFAULTS["FS_TILT_S"], abs=0.03)
    rig = make_rig(parameters={"FS_LINK_S": 1.0})
    rig.track()
    rig.run(0.05)
    rig.host = False
    assert struck_after(rig, Event.LINK_LOST) == pytest.approx(1.0, abs=0.1)
    landed_softly(rig)


def test_late_ticks_land_in_place(make_session):
    session = make_session(parameters={"FS_LOOP_MAX": 50})
    session.run(1.0)
    session.command(400, 1.0)
    session.command(22)
    session.run_to(State.HOLD)
    session.every_us = 2_000
    start = session.now_us
    session.run_to(State.FAILSAFE, 2.0)
    assert 1e-6 * (session.now_us - start) == pytest.approx(0.1, abs=0.012)
    session.every_us = 1_000
    session.run_to(State.STANDBY)
    status = session.received(m.FcStatus)[-1]
    assert status.failsafe == mavlink.TRIMTAB_FAILSAFE_LOOP_OVERRUN
    assert "ticks too late: landing in place" in session.texts()


def test_conditions_are_told_while_they_hold_and_not_after(make_session):
    session = make_session()
    session.run(1.0)
    assert session.received(m.FcStatus)[-1].conditions == 0
    session.mocap, session.battery_v = False, 13.0
    session.run(8.0)
    told = session.received(m.FcStatus)[-1].conditions
    assert told == 1 << Failsafe.MOCAP_LOST | 1 << Failsafe.BATTERY_LOW
    session.command(401)
    session.run(0.2)
    assert session.received(m.CommandAck)[-1].result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    asked = [text for text in session.texts() if text.startswith("not ready: ")]
    assert asked == ["not ready: no mocap", "not ready: mocap late", "not ready: battery low: charge it"]
    session.mocap, session.battery_v = True, 16.8
    session.run(8.0)
    assert session.received(m.FcStatus)[-1].conditions == 0
    session.command(401)
    session.run(0.2)
    assert session.received(m.CommandAck)[-1].result == mavlink.MAV_RESULT_ACCEPTED
    assert session.texts()[-1] == "ready to arm"


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda rig: setattr(rig, "frozen", True), "IMU stuck: it repeats one sample"),
        (lambda rig: setattr(rig, "mocap", False), "no mocap"),
        (lambda rig: setattr(rig, "mocap_age_us", 150_000), "mocap late"),
        (lambda rig: setattr(rig, "battery_v", 12.0), "battery low: charge it"),
        (lambda rig: setattr(rig, "host", False), "no host heard"),
        (lambda rig: rig.body.p.__setitem__(0, 11.0), "outside the fence"),
    ],
)
def test_what_would_end_a_flight_refuses_arming(make_rig, spoil, reason):
    rig = make_rig()
    rig.standby()
    assert rig.flight.arming_reasons(rig.now_us) == []
    spoil(rig)
    rig.run(12.0)
    assert reason in rig.flight.arming_reasons(rig.now_us)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == rig.flight.arming_reasons(rig.now_us)[0]


def hovering(rig, height=2.0):
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, height) is None
    rig.run(15.0, until=State.HOLD)
    rig.run(0.5)


def test_one_pose_after_a_gap_is_not_enough_to_arm(make_rig):
    """The camera system is off, and another station sends a pose of its own."""
    rig = make_rig()
    rig.standby()
    rig.mocap = False
    rig.run(1.0)
    assert rig.flight.pose(rig.now_us, (0.0, 0.0, -2.8), (1.0, 0.0, 0.0, 0.0), rig.now_us)
    rig.run(0.3)
    assert rig.flight.has_pose(rig.now_us)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == "no mocap"
    rig.mocap = True
    rig.run(2.0)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None


def test_late_poses_do_not_feign_a_touchdown(make_rig):
    """With late poses the estimated height may be wrong by decimetres."""
    rig = make_rig(reference=False)
    hovering(rig, 1.0)
    rig.mocap_age_us = 120_000
    rig.run(0.1)
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    rig.flight._phases.floor, last = -0.3, math.inf  # as if the estimate were too low
    while rig.flight.state is not State.STANDBY:
        last = -rig.body.p[2]
        rig.run(0.01)
    assert last < FLOOR_HEIGHT


@pytest.mark.parametrize("after_s", [0.0, 0.01, 0.1, 0.4])
def test_vehicle_that_was_killed_in_the_air_is_not_armed_in_its_fall(make_rig, after_s):
    """It would take the height where it was armed for the floor."""
    rig = make_rig(reference=False)
    hovering(rig, 3.0)
    assert rig.flight.handle_event(Event.KILL, rig.now_us) is None
    rig.run(after_s)
    assert rig.body.p[2] < -2.0
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == "moving: let it stand still"
    rig.run(3.0)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None


def test_vehicle_is_not_armed_while_it_is_carried_about(make_rig):
    rig = make_rig(reference=False)
    rig.standby()
    rig.body.p[2] = -1.0
    for _ in range(1_000):
        rig.tick()
        rig.body.p[0], rig.body.p[2], rig.body.v = 0.8e-6 * rig.now_us, -1.0, [0.8, 0.0, 0.0]
        rig.body.force = (0.0, 0.0, -9.81)
    assert rig.flight.arming_reasons(rig.now_us) == ["moving: let it stand still"]


@pytest.mark.parametrize(
    ("askew_deg", "reason"), [(9.0, None), (12.0, "poses tilted: fix frame or rigid body")]
)
def test_poses_askew_are_not_armed_with(make_rig, make_body, askew_deg, reason):
    """The vehicle stands level, its rigid body was defined on a slope: it would lean as far, and drift."""
    half = math.radians(askew_deg) / 2

    class Askew(type(make_body())):
        def quaternion(self):
            return (math.cos(half), math.sin(half), 0.0, 0.0)

    rig = make_rig(reference=False, body=Askew())
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == reason


def test_battery_too_low_for_the_live_reference_refuses_arming_and_start(make_rig):
    """13.58 V: above what counts as low, below what any reference is accepted with."""
    text = "battery at 13.58 V, below 13.60 V"
    rig = make_rig()
    rig.battery_v = 13.58
    rig.standby()
    assert rig.flight.arming_reasons(rig.now_us) == [text]
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == text
    assert len(f"start refused: {text}") <= 50
    rig.battery_v = 16.8
    rig.run(3.0)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    rig.battery_v = 13.58
    rig.run(30.0)
    assert rig.flight.handle_event(Event.START, rig.now_us) == text
    assert rig.flight.state is State.ARMED
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us) is None  # nothing is known of what it is for


@pytest.mark.parametrize("spare", ["no reference", "no voltage"])
def test_battery_is_not_held_against_a_reference_that_is_not_there_nor_where_not_measured(make_rig, spare):
    rig = make_rig(reference=spare != "no reference", parameters={"FS_BAT_SHARE": 0.0})
    rig.battery_v = 13.58 if spare == "no reference" else 0.0
    rig.standby()
    assert rig.flight.arming_reasons(rig.now_us) == []


def test_arming_checks_the_parameters_together(make_rig):
    rig = make_rig(parameters={"BAT_EMPTY_V": 17.0})
    rig.standby()
    assert "BAT_EMPTY_V not below BAT_FULL_V" in rig.flight.arming_reasons(rig.now_us)


def test_next_arming_clears_the_failsafe(make_rig):
    rig = make_rig(parameters={"FS_LINK_S": 0.5})
    rig.track()
    rig.host = False
    struck_after(rig, Event.LINK_LOST)
    landed_softly(rig)
    assert rig.flight.failsafe is Failsafe.LINK_LOST
    rig.host = True
    rig.run(0.2)
    assert rig.flight.conditions == 0
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.failsafe is Failsafe.NONE
