"""Flights and their failures against a small rigid body: what the vehicle does, not how."""

import math

import pytest

from trimtab.firmware_model.flight.condition_monitor import FLOOR_HEIGHT
from trimtab.firmware_model.flight.failsafe import Action, Failsafe
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.law import step as law
from trimtab.protocol.parameters import DEFAULTS

PHASES = [
    State.BOOT,
    State.STANDBY,
    State.TAKEOFF,
    State.TRACKING,
    State.HOLD,
    State.LANDING,
    State.STANDBY,
]


def test_flight_as_planned_tracks_within_three_centimetres_and_ends_in_standby(make_rig):
    rig = make_rig()
    rig.take_off()
    worst = 0.0
    while rig.flight.state is not State.STANDBY:
        rig.tick()
        if rig.flight.state is State.TRACKING:
            worst = max(worst, math.dist(rig.flight.outputs["reference"][0:3], rig.body.p))
        assert rig.now_us < 20_000_000
    assert rig.seen == PHASES
    assert worst < 0.03
    assert rig.flight.failsafe is Failsafe.NONE
    assert rig.flight.tracking_us == 1_000_000 + 2_188_000 + 1_000_000
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert math.hypot(rig.body.p[0], rig.body.p[1]) < 0.03
    rig.tick()
    assert max(rig.command) == 0.0
    assert "reference ended: holding, then landing" in rig.texts
    assert "no touchdown detected: motors off" not in rig.texts


def test_hold_lasts_as_long_as_the_parameter_says(make_rig):
    rig = make_rig(parameters={"HOLD_S": 0.5})
    rig.track()
    rig.run(5.0, until=State.HOLD)
    start = rig.now_us
    rig.run(5.0, until=State.LANDING)
    assert rig.now_us - start == 500_000


def test_vehicle_armed_on_a_table_learns_neither_thrust_ratio_nor_disturbance(make_rig, make_body):
    rig = make_rig(body=make_body(p=(0.0, 0.0, -1.0)))
    rig.standby()
    assert rig.flight.height_m > 2.0 * DEFAULTS["LAND_HEIGHT"]
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    rig.run(1.0)
    assert rig.flight.state is State.ARMED
    assert rig.flight.monitor.thrust_ratio == 1.0
    assert rig.flight._observing[0] == 0.0


def test_boot_ends_after_its_time_and_arms_nothing_before(make_rig):
    rig = make_rig()
    rig.run(0.1)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == "still booting"
    rig.run(1.0, until=State.STANDBY)
    assert 200_000 <= rig.now_us <= 211_000


def test_gyro_calibration_finds_the_bias_before_the_flight(make_rig):
    rig = make_rig()
    rig.standby()
    assert rig.flight.calibration.bias == pytest.approx(rig.gyro_bias, abs=1e-9)
    assert list(rig.flight._memory[law.EST_BIAS]) == pytest.approx(rig.gyro_bias, abs=1e-3)


def test_start_without_reference_is_refused_with_the_reason_and_arming_warns(make_rig):
    rig = make_rig(reference=False)
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    rig.tick()
    assert "no live reference: start will be refused" in rig.texts
    assert rig.flight.handle_event(Event.START, rig.now_us) == "no live reference: upload one"
    assert rig.flight.state is State.ARMED


def test_arm_without_mocap_is_refused_with_the_reason(make_rig):
    rig = make_rig()
    rig.mocap = False
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == "no mocap"
    rig.mocap = True
    rig.run(0.1)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None


def test_arm_while_shaken_is_refused_as_not_calibrated(make_rig):
    rig = make_rig()
    for k in range(1_000):
        rig.body.w = [0.5 * math.sin(0.3 * k), 0.0, 0.0]
        rig.tick()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == "gyro not calibrated: keep still"


def test_arm_when_tilted_is_refused_with_the_reason(make_rig, make_body):
    body = make_body()
    c, s = math.cos(0.5), math.sin(0.5)
    body.R = [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]
    body.force = (0.0, -9.81 * s, -9.81 * c)
    rig = make_rig(body=body)
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) == "tilted"


def test_armed_without_start_disarms_after_its_time(make_rig):
    rig = make_rig(parameters={"IDLE_S": 2.0})
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    start = rig.now_us
    rig.run(3.0, until=State.STANDBY)
    assert 2_000_000 <= rig.now_us - start <= 2_020_000
    assert max(rig.command) == 0.0


