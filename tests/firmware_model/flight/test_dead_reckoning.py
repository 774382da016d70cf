"""Dead reckoning learns the accelerometer's bias from the poses and allows for it without them."""

from __future__ import annotations

import pytest

from trimtab.firmware_model.flight.dead_reckoning import CORRECTION_MAX, near_floor_m
from trimtab.firmware_model.flight.supervisor import Event, State


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
