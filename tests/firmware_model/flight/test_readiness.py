"""Gyro calibration from running sums, and the reasons not to arm."""

import math

import pytest

from trimtab.firmware_model.flight.readiness import (
    CHECKS,
    ArmingState,
    GyroCalibration,
    StillnessDetector,
    arming_refusals,
    contradiction,
    start_refusal,
)
from trimtab.firmware_model.flight.supervisor import Event
from trimtab.firmware_model.services.handlers import TEXT_BYTES
from trimtab.host.vehicle import list_vehicles, load_vehicle, to_parameters
from trimtab.protocol.parameters import DEFAULTS

LEVEL = (0.0, 0.0, -9.81)
READY = ArmingState(
    calibrated=True,
    has_pose=True,
    still=True,
    pose_tilt_deg=0.0,
    pose_tilt_max_deg=10.0,
    cos_tilt=1.0,
    cos_tilt_min=math.cos(math.radians(20.0)),
    p=(0.0, 0.0, 0.0),
    fence=((-3.0, 3.0), (-3.0, 3.0), (-2.0, 0.3)),
    active=frozenset(),
    battery=None,
    contradiction=None,
    lacks_key=False,
)


def look_along(calibration, gyro_at, *, force=LEVEL, count=60, start=0):
    """Looks every 10 ms while each of the ten ticks in between saw the same gyro."""
    sums = [0.0, 0.0, 0.0]
    for k in range(start, start + count):
        gyro = gyro_at(k)
        done = calibration.update(10_000 * k, gyro, force, tuple(sums), bias_max=0.2, still_rate=0.15)
        if done:
            return k
        sums = [total + 10 * 4096.0 * rate for total, rate in zip(sums, gyro_at(k + 1), strict=True)]
    return None


def test_calibration_of_a_still_vehicle_takes_half_a_second_and_finds_the_bias():
    calibration = GyroCalibration()
    assert look_along(calibration, lambda k: (0.02, -0.01, 0.005)) == 50
    assert calibration.bias == pytest.approx((0.02, -0.01, 0.005))


def test_calibration_averages_what_lies_between_the_looks():
    calibration = GyroCalibration()
    look_along(calibration, lambda k: (0.02 + (0.01 if k % 2 else -0.01), 0.0, 0.0))
    assert calibration.bias == pytest.approx((0.02, 0.0, 0.0), abs=1e-4)


def test_calibration_starts_anew_after_a_movement():
    calibration = GyroCalibration()
    assert look_along(calibration, lambda k: (0.5 if k == 20 else 0.0, 0.0, 0.0), count=80) in (71, 72)


@pytest.mark.parametrize(("gyro", "force"), [((0.0, 0.0, 0.0), (0.0, 0.0, -7.0)), ((0.3, 0.0, 0.0), LEVEL)])
def test_calibration_never_ends_while_falling_or_turning(gyro, force):
    assert look_along(GyroCalibration(), lambda k: gyro, force=force, count=300) is None


@pytest.mark.parametrize(
    ("speed", "force", "still"),
    [
        (0.0, LEVEL, True),
        (0.49, (4.0, 0.0, -9.0), True),
        (0.51, LEVEL, False),
        (0.0, (0.0, 0.0, 0.0), False),
        (0.0, (0.0, 0.0, -12.0), False),
        (0.0, (0.0, 0.0, math.nan), False),
    ],
)
def test_vehicle_is_still_once_it_has_been_for_a_tenth_of_a_second(speed, force, still):
    detector = StillnessDetector()
    detector.reset(1_000_000)
    told = []
    for k in range(12):
        detector.update(1_000_000 + 10_000 * k, speed, force)
        told.append(detector.still)
    assert told == [False] * 10 + [still] * 2
    detector.update(1_120_000, 0.0, (0.0, 0.0, -7.0))
    assert not detector.still


