"""Takeoffs, hovers and setpoints in flight against a small rigid body: errors, limits, timeouts."""

from __future__ import annotations

import math

import pytest

from trimtab.firmware_model.flight.condition_monitor import CLEAR_HEIGHT, FLOOR_HEIGHT
from trimtab.firmware_model.flight.failsafe import Action, Failsafe
from trimtab.firmware_model.flight.setpoints import AttitudeTarget, PositionTarget
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.law import step as law
from trimtab.protocol.parameters import DEFAULTS

NONE3 = (None, None, None)
HOVER = DEFAULTS["MASS"] * 9.81 / (4.0 * DEFAULTS["THRUST_MAX"])


def position(*p, v=NONE3, **more):
    return PositionTarget(p=p, v=v, **more)


def velocity(*v, **more):
    return PositionTarget(p=NONE3, v=v, **more)


class Checks:
    """Follows a rig's reference from tick to tick: no steps in it, and how far the vehicle is from it."""

    def __init__(self, rig):
        self.rig = rig
        self.worst = self.fastest = self.hardest = 0.0
        self._last = None

    def tick(self):
        rig = self.rig
        rig.tick()
        now = tuple(rig.flight.outputs["reference"])
        if self._last is not None:
            last, dt = self._last, 1e-3
            for k, bound in ((0, 1e-4), (3, 1e-3), (6, 0.15)):  # p, v, a against the next derivative
                for i in range(k, k + 3):
                    assert abs(now[i] - last[i] - dt * last[i + 3]) < bound, (k, i, rig.now_us)
            for i in range(9, 12):  # jerk has no step larger than the snap of a piece takes in a tick
                assert abs(now[i] - last[i]) < 8.0, (i, rig.now_us)
            assert abs(now[12] - last[12] - dt * last[13]) < 1e-3
            assert abs(now[13] - last[13]) < 0.02
        self._last = now
        self.worst = max(self.worst, math.dist(now[0:3], rig.body.p))
        self.fastest = max(self.fastest, math.hypot(*now[3:6]))
        self.hardest = max(self.hardest, math.hypot(*now[6:9]))

    def stream(self, seconds, target_at, hz=20):
        """target_at(seconds since now) becomes the setpoint, `hz` times a second."""
        rig, start = self.rig, self.rig.now_us
        while rig.now_us - start < round(1e6 * seconds):
            if (rig.now_us - start) % (1_000_000 // hz) == 0:
                rig.flight.setpoint(target_at(1e-6 * (rig.now_us - start)), rig.now_us)
            self.tick()


def hovering(rig, height=None):
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, height) is None
    rig.run(20.0, until=State.HOLD)


def offboard(rig, target):
    rig.flight.setpoint(target, rig.now_us)
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) is None
    assert rig.flight.state is State.OFFBOARD
    return Checks(rig)


# Takeoff and hover.


@pytest.mark.parametrize(("asked", "height"), [(None, DEFAULTS["TAKEOFF_HEIGHT"]), (1.7, 1.7), (99.0, 6.0)])
def test_takeoff_climbs_to_its_height_and_hovers_until_told_otherwise(make_rig, make_body, asked, height):
    rig = make_rig(reference=False, body=make_body(p=(0.5, -0.3, 0.0), yaw=0.7))
    hovering(rig, asked)
    rig.run(30.0)
    assert rig.flight.state is State.HOLD
    assert rig.body.p == pytest.approx([0.5, -0.3, -height], abs=0.02)
    assert ("takeoff bounded by the fence: 6.00 m" in rig.texts) == (asked == 99.0)
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    rig.run(20.0, until=State.STANDBY)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert rig.flight.failsafe is Failsafe.NONE


def test_start_from_the_hover_goes_to_the_first_node_and_tracks(make_rig, make_body):
    rig = make_rig(body=make_body(p=(-0.8, 0.4, 0.0)))
    hovering(rig, 1.5)
    assert rig.flight.handle_event(Event.START, rig.now_us) is None
    checks = Checks(rig)
    while rig.flight.state is not State.TRACKING:
        checks.tick()
        assert rig.body.p[2] < -0.95
        assert rig.now_us < 20_000_000
    assert rig.body.p == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
    assert checks.fastest < 1.01 * DEFAULTS["TAKEOFF_SPEED"]
    rig.run(10.0, until=State.STANDBY)  # the hold after a reference ends by itself
    assert rig.seen[-5:] == [State.TAKEOFF, State.TRACKING, State.HOLD, State.LANDING, State.STANDBY]