def test_estimate_starts_at_the_pose_and_again_after_a_long_gap(make_rig, make_body):
    rig = make_rig(body=make_body(p=(2.0, -1.0, 0.0), yaw=1.2))
    rig.standby()
    assert rig.estimate() == pytest.approx((2.0, -1.0, 0.0), abs=1e-2)
    rig.mocap = False
    rig.run(1.0)
    rig.body.p = [-3.0, 0.5, 0.0]  # somebody carries it
    rig._air.clear()
    rig.mocap = True
    rig.run(0.05)
    assert rig.estimate() == pytest.approx((-3.0, 0.5, 0.0), abs=1e-3)


def test_mocap_lost_in_flight_descends_level_and_stops(make_rig):
    rig = make_rig()
    rig.track()
    rig.run(1.0)  # at full speed
    rig.mocap = False
    lost = rig.now_us
    rig.run(1.0, until=State.FAILSAFE)
    assert 490_000 <= rig.now_us - lost <= 520_000
    assert (rig.flight.failsafe, rig.flight.action) == (Failsafe.MOCAP_LOST, Action.LEVEL_DESCENT)
    fastest = 0.0
    while rig.flight.state is State.FAILSAFE:
        rig.tick()
        fastest = max(fastest, rig.body.v[2])
        if rig.now_us - lost > 1_800_000:
            assert rig.body.R[2][2] > math.cos(math.radians(10.0))  # level
        assert rig.now_us - lost < 8_000_000
    assert rig.flight.state is State.STANDBY
    assert rig.body.p[2] == 0.0
    assert fastest < 1.2
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST  # said until the next arming
    rig.tick()
    assert max(rig.command) == 0.0


@pytest.mark.parametrize("gain", [0.9, 1.1, 1.4])
def test_mocap_lost_with_thrust_off_nominal_still_comes_down(make_rig, make_body, gain):
    rig = make_rig(body=make_body(gain=gain))
    rig.track()
    rig.run(0.5)
    rig.mocap = False
    rig.run(10.0, until=State.STANDBY)
    assert rig.body.p[2] == 0.0


def test_mocap_short_gap_is_flown_through(make_rig):
    rig = make_rig()
    rig.track()
    rig.mocap = False
    rig.run(0.4)
    rig.mocap = True
    rig.run(10.0, until=State.LANDING)
    assert rig.flight.failsafe is Failsafe.NONE


def test_link_lost_in_flight_stops_and_lands_in_place(make_rig):
    rig = make_rig(parameters={"FS_LINK_S": 0.5})
    rig.track()
    rig.run(0.5)
    rig.host = False
    rig.run(1.0, until=State.FAILSAFE)
    assert (rig.flight.failsafe, rig.flight.action) == (Failsafe.LINK_LOST, Action.LAND_IN_PLACE)
    place = rig.body.p[0]
    rig.run(10.0, until=State.STANDBY)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert place < rig.body.p[0] < place + 1.0
    assert "no touchdown detected: motors off" not in rig.texts


def test_link_lost_then_mocap_lost_escalates_and_keeps_the_first_cause(make_rig):
    rig = make_rig(parameters={"FS_LINK_S": 0.5})
    rig.track()
    rig.host = False
    rig.run(2.0, until=State.FAILSAFE)
    rig.mocap = False
    rig.run(0.6)
    assert (rig.flight.failsafe, rig.flight.action) == (Failsafe.LINK_LOST, Action.LEVEL_DESCENT)
    rig.mocap = True  # no way back
    rig.run(0.1)
    assert rig.flight.action is Action.LEVEL_DESCENT
    rig.run(10.0, until=State.STANDBY)
    assert rig.body.p[2] == 0.0


def test_tilt_beyond_its_bound_stops_the_motors(make_rig):
    rig = make_rig(parameters={"FS_TILT_DEG": 10.0, "FS_TILT_S": 0.1})
    rig.track()
    rig.run(1.5, until=State.FAILSAFE)  # the reference tilts further than that
    assert (rig.flight.failsafe, rig.flight.action) == (Failsafe.TILT, Action.MOTORS_OFF)
    rig.tick()
    assert max(rig.command) == 0.0
    rig.run(3.0, until=State.STANDBY)
    assert rig.flight.failsafe is Failsafe.TILT


def test_failures_on_the_floor_disarm_without_a_failsafe_flight(make_rig):
    rig = make_rig()
    rig.standby()
    rig.flight.handle_event(Event.ARM, rig.now_us)
    rig.mocap = False
    rig.run(1.0)
    assert rig.flight.state is State.STANDBY
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST
    rig.mocap = True
    rig.run(0.1)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.failsafe is Failsafe.NONE