def test_askew_is_the_smoothed_angle_of_what_is_felt_from_up():
    detector = StillnessDetector()
    assert detector.pose_tilt_deg == 0.0
    for k in range(200):
        detector.update(
            10_000 * k, 0.0, (0.0, 9.81 * math.sin(0.2) + (2.0 if k % 2 else -2.0), -9.81 * math.cos(0.2))
        )
    assert detector.pose_tilt_deg == pytest.approx(math.degrees(0.2), abs=0.5)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, None),
        ({"calibrated": False}, "gyro not calibrated: keep still"),
        ({"has_pose": False}, "no mocap"),
        ({"cos_tilt": math.cos(math.radians(21.0))}, "tilted"),
        ({"cos_tilt": math.nan}, "tilted"),
        ({"cos_tilt": math.cos(math.radians(19.0))}, None),
        ({"still": False}, "moving: let it stand still"),
        ({"still": False, "has_pose": False}, "no mocap"),  # without poses speed is a guess
        ({"pose_tilt_deg": 10.1}, "poses tilted: fix frame or rigid body"),
        ({"pose_tilt_deg": math.nan}, "poses tilted: fix frame or rigid body"),
        ({"pose_tilt_deg": 9.9}, None),
        ({"pose_tilt_deg": 19.0, "has_pose": False}, "no mocap"),
        ({"p": (0.0, 3.1, 0.0)}, "outside the fence"),
        ({"active": frozenset([Event.IMU_STUCK])}, "IMU stuck: it repeats one sample"),
        ({"active": frozenset([Event.MOCAP_LATE])}, "mocap late"),
        ({"active": frozenset([Event.BATTERY_LOW])}, "battery low: charge it"),
        ({"active": frozenset([Event.LOOP_OVERRUN])}, "ticks too late"),
        ({"active": frozenset([Event.LINK_LOST])}, "no host heard"),
        ({"battery": "battery at 13.40 V, below 13.60 V"}, "battery at 13.40 V, below 13.60 V"),
        ({"contradiction": "no good"}, "no good"),
    ],
)
def test_reasons_name_what_is_missing(change, reason):
    assert arming_refusals(READY._replace(**change)) == ([] if reason is None else [reason])


def test_reasons_are_told_all_at_once_and_fit_a_text():
    told = arming_refusals(READY._replace(calibrated=False, has_pose=False, cos_tilt=0.0, p=(9.0, 9.0, 9.0)))
    assert told == ["gyro not calibrated: keep still", "no mocap", "tilted", "outside the fence"]
    assert all(len(f"arm refused: {check.text}") <= TEXT_BYTES for check in CHECKS)
    assert len("arm refused: battery at 13.40 V, below 13.60 V") <= TEXT_BYTES


@pytest.mark.parametrize(
    ("to_hover", "flown", "reference"),
    [
        (True, False, True),
        (False, True, True),
        (False, False, False),
        (False, False, True),
    ],
)
def test_refusals_of_a_start_fit_a_text(make_track, to_hover, flown, reference):
    track = make_track() if reference else None
    text = start_refusal(track, to_hover=to_hover, flown=flown, battery="battery at 13.40 V, below 13.60 V")
    assert len(f"start refused: {text}") <= TEXT_BYTES


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({}, None),
        ({"BAT_EMPTY_V": 16.8}, "BAT_EMPTY_V not below BAT_FULL_V"),
        ({"MASS": 2.3}, "MASS too great for THRUST_MAX"),
        ({"THRUST_MIN": 0.9}, None),
        ({"THRUST_MIN": 0.93}, "THRUST_MIN too great for MASS"),
        ({"THRUST_MIN": 9.0}, "THRUST_MIN too great for MASS"),
        ({"THRUST_FLOOR": 0.7}, None),
        ({"THRUST_FLOOR": 0.71}, "THRUST_FLOOR above 0.7"),
        ({"THRUST_C1": 0.57, "THRUST_C2": 0.43}, None),
        ({"THRUST_C1": 0.0, "THRUST_C2": 0.0}, "THRUST_C1 + THRUST_C2 is not near 1"),
        ({"THRUST_C1": 0.3, "THRUST_C2": 1.0}, "THRUST_C1 + THRUST_C2 is not near 1"),
        ({"EST_POS": 47.0}, None),
        ({"EST_POS": 48.0}, "EST_POS, EST_VEL: estimate diverges"),
        ({"EST_POS": 0.0}, "EST_POS, EST_VEL: estimate diverges"),
        ({"EST_VEL": 0.0}, "EST_POS, EST_VEL: estimate diverges"),
        ({"EST_VEL": 1600.0}, "EST_POS, EST_VEL: estimate diverges"),
        ({"EST_BIAS": 0.0}, None),
        ({"EST_ATT": 0.0}, "EST_ATT, EST_BIAS: estimate diverges"),
        ({"EST_ATT": 50.0}, "EST_ATT, EST_BIAS: estimate diverges"),
    ],
)
def test_contradiction_of_parameters(change, text):
    assert contradiction({**DEFAULTS, **change}) == text
    assert text is None or len(f"arm refused: {text}") <= TEXT_BYTES


@pytest.mark.parametrize("name", list_vehicles())
def test_vehicles_that_ship_do_not_contradict_themselves(name):
    assert contradiction(to_parameters(load_vehicle(name))) is None