def test_start_during_a_takeoff_to_a_hover_is_refused_and_a_second_takeoff_too(make_rig):
    rig = make_rig()
    rig.standby()
    rig.flight.handle_event(Event.ARM, rig.now_us)
    rig.flight.handle_event(Event.TAKEOFF, rig.now_us)
    rig.run(0.5)
    assert rig.flight.handle_event(Event.START, rig.now_us) == "still taking off"
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us) is None  # said twice, done once
    rig.run(10.0, until=State.HOLD)
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us) == "in the air already"


def test_hold_in_full_flight_stops_and_stays_and_the_reference_is_not_flown_again(make_rig):
    rig = make_rig()
    rig.track()
    rig.run(0.9)
    checks = Checks(rig)
    checks.tick()
    assert rig.flight.handle_event(Event.HOLD, rig.now_us) is None
    for _ in range(3_000):
        checks.tick()
    place = tuple(rig.body.p)
    rig.run(20.0)
    assert rig.flight.state is State.HOLD
    assert math.dist(rig.body.p, place) < 0.01
    assert checks.worst < 0.06
    assert rig.flight.handle_event(Event.START, rig.now_us) == "flown already: land, then arm again"


def test_hold_after_a_reference_lands_unless_told_to_hold(make_rig):
    rig = make_rig()
    rig.track()
    rig.run(10.0, until=State.HOLD)
    rig.run(0.5)
    assert rig.flight.handle_event(Event.HOLD, rig.now_us) is None
    rig.run(10.0)
    assert rig.flight.state is State.HOLD


@pytest.mark.parametrize("state", [State.TAKEOFF, State.HOLD, State.OFFBOARD])
def test_land_works_from_everything_in_the_air(make_rig, state):
    rig = make_rig(reference=False)
    if state is State.TAKEOFF:
        rig.standby()
        rig.flight.handle_event(Event.ARM, rig.now_us)
        rig.flight.handle_event(Event.TAKEOFF, rig.now_us)
        rig.run(1.2)
    else:
        hovering(rig)
    if state is State.OFFBOARD:
        offboard(rig, velocity(1.0, 0.0, 0.0)).stream(1.0, lambda t: velocity(1.0, 0.0, 0.0))
    assert rig.flight.state is state
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    rig.run(10.0, until=State.STANDBY)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0


# Setpoints.


def test_offboard_needs_setpoints_and_arming(make_rig):
    rig = make_rig(reference=False)
    rig.standby()
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) == "not armed"
    rig.flight.handle_event(Event.ARM, rig.now_us)
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) == "no setpoints: stream them first"
    rig.flight.handle_event(Event.TAKEOFF, rig.now_us)
    rig.run(10.0, until=State.HOLD)
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) == "no setpoints: stream them first"
    rig.flight.setpoint(position(0.0, 0.0, -1.0), rig.now_us)
    rig.run(0.501)
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) == "no setpoints: stream them first"
    rig.flight.setpoint(position(0.0, 0.0, -1.0), rig.now_us)
    rig.run(0.5)
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) is None


def test_position_steps_are_flown_smoothly_within_acceleration_and_end_where_asked(make_rig):
    rig = make_rig(reference=False)
    hovering(rig)
    corners = [(2.0, 0.0, -1.5), (2.0, 2.0, -1.5), (0.0, 2.0, -1.0), (0.0, 0.0, -1.0)]
    checks = offboard(rig, position(*corners[0], yaw=0.0))
    for k, corner in enumerate(corners):
        checks.stream(4.0, lambda t, c=corner, k=k: position(*c, yaw=0.5 * k))
        assert math.dist(rig.body.p, corner) < 0.02
        assert rig.flight.outputs["reference"][12] == pytest.approx(0.5 * k, abs=1e-9)
    assert checks.worst < 0.05
    assert checks.hardest < 1.01 * DEFAULTS["OFFB_ACCEL"]
    assert rig.flight.state is State.OFFBOARD