def test_land_command_in_full_flight_brakes_and_comes_down_near(make_rig):
    rig = make_rig()
    rig.track()
    rig.run(0.9)
    place = tuple(rig.body.p)
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    rig.run(10.0, until=State.STANDBY)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert math.dist(rig.body.p[:2], place[:2]) < 1.0
    assert rig.flight.failsafe is Failsafe.NONE


def test_disarm_in_flight_is_refused_and_kill_is_not(make_rig):
    rig = make_rig()
    rig.track()
    assert rig.flight.handle_event(Event.DISARM, rig.now_us) is not None
    assert rig.flight.handle_event(Event.KILL, rig.now_us) is None
    rig.tick()
    assert max(rig.command) == 0.0


def test_climb_towards_a_far_node_goes_up_first(make_rig, make_body):
    rig = make_rig(body=make_body(p=(-2.0, 0.0, 0.0)))
    rig.take_off()
    while rig.body.p[2] > -0.9:
        rig.tick()
        assert abs(rig.body.p[0] + 2.0) < 0.05
    rig.run(10.0, until=State.TRACKING)
    assert rig.body.p == pytest.approx([0.0, 0.0, -1.0], abs=0.03)


def test_second_flight_after_the_first_works_the_same(make_rig):
    rig = make_rig()
    for _ in range(2):
        rig.standby()
        assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
        rig.flight.handle_event(Event.START, rig.now_us)
        rig.run(20.0, until=State.STANDBY)
        rig.run(0.1)
        assert rig.body.p[2] == 0.0
    assert rig.seen == PHASES + PHASES[2:]


@pytest.mark.parametrize(
    ("pose", "why"),
    [
        ((900_000, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)), "no quaternion"),
        ((900_000, (math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), "not finite"),
        ((900_000, (1e30, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), "out of this world"),
        ((1_100_000, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), "from the future"),
        ((700_000, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), "too old"),
    ],
)
def test_pose_that_makes_no_sense_is_not_used(make_rig, pose, why):
    rig = make_rig()
    rig.mocap = False
    rig.standby()
    assert not rig.flight.pose(*pose, rig.now_us), why
    assert rig.flight.poses.used == 0


def test_pose_repeated_or_out_of_order_is_used_once(make_rig):
    rig = make_rig()
    rig.mocap = False
    rig.standby()
    p, q = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    assert rig.flight.pose(990_000, p, q, rig.now_us)
    assert not rig.flight.pose(990_000, p, q, rig.now_us)
    assert not rig.flight.pose(980_000, p, q, rig.now_us)
    assert rig.flight.pose(995_000, p, q, rig.now_us)
    rig.run(0.002)
    assert rig.flight.poses.used == 2


def test_poses_that_repeat_one_to_the_bit_are_used_on_the_floor_and_not_in_flight(make_rig):
    rig = make_rig()
    rig.mocap = False
    place = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    rig.run(0.3)
    for _ in range(70):
        rig.run(0.01)
        assert rig.flight.pose(rig.now_us, *place, rig.now_us)
    rig.mocap = True
    rig.take_off()
    while rig.flight.height_m < 0.4:
        rig.run(0.01)
    rig.mocap = False
    p, q = tuple(rig.body.p), rig.body.quaternion()
    now_us = rig.now_us
    assert rig.flight.pose(now_us, p, q, now_us)
    assert not rig.flight.pose(now_us + 1_000, p, q, now_us + 1_000)
    assert not rig.flight.pose(now_us + 2_000, p, q, now_us + 2_000)
    assert rig.flight.pose(now_us + 3_000, (*p[:2], p[2] - 1e-6), q, now_us + 3_000)


def test_takeoff_under_poses_that_repeat_the_last_one_on_the_floor_ends_low(make_rig):
    rig = make_rig()
    rig.take_off()
    rig.mocap = False
    place, heights = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), []
    for _ in range(500):  # without the check on the floor it climbed until the poses came back
        rig.flight.pose(rig.now_us, *place, rig.now_us)
        rig.run(0.01)
        heights.append(-rig.body.p[2])
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST
    assert max(heights) < 0.5
    assert heights[-1] == 0.0


def test_outliers_on_the_floor_are_rejected_once_it_is_armed(make_rig):
    rig = make_rig()
    rig.standby()
    far = (8.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    for _ in range(20):
        rig.run(0.01)
        assert not rig.flight.pose(rig.now_us, *far, rig.now_us)
    assert rig.estimate() == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)


