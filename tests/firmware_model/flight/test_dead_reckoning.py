"""Dead reckoning learns the accelerometer's bias from the poses and allows for it without them."""

from __future__ import annotations

import math
from array import array

import pytest

from trimtab.firmware_model.flight.dead_reckoning import (
    BIAS_RATE,
    CORRECTION_MAX,
    DeadReckoning,
    near_floor_m,
)
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.law import step as law


def hover(rig, bias, seconds):
    """Hover at 2 m, for a time with this error of the accelerometer (m/s^2, down)."""
    move = rig.body.step

    def step(command):
        move(command)
        x, y, z = rig.body.force
        rig.body.force = (x, y, z + bias)

    rig.standby()
    rig.body.step = step
    assert rig.flight.handle_event(Event.ARM, rig.now_us) is None
    assert rig.flight.handle_event(Event.TAKEOFF, rig.now_us, 2.0) is None
    rig.run(20.0, until=State.HOLD)
    rig.run(seconds)
    return rig.flight._dead_reckoning


@pytest.mark.parametrize("bias", [-0.2, 0.0, 0.1])
def test_correction_in_a_hover_is_minus_the_bias(make_rig, bias):
    correction = hover(make_rig(reference=False), bias, 8.0).correction
    assert correction[2] == pytest.approx(-bias, abs=0.01)
    assert max(map(abs, correction[:2])) < 0.02


def test_correction_of_a_faulty_accelerometer_is_bounded(make_rig):
    assert hover(make_rig(reference=False), 1.5, 5.0).correction[2] >= -CORRECTION_MAX


@pytest.mark.parametrize(("seconds", "counts"), [(0.06, True), (1.6, False)])
def test_correction_leaves_out_the_time_between_two_flights(seconds, counts):
    """A landing, and a take-off that ends in a tilt, had been taken for a bias of 0.5 m/s^2."""
    memory: memoryview[float] = memoryview(array("d", law.initial_memory())).cast("B").cast("d")
    learned = DeadReckoning(memory)
    learned.learn(0)
    memory[law.FORCE_SUM.start + 2] -= 9.81 * law.FORCE_COUNTS * seconds / 1e-3
    memory[law.EST_Q.start] = math.cos(0.15)
    memory[law.EST_Q.start + 1] = math.sin(0.15)
    learned.learn(round(1e6 * seconds))
    assert any(learned.correction) is counts


def test_gyro_bias_without_poses_is_one_that_changed_slowly(make_rig):
    rig = make_rig(reference=False)
    learned = hover(rig, 0.0, 2.0)
    before = list(learned.bias)
    assert before == pytest.approx(list(rig.gyro_bias), abs=0.002)
    for k, wrong in enumerate((0.03, -0.03, 0.0)):  # as after quick turns with late poses
        rig.flight._memory[law.EST_BIAS.start + k] += wrong
    rig.run(1.0)
    assert learned.bias == pytest.approx(before, abs=1.1 * BIAS_RATE)
    rig.mocap = False
    rig.run(2.0, until=State.FAILSAFE)
    assert list(rig.flight._memory[law.EST_BIAS]) == pytest.approx(before, abs=2.0 * BIAS_RATE)


def test_gyro_bias_disturbed_before_arming_is_not_taken_over(make_rig):
    rig = make_rig(reference=False)
    rig.standby()
    learned = rig.flight._dead_reckoning
    before = list(learned.bias)
    rig.flight._memory[law.EST_BIAS.start] += 0.03
    rig.run(0.5)
    assert learned.bias == pytest.approx(before, abs=BIAS_RATE)


def test_correction_without_poses_stays(make_rig):
    rig = make_rig(reference=False)
    learned = hover(rig, 0.1, 5.0)
    rig.mocap = False
    rig.run(0.25)
    before = list(learned.correction)
    rig.run(1.0)
    assert learned.correction == before


def test_level_descent_with_a_biased_accelerometer_is_as_fast_as_asked(make_rig):
    rig = make_rig(reference=False)
    hover(rig, 0.2, 5.0)
    rig.mocap = False
    while rig.body.p[2] < -0.02:
        rig.run(0.01)
    assert rig.body.v[2] == pytest.approx(0.7, abs=0.1)


def test_floor_is_expected_higher_the_longer_poses_are_lost():
    assert near_floor_m(0) == pytest.approx(0.1)
    assert near_floor_m(6_000_000) == pytest.approx(1.0)