def circle(t, radius=1.0, pace=1.0):
    c, s = math.cos(pace * t), math.sin(pace * t)
    return (radius * c - radius, radius * s, -1.0), (-radius * pace * s, radius * pace * c, 0.0)


def late(rig, seconds, moment):
    """Distance from where the circle was `seconds` ago."""
    return math.dist(circle(moment - seconds)[0], rig.body.p)


def test_position_stream_of_a_circle_is_followed_smoothly_a_little_late(make_rig):
    rig = make_rig(reference=False)
    hovering(rig)
    checks = offboard(rig, position(*circle(0.0)[0]))
    checks.stream(8.0, lambda t: position(*circle(t)[0]))
    assert checks.worst < 0.06
    assert late(rig, 0.31, 8.0) < 0.05
    assert checks.hardest < 1.01 * DEFAULTS["OFFB_ACCEL"]


def test_position_stream_with_velocity_and_acceleration_is_followed_on_time(make_rig):
    rig = make_rig(reference=False)
    hovering(rig)

    def target(t):
        p, v = circle(t)
        return position(*p, v=v, a=(1.0 - p[0] - 2.0, -p[1], 0.0))

    checks = offboard(rig, target(0.0))
    checks.stream(8.0, target)
    assert checks.worst < 0.1  # when it begins; from rest to the circle's speed
    assert late(rig, 0.0, 8.0) < 0.03


def test_velocity_stream_is_reached_and_turns_with_its_yaw_rate(make_rig):
    rig = make_rig(reference=False)
    hovering(rig)
    checks = offboard(rig, velocity(0.0, 0.0, 0.0))
    checks.stream(3.0, lambda t: velocity(1.0, -0.5, -0.2, yaw_rate=0.4))
    assert rig.body.v == pytest.approx([1.0, -0.5, -0.2], abs=0.03)
    assert rig.body.w[2] == pytest.approx(0.4, abs=0.02)
    checks.stream(2.0, lambda t: velocity(0.0, 0.0, 0.0))
    assert math.hypot(*rig.body.v) < 0.05
    assert checks.worst < 0.05
    assert checks.hardest < 1.01 * DEFAULTS["OFFB_ACCEL"]


def test_velocity_ahead_follows_the_heading(make_rig, make_body):
    rig = make_rig(reference=False, body=make_body(yaw=math.pi / 2))
    hovering(rig)
    offboard(rig, velocity(1.0, 0.0, 0.0, ahead=True)).stream(
        2.0, lambda t: velocity(1.0, 0.0, 0.0, ahead=True)
    )
    assert rig.body.v == pytest.approx([0.0, 1.0, 0.0], abs=0.03)


def test_height_by_position_with_velocity_to_the_side(make_rig):
    rig = make_rig(reference=False)
    hovering(rig)
    target = PositionTarget(p=(None, None, -1.8), v=(0.8, 0.0, None))
    checks = offboard(rig, target)
    checks.stream(3.0, lambda t: target)
    assert rig.body.v == pytest.approx([0.8, 0.0, 0.0], abs=0.03)
    assert rig.body.p[2] == pytest.approx(-1.8, abs=0.02)


def test_setpoints_stop_at_the_fence_and_above_the_floor(make_rig):
    rig = make_rig(reference=False, parameters={"FENCE_N_MAX": 2.0, "FENCE_E_MIN": -2.0})
    hovering(rig)
    checks = offboard(rig, position(5.0, 0.0, 1.0))
    checks.stream(4.0, lambda t: position(5.0, 0.0, 1.0))
    assert rig.body.p == pytest.approx([2.0, 0.0, -0.2], abs=0.02)
    assert rig.texts.count("setpoint bounded by fence, floor or speed") == 1
    checks.stream(8.0, lambda t: velocity(0.0, -3.0, -0.2))
    assert -2.02 < rig.body.p[1] < -1.7
    assert rig.flight.state is State.OFFBOARD