def test_poses_that_repeat_one_to_the_bit_are_used_where_it_hovers_without_any_motion(make_session):
    session = make_session()  # no noise anywhere, poses of single precision
    session.run(1.0)
    session.command(400, 1.0)
    session.run_to(State.ARMED, 1.0)
    session.command(22, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    session.run_to(State.HOLD)
    session.run(8.0)
    assert session.flight.state is State.HOLD


def observed(rig):
    return rig.flight._memory[law.OBSERVER].tolist()


def test_observer_finds_weak_rotors_in_the_climb_and_keeps_that_through_the_landing(make_rig, make_body):
    rig = make_rig(parameters={"OBS_GAIN": 5.0}, body=make_body(gain=0.9))
    rig.take_off()
    while rig.body.p[2] > -0.4:
        rig.tick()
        assert observed(rig) == [0.0] * 3
    rig.run(10.0, until=State.TRACKING)
    assert observed(rig) == pytest.approx([0.0, 0.0, 9.81 / 0.9 - 9.81], abs=0.05)
    assert rig.body.p[2] == pytest.approx(-1.0, abs=0.005)
    rig.run(10.0, until=State.LANDING)
    kept = observed(rig)
    while rig.flight.state is State.LANDING:
        assert observed(rig) == kept
        rig.tick()
    rig.tick()
    assert observed(rig) == [0.0] * 3


def test_observer_forgets_in_a_level_descent(make_rig, make_body):
    rig = make_rig(parameters={"OBS_GAIN": 5.0}, body=make_body(gain=0.9))
    rig.track()
    rig.mocap = False
    rig.run(2.0, until=State.FAILSAFE)
    rig.tick()
    assert observed(rig) == [0.0] * 3
    rig.run(10.0, until=State.STANDBY)
    assert "no touchdown detected: motors off" not in rig.texts


def test_parameters_of_the_law_are_the_tables(make_rig):
    rig = make_rig(parameters={"POS_P_N": 3.5})
    vector = dict(zip(law.PARAMETERS, rig.flight._law_parameters, strict=True))
    assert vector["POS_P_N"] == 3.5
    assert set(law.SOURCES) <= set(DEFAULTS)


def test_poses_of_two_sources_in_flight_are_both_refused_and_the_vehicle_descends(make_rig):
    rig = make_rig()
    rig.track()
    rig.run(0.5)
    for k in range(40):
        rig.run(0.005)
        x, y, z = rig.body.p
        if k % 2:  # beside the true ones, which are older
            rig.flight.pose(rig.now_us, (x + 0.3, y, z), rig.body.quaternion(), rig.now_us)
    assert "poses of two sources: none is used" in rig.texts
    rig.run(20.0, until=State.STANDBY)
    assert State.FAILSAFE in rig.seen
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST


@pytest.mark.parametrize("wrong", [range(30, 45), range(0, 100, 9)])
def test_wrong_poses_one_after_the_other_or_now_and_then_are_no_second_source(make_rig, wrong):
    rig = make_rig()
    rig.track()
    rig.run(0.3)
    rig.mocap = False
    for k in range(100):
        rig.run(0.010)
        x, y, z = rig.body.p
        away = 3.0 if k in wrong else 0.0
        rig.flight.pose(rig.now_us, (x + away, y, z), rig.body.quaternion(), rig.now_us)
    assert not any("two sources" in text for text in rig.texts)
    assert rig.flight.state is not State.FAILSAFE


def test_same_poses_forwarded_twice_are_no_second_source(make_rig):
    rig = make_rig()
    rig.track()
    rig.mocap = False
    for _ in range(100):
        rig.run(0.010)
        for ahead_us in (0, -40):  # two forwarders compare clocks a little differently
            rig.flight.pose(rig.now_us + ahead_us, tuple(rig.body.p), rig.body.quaternion(), rig.now_us)
    assert not any("two sources" in text for text in rig.texts)


def test_detection_of_two_sources_can_be_switched_off(make_rig):
    rig = make_rig(parameters={"EST_CLASH": 0.0})
    rig.track()
    for k in range(40):
        rig.run(0.005)
        x, y, z = rig.body.p
        if k % 2:
            rig.flight.pose(rig.now_us, (x + 3.0, y, z), rig.body.quaternion(), rig.now_us)
    assert not any("two sources" in text for text in rig.texts)
