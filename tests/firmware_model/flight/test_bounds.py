"""Bounds of flight that a user may set: each acts where its parameter says."""

from __future__ import annotations

import math

import pytest

from trimtab.firmware_model.flight.braking import Brakes, Room
from trimtab.firmware_model.flight.condition_monitor import ConditionMonitor
from trimtab.firmware_model.flight.failsafe import Failsafe
from trimtab.firmware_model.flight.offboard import Offboard
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.setpoints import Bounds, PositionTarget, towards
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.protocol.parameters import DEFAULTS

AT_2_M = (0.0, 0.0, -2.0, *(0.0,) * 9)
BRAKES = Brakes(gentle=4.0, sideways=8.0, rising=7.0, sinking=8.0, tilt=1.7)


def leaning(body_type, angle_deg):
    """A body that stands level and whose poses lean by this angle."""
    half = math.radians(angle_deg) / 2

    class Leaning(body_type):
        def quaternion(self):
            return (math.cos(half), math.sin(half), 0.0, 0.0)

    return Leaning()


@pytest.mark.parametrize(("bound_deg", "arms"), [(5.0, False), (7.0, True)])
def test_arming_follows_arm_askew_deg(make_rig, make_body, bound_deg, arms):
    rig = make_rig(reference=False, body=leaning(make_body, 6.0), parameters={"ARM_ASKEW_DEG": bound_deg})
    rig.standby()
    assert (rig.flight.handle_event(Event.ARM, rig.now_us) is None) is arms


@pytest.mark.parametrize(("bound_deg", "arms"), [(5.0, False), (7.0, True)])
def test_arming_follows_arm_tilt_deg(make_rig, make_body, bound_deg, arms):
    rig = make_rig(reference=False, body=leaning(make_body, 6.0), parameters={"ARM_TILT_DEG": bound_deg})
    rig.standby()
    assert (rig.flight.handle_event(Event.ARM, rig.now_us) is None) is arms


@pytest.mark.parametrize(("bound", "calibrated"), [(0.05, False), (0.5, True)])
def test_calibration_follows_arm_gyro_still(make_rig, bound, calibrated):
    rig = make_rig(reference=False, parameters={"ARM_GYRO_STILL": bound})
    biases = (0.01, -0.02, 0.005), (0.11, -0.02, 0.005)
    for k in range(100):  # 0.1 rad/s between two samples
        rig.gyro_bias = biases[k % 2]
        rig.run(0.01)
    assert (rig.flight.calibration.bias is not None) is calibrated


@pytest.mark.parametrize(
    ("name", "value", "north_m", "turn_deg", "used"),
    [
        ("EST_JUMP_M", 0.5, 0.3, 0.0, True),
        ("EST_JUMP_M", 0.2, 0.3, 0.0, False),
        ("EST_JUMP_SPEED", 100.0, 0.9, 0.0, True),
        ("EST_JUMP_SPEED", 0.0, 0.9, 0.0, False),
        ("EST_JUMP_DEG", 45.0, 0.0, 30.0, True),
        ("EST_JUMP_DEG", 20.0, 0.0, 30.0, False),
    ],
)
def test_pose_in_the_air_is_used_within_its_bounds(make_rig, name, value, north_m, turn_deg, used):
    rig = make_rig(reference=False, parameters={name: value})
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 1.0) is None
    rig.run(8.0, until=State.HOLD)
    rig.mocap = False
    n, e, d = rig.body.p
    half = math.radians(turn_deg) / 2
    pose = (n + north_m, e, d), (math.cos(half), 0.0, 0.0, math.sin(half))
    assert rig.flight.pose(rig.now_us, *pose, rig.now_us) is used


@pytest.mark.parametrize(
    ("name", "landed"), [("LAND_HEIGHT", False), ("LAND_STOP_SPEED", False), (None, True)]
)
def test_touchdown_follows_its_height_and_speed(name, landed):
    monitor = ConditionMonitor(ParameterValues({**DEFAULTS, **({} if name is None else {name: 0.06})}))
    monitor.start(1_000_000)
    signs = {"height": 0.1, "v": (0.1, 0.0, 0.0), "reference_below": True, "carried": True}
    monitor.update_touchdown(1_100_000, **signs)
    assert monitor.update_touchdown(1_350_000, **signs) is landed


@pytest.mark.parametrize(("height", "lowest_m"), [(0.2, -0.2), (1.0, -1.0)])
def test_setpoints_end_at_offb_height(height, lowest_m):
    offboard = Offboard(
        memoryview(bytearray(80)).cast("d"), ParameterValues({**DEFAULTS, "OFFB_HEIGHT": height})
    )
    assert offboard.room(0.0).high[2] == pytest.approx(lowest_m)


def test_turn_to_a_yaw_follows_offb_turn():
    room = Room((-10.0, -10.0, -5.0), (10.0, 10.0, -0.2))
    rates = []
    for turn_rate in (0.5, 1.5):
        bounds = Bounds(room=room, speed=5.0, accel=4.0, brakes=BRAKES, yaw_rate=3.0, turn_rate=turn_rate)
        way, _ = towards(
            PositionTarget(p=(0.0, 0.0, -2.0), v=(None, None, None), yaw=2.0), AT_2_M, (0.0, 0.0), bounds
        )
        rates.append(max(abs(way.state_at(10_000 * k)[13]) for k in range(800)))
    # A cubic from rest to rest peaks at 1.5 times its mean; the time allows for a quintic's 1.875.
    assert rates == pytest.approx([0.5 * 1.5 / 1.875, 1.5 * 1.5 / 1.875])


@pytest.mark.parametrize("blind_s", [1.0, 2.0])
def test_level_descent_follows_velocity_for_fs_blind_s(make_rig, blind_s):
    rig = make_rig(reference=False, parameters={"FS_BLIND_S": blind_s, "FS_SINK_SPEED": 0.1})
    rig.standby()
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 2.0) is None
    rig.run(8.0, until=State.HOLD)
    rig.mocap = False
    rig.run(2.0, until=State.FAILSAFE)
    assert rig.flight.failsafe is Failsafe.MOCAP_LOST
    since_us = rig.now_us
    while not rig.flight._phases.blind:
        rig.run(0.01)
    assert 1e-6 * (rig.now_us - since_us) == pytest.approx(blind_s, abs=0.02)


@pytest.mark.parametrize("end_s", [2.0, 6.0])
def test_level_descent_ends_fs_blind_end_s_later(make_rig, end_s):
    rig = make_rig(reference=False, parameters={"FS_BLIND_S": 0.5, "FS_BLIND_END_S": end_s})
    rig.standby()
    rig.flight._phases.descend_level(((0.0,) * 12, (0.0, 0.0)), 1.0, rig.now_us)
    track = rig.flight._phases.player._track
    assert track.end_us == pytest.approx(1e6 * (max(0.5, 1.1) + end_s), abs=700_000)