def test_setpoints_lost_in_full_flight_hold_and_then_land(make_rig):
    rig = make_rig(reference=False, parameters={"FS_OFFB_HOLD_S": 3.0})
    hovering(rig)
    checks = offboard(rig, velocity(1.5, 0.0, 0.0))
    checks.stream(2.0, lambda t: velocity(1.5, 0.0, 0.0))
    last = rig.now_us - 50_000
    while rig.flight.state is State.OFFBOARD:
        checks.tick()
    assert rig.flight.state is State.HOLD
    assert 500_000 < rig.now_us - last <= 512_000
    assert "setpoints lost: holding, then landing" in rig.texts
    for _ in range(1_500):
        checks.tick()
    assert math.hypot(*rig.body.v) < 0.05
    rig.run(5.0, until=State.LANDING)
    rig.run(9.0, until=State.STANDBY)
    assert rig.flight.failsafe is Failsafe.NONE


def test_setpoints_that_come_back_need_the_command_again(make_rig):
    rig = make_rig(reference=False)
    hovering(rig)
    checks = offboard(rig, velocity(0.5, 0.0, 0.0))
    rig.run(1.0, until=State.HOLD)
    checks = Checks(rig)
    checks.stream(0.5, lambda t: velocity(0.5, 0.0, 0.0))
    assert rig.flight.state is State.HOLD
    assert rig.flight.handle_event(Event.OFFBOARD, rig.now_us) is None
    checks.stream(12.0, lambda t: velocity(0.0, 0.0, 0.0))
    assert rig.flight.state is State.OFFBOARD


# From the floor.


def armed(rig):
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    return rig


def test_offboard_from_the_floor_rises_first_and_then_goes_where_asked(make_rig, make_body):
    rig = armed(make_rig(reference=False, body=make_body(p=(0.5, -0.3, 0.0), yaw=0.7)))
    ticks = rig.flight.flight_ticks
    checks = offboard(rig, position(2.0, 1.0, -1.2))
    assert rig.flight.rotors_on
    assert rig.flight.home_ned == pytest.approx((0.5, -0.3, 0.0), abs=0.01)
    target = position(2.0, 1.0, -1.2, yaw=0.7)
    while rig.body.p[2] > -0.1:
        checks.stream(0.05, lambda t: target)
        assert math.dist(rig.body.p[:2], (0.5, -0.3)) < 0.01
        assert rig.now_us < 5_000_000
    checks.stream(6.0, lambda t: target)
    assert rig.body.p == pytest.approx([2.0, 1.0, -1.2], abs=0.02)
    assert checks.worst < 0.06
    assert checks.hardest < 1.01 * DEFAULTS["OFFB_ACCEL"]
    assert rig.flight.flight_ticks > ticks + 6_000
    assert rig.seen[-2:] == [State.STANDBY, State.OFFBOARD]
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    rig.run(10.0, until=State.STANDBY)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert rig.flight.failsafe is Failsafe.NONE


def test_position_on_the_floor_is_flown_at_the_lowest_height(make_rig):
    """What examples begin with: zeros."""
    rig = armed(make_rig(reference=False))
    offboard(rig, position(0.0, 0.0, 0.0)).stream(4.0, lambda t: position(0.0, 0.0, 0.0))
    assert rig.body.p == pytest.approx([0.0, 0.0, -0.2], abs=0.02)


def test_velocity_on_the_floor_leads_nowhere_until_it_is_upwards(make_rig):
    rig = armed(make_rig(reference=False))
    checks = offboard(rig, velocity(0.5, 0.0, 0.0))
    checks.stream(2.0, lambda t: velocity(0.5, 0.0, 0.2))
    assert math.dist(rig.body.p, (0.0, 0.0, 0.0)) < 0.02
    assert rig.flight.state is State.OFFBOARD
    checks.stream(3.0, lambda t: velocity(0.5, 0.0, -0.4))
    assert rig.body.v == pytest.approx([0.5, 0.0, -0.4], abs=0.03)
    assert rig.body.p[2] < -0.8


