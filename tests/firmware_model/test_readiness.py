"""Gyro calibration from running sums, and the reasons not to arm."""

import math

import pytest

from firmware_model.readiness import GyroCalibration, refusal

LEVEL = (0.0, 0.0, -9.81)
READY = {"calibrated": True, "has_pose": True, "cos_tilt": 1.0}


def look_along(calibration, gyro_at, *, force=LEVEL, count=60, start=0):
    """Looks every 10 ms while each of the ten ticks in between saw the same gyro."""
    sums = [0.0, 0.0, 0.0]
    for k in range(start, start + count):
        gyro = gyro_at(k)
        done = calibration.look(10_000 * k, gyro, force, tuple(sums), 0.2)
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
    ("change", "reason"),
    [
        ({}, None),
        ({"calibrated": False}, "gyro not calibrated: keep still"),
        ({"has_pose": False}, "no mocap"),
        ({"cos_tilt": math.cos(math.radians(21.0))}, "tilted"),
        ({"cos_tilt": math.cos(math.radians(19.0))}, None),
    ],
)
def test_refusal_names_what_is_missing(change, reason):
    assert refusal(**{**READY, **change}) == reason