def test_offboard_left_on_the_floor_lands_at_once_and_setpoints_lost_there_land_too(make_rig):
    rig = armed(make_rig(reference=False, parameters={"FS_OFFB_HOLD_S": 1.0}))
    offboard(rig, velocity(0.0, 0.0, 0.0)).stream(1.0, lambda t: velocity(0.0, 0.0, 0.0))
    rig.run(1.0, until=State.HOLD)
    rig.run(3.0, until=State.STANDBY)
    armed(rig)
    offboard(rig, velocity(0.0, 0.0, 0.0))
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    rig.run(0.05, until=State.STANDBY)
    assert rig.flight.failsafe is Failsafe.NONE


def test_start_from_a_hold_on_the_floor_climbs_before_it_goes_to_the_side(make_rig, make_body):
    rig = armed(make_rig(body=make_body(p=(-1.0, 0.5, 0.0))))
    offboard(rig, velocity(0.0, 0.0, 0.0)).stream(0.5, lambda t: velocity(0.0, 0.0, 0.0))
    rig.flight.handle_event(Event.HOLD, rig.now_us)
    assert rig.flight.handle_event(Event.START, rig.now_us) is None
    while rig.body.p[2] > -0.9:
        rig.run(0.05)
        assert math.dist(rig.body.p[:2], (-1.0, 0.5)) < 0.02
        assert rig.now_us < 10_000_000
    rig.run(10.0, until=State.TRACKING)


@pytest.mark.parametrize("height", [0.02, 0.5])
def test_offboard_takes_over_a_takeoff(make_rig, height):
    rig = armed(make_rig(reference=False))
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us) is None
    while rig.body.p[2] > -height:
        rig.tick()
    checks = offboard(rig, position(0.5, 0.0, -1.0))
    checks.stream(5.0, lambda t: position(0.5, 0.0, -1.0))
    assert rig.body.p == pytest.approx([0.5, 0.0, -1.0], abs=0.02)
    assert checks.worst < 0.1


def test_rates_and_thrust_lift_off_and_hold_takes_over(make_rig):
    rig = armed(make_rig(reference=False))
    low = AttitudeTarget(thrust=0.5 * HOVER, rate=(0.0, 0.0, 0.0))
    checks = offboard(rig, low)
    checks.stream(1.0, lambda t: low)
    assert rig.body.p == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert rig.flight.rotors_on
    checks.stream(1.0, lambda t: AttitudeTarget(thrust=1.1 * HOVER, rate=(0.0, 0.0, 0.0)))
    assert rig.body.p[2] < -0.3
    assert rig.flight.handle_event(Event.HOLD, rig.now_us) is None
    rig.run(3.0)
    assert math.hypot(*rig.body.v) < 0.05
    assert rig.flight.failsafe is Failsafe.NONE


@pytest.mark.parametrize("kind", ["attitude", "rates"])
def test_attitudes_and_rates_near_the_floor_are_flown_level(make_rig, kind):
    """A tilt close above the floor had it slide along there at 4 m/s."""
    rig = armed(make_rig(reference=False))
    half = math.radians(30.0) / 2.0
    target = AttitudeTarget(thrust=1.2 * HOVER, rate=(0.3, 0.0, 0.0))
    if kind == "attitude":
        q = (math.cos(half), math.sin(half), 0.0, 0.0)
        target = AttitudeTarget(thrust=1.3 * HOVER, rate=(0.0, 0.0, 0.0), q=q)
    checks = offboard(rig, target)
    while rig.body.p[2] > -CLEAR_HEIGHT:
        checks.stream(0.02, lambda t: target, hz=50)
        assert math.degrees(math.acos(min(1.0, rig.body.R[2][2]))) < 3.0
        assert rig.now_us < 5_000_000
    checks.stream(0.4, lambda t: target, hz=50)
    assert math.degrees(math.acos(rig.body.R[2][2])) > 5.0


def test_landing_commanded_as_it_leaves_the_floor_does_not_hop(make_rig):
    """The rotors had stopped 3 cm up in a climb at 1 m/s: it fell from 12 cm."""
    rig = armed(make_rig(reference=False))
    target = AttitudeTarget(thrust=1.0, rate=(0.0, 0.0, 0.0))
    offboard(rig, target)
    while rig.body.v[2] > -0.8:
        rig.flight.setpoint(target, rig.now_us)
        rig.run(0.01)
    assert rig.body.p[2] > -FLOOR_HEIGHT
    assert rig.flight.handle_event(Event.LAND, rig.now_us) is None
    speed = 0.0
    while rig.flight.state is State.LANDING:
        speed = rig.body.v[2]
        rig.run(0.01)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert -0.1 < speed < 0.8  # 1.3 before


def test_position_after_rates_that_did_not_lift_it_rises_without_a_dip(make_rig):
    rig = armed(make_rig(reference=False))
    low = AttitudeTarget(thrust=0.5 * HOVER, rate=(0.0, 0.0, 0.0))
    offboard(rig, low).stream(1.0, lambda t: low)
    checks = Checks(rig)
    rig.flight.setpoint(position(0.0, 0.0, -1.0), rig.now_us)
    for _ in range(400):
        checks.tick()
        assert rig.flight.outputs["reference"][2] < 1e-3
    checks.stream(4.0, lambda t: position(0.0, 0.0, -1.0))
    assert rig.body.p == pytest.approx([0.0, 0.0, -1.0], abs=0.02)


def test_observer_begins_well_above_the_floor_in_offboard_too(make_rig, make_body):
    rig = armed(make_rig(reference=False, parameters={"OBS_GAIN": 5.0}, body=make_body(gain=0.9)))
    checks = offboard(rig, position(0.0, 0.0, -1.2))
    while rig.body.p[2] > -0.4:
        checks.stream(0.05, lambda t: position(0.0, 0.0, -1.2))
        assert list(rig.flight._memory[law.OBSERVER]) == [0.0] * 3
        assert rig.now_us < 8_000_000
    checks.stream(4.0, lambda t: position(0.0, 0.0, -1.2))
    assert rig.flight._memory[law.OBSERVER][2] == pytest.approx(9.81 / 0.9 - 9.81, abs=0.1)


@pytest.mark.parametrize(
    ("spoil", "failsafe"),
    [("mocap", Failsafe.MOCAP_LOST), ("host", Failsafe.LINK_LOST), ("battery", Failsafe.BATTERY_LOW)],
)
def test_failsafes_hold_in_a_flight_that_began_by_setpoints(make_rig, spoil, failsafe):
    rig = armed(make_rig(reference=False))
    checks = offboard(rig, position(0.0, 0.0, -1.0))
    checks.stream(4.0, lambda t: position(0.0, 0.0, -1.0))
    if spoil == "battery":
        rig.battery_v = 12.0
    else:
        setattr(rig, spoil, False)
    while rig.flight.state is State.OFFBOARD:
        rig.flight.setpoint(position(0.0, 0.0, -1.0), rig.now_us)
        rig.run(0.05)
        assert rig.now_us < 20_000_000
    assert (rig.flight.state, rig.flight.failsafe) == (State.FAILSAFE, failsafe)
    rig.run(12.0, until=State.STANDBY)
    assert "no touchdown detected: motors off" not in rig.texts


# Attitude and rate.


def test_rates_and_thrust_are_flown_as_commanded_and_hold_takes_over_without_a_jolt(make_rig):
    rig = make_rig(reference=False)
    hovering(rig, 2.0)
    checks = offboard(rig, AttitudeTarget(thrust=HOVER, rate=(0.0, 0.0, 0.0)))
    still = AttitudeTarget(thrust=HOVER, rate=(0.0, 0.0, 0.0))
    checks.stream(1.0, lambda t: still)
    assert math.dist(rig.body.p, (0.0, 0.0, -2.0)) < 0.1  # nothing pulls it back, little drives it off
    checks.stream(0.4, lambda t: AttitudeTarget(thrust=HOVER, rate=(0.5, 0.0, 0.6)))
    assert rig.body.w == pytest.approx([0.5, 0.0, 0.6], abs=0.03)
    roll = math.atan2(rig.body.R[2][1], rig.body.R[2][2])
    assert 0.12 < roll < 0.2
    assert list(rig.flight.outputs["rate_cmd"]) == [0.5, 0.0, 0.6]
    assert rig.flight.outputs["collective_n"][0] == pytest.approx(DEFAULTS["MASS"] * 9.81)
    start = tuple(rig.flight.outputs["motor_command"])
    assert rig.flight.handle_event(Event.HOLD, rig.now_us) is None
    rig.tick()
    assert max(abs(a - b) for a, b in zip(start, rig.flight.outputs["motor_command"], strict=True)) < 0.15
    rig.run(3.0)
    assert math.hypot(*rig.body.v) < 0.05
    assert rig.flight.failsafe is Failsafe.NONE


def test_attitude_and_thrust_are_flown_as_commanded(make_rig):
    rig = make_rig(reference=False)
    hovering(rig, 2.0)
    angle = 0.15
    target = AttitudeTarget(
        thrust=HOVER, rate=(0.0, 0.0, 0.0), q=(math.cos(angle / 2), 0.0, -math.sin(angle / 2), 0.0)
    )
    offboard(rig, target).stream(1.0, lambda t: target)
    pitch = -math.asin(rig.body.R[2][0])
    assert pitch == pytest.approx(-angle, abs=0.01)
    assert rig.body.v[0] > 1.0


def test_rates_lost_hold_where_it_is(make_rig):
    rig = make_rig(reference=False)
    hovering(rig, 3.0)
    offboard(rig, AttitudeTarget(thrust=HOVER, rate=(0.0, 0.3, 0.0)))
    rig.run(1.0, until=State.HOLD)
    rig.run(3.0)
    assert math.hypot(*rig.body.v) < 0.05
    assert rig.body.p[2] < -2.0


def tipped_over(rig, height):
    """Hover at a height, then roll by body rates for a second."""
    hovering(rig, height)
    target = AttitudeTarget(thrust=HOVER, rate=(6.0, 0.0, 0.0))
    offboard(rig, target)
    for _ in range(50):
        rig.run(0.02)
        rig.flight.setpoint(target, rig.now_us)


@pytest.mark.parametrize("height", [3.0, 4.5, 5.5])
def test_rates_that_tip_it_over_end_in_a_landing(make_rig, height):
    rig = make_rig(reference=False)
    tipped_over(rig, height)
    assert (rig.flight.state, rig.flight.failsafe) == (State.FAILSAFE, Failsafe.GEOFENCE)
    speeds = []
    while rig.flight.state is State.FAILSAFE:
        speeds.append(math.hypot(*rig.body.v))
        rig.run(0.01)
    assert -FLOOR_HEIGHT < rig.body.p[2] <= 0.0
    assert speeds[-1] < 0.7


def test_rates_that_tip_it_over_far_from_fence_and_floor_stop_the_motors(make_rig):
    walls = {f"FENCE_{axis}_{end}": sign * 50.0 for axis in "NE" for end, sign in (("MIN", -1), ("MAX", 1))}
    rig = make_rig(reference=False, parameters={**walls, "FENCE_D_MIN": -60.0, "TAKEOFF_SPEED": 5.0})
    tipped_over(rig, 25.0)
    assert (rig.flight.state, rig.flight.action) == (State.FAILSAFE, Action.MOTORS_OFF)
    assert max(rig.command) == 0.0


@pytest.mark.parametrize(
    ("v_down", "thrust"), [(0.01, 2.5), (-0.01, 2.5), (3.0, 2.5), (-3.0, 2.5), (-3.0, 0.3)]
)
def test_stop_after_attitudes_begins_with_the_acceleration_of_one_that_brakes(make_rig, v_down, thrust):
    """Any other thrust changes at once."""
    rig = make_rig(reference=False)
    hovering(rig, 3.0)
    offboard(rig, AttitudeTarget(thrust=HOVER, rate=(0.0, 0.0, 0.0)))
    memory, phases = rig.flight._memory, rig.flight._phases
    memory[law.EST_V.start + 2] = v_down
    memory[law.OBSERVER_THRUST.start] = thrust * DEFAULTS["MASS"] * 9.81
    node, _ = phases.reference_state(rig.now_us)
    down = 9.81 * (1.0 - thrust)
    brakes = down * (v_down + down * DEFAULTS["MOTOR_LAG"]) < 0.0
    assert (node[5], node[8]) == (v_down, pytest.approx(down if brakes else 0.0, abs=0.5))
