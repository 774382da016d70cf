"""The controller: on the reference it only feeds forward; off it, it pulls back in the stated proportions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.dfbc import (
    FEEDBACK_MAX,
    LIFT_FULL,
    RATE_MAX,
    TILT_MAX_DEG,
    FlatState,
    control,
)
from trimtab.firmware_model.law.flatness import flat_attitude, flat_rates
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import euler_to_matrix, mat_vec
from trimtab.protocol.parameters import DEFAULTS

PARAMETERS = law.parameter_vector(DEFAULTS)
GAINS, BODY = law.gains(PARAMETERS), law.body(PARAMETERS)
ZERO = (0.0, 0.0, 0.0)
LEVEL = euler_to_matrix(FLOAT, ZERO)
number = st.floats(-4.0, 4.0)
vector = st.tuples(number, number, number)


def _hover(**changes):
    given_ = {
        "p": ZERO, "v": ZERO, "R": LEVEL, "rate": ZERO, "rate_filtered": ZERO, "integral": ZERO,
        "ref": FlatState(ZERO, ZERO, ZERO, ZERO, 0.0, 0.0),
    }  # fmt: skip
    given_.update(changes)
    return control(FLOAT, GAINS, BODY, **given_)


def test_control_at_hover_carries_the_weight():
    collective, torque, rate_cmd, integral_dot = _hover()
    assert collective == pytest.approx(BODY.mass_kg * GRAVITY)
    assert (*torque, *rate_cmd, *integral_dot) == pytest.approx((0.0,) * 9)


@given(vector, vector, vector, number)
def test_control_on_the_reference_only_feeds_forward(v, a, j, yaw):
    R, thrust = flat_attitude(FLOAT, a, yaw)
    rate = flat_rates(FLOAT, a, j, yaw, 0.5)
    ref = FlatState((1.0, 2.0, 3.0), v, a, j, yaw, 0.5)
    collective, torque, rate_cmd, _ = _hover(p=ref.p, v=v, R=R, rate=rate, rate_filtered=rate, ref=ref)
    assert collective == pytest.approx(BODY.mass_kg * thrust)
    assert rate_cmd == pytest.approx(rate, abs=1e-9)
    spin = np.cross(rate, np.multiply(BODY.inertia, rate))
    assert torque == pytest.approx(spin, abs=1e-9)


@given(vector)
def test_control_at_the_commanded_rate_leaves_the_gyroscopic_torque_which_does_no_work(rate):
    """With every other term gone the torque is omega x J omega; omega . that is zero."""
    gains = GAINS._replace(rate=ZERO, rate_derivative=ZERO)
    ref = FlatState(ZERO, ZERO, ZERO, ZERO, 0.0, 0.0)
    _, torque, _, _ = control(FLOAT, gains, BODY, ZERO, ZERO, LEVEL, rate, ZERO, ZERO, ref)
    assert torque == pytest.approx(np.cross(rate, np.multiply(BODY.inertia, rate)), abs=1e-15)
    assert np.dot(rate, torque) == pytest.approx(0.0, abs=1e-15)


def test_control_off_position_asks_for_the_gain_times_the_error():
    """0.1 m too far north: thrust tilts by K_p 0.1 / g to the south, a positive pitch rate."""
    _, torque, rate_cmd, _ = _hover(p=(0.1, 0.0, 0.0))
    tilt = np.arctan2(GAINS.position[0] * 0.1, GRAVITY)
    assert rate_cmd == pytest.approx((0.0, GAINS.attitude[1] * np.sin(tilt), 0.0), abs=1e-12)
    assert torque[1] == pytest.approx(BODY.inertia[1] * GAINS.rate[1] * rate_cmd[1])


def test_control_below_the_reference_thrusts_more():
    collective, *_ = _hover(p=(0.0, 0.0, 0.1), v=(0.0, 0.0, 0.2))
    extra = GAINS.position[2] * 0.1 + GAINS.velocity[2] * 0.2
    assert collective == pytest.approx(BODY.mass_kg * (GRAVITY + extra))


def test_control_with_weights_zero_ignores_position_and_velocity():
    one, other = (_hover(p=p, v=p, weights=(0.0, 0.0)) for p in (ZERO, (3.0, -2.0, 1.0)))
    assert one == other


def test_control_far_off_bounds_the_feedback_in_its_direction():
    collective, *_ = _hover(p=(0.0, 0.0, 1e4))
    assert collective == pytest.approx(BODY.mass_kg * (GRAVITY + FEEDBACK_MAX))
    _, _, near, _ = _hover(p=(300.0, 400.0, 0.0), weights=(1.0, 0.0))
    _, _, far, _ = _hover(p=(600.0, 800.0, 0.0), weights=(1.0, 0.0))
    assert near == pytest.approx(far)


def test_control_asked_to_fall_keeps_the_least_thrust():
    ref = FlatState(ZERO, ZERO, (0.0, 0.0, 2 * GRAVITY), ZERO, 0.0, 0.0)
    collective, *_ = _hover(ref=ref)
    assert collective == pytest.approx(BODY.mass_kg * GRAVITY * GAINS.thrust_floor)


def tilt_deg(**changes):
    """The tilt in pitch that the controller asks a level vehicle for."""
    _, _, rate_cmd, _ = _hover(**changes)
    assert abs(rate_cmd[0]) < 1e-9
    return np.degrees(np.arcsin(min(1.0, abs(rate_cmd[1]) / GAINS.attitude[1])))


@pytest.mark.parametrize("climb", [0.0, 2.0, 5.0, 20.0])
@pytest.mark.parametrize("north", [3.0, 5.0, 20.0])
def test_control_pulled_back_in_a_climb_stays_upright(north, climb):
    """Feedback alone would ask for thrust along the floor or downward, which turns the vehicle over."""
    v = (north, 0.0, -climb)
    assert tilt_deg(v=v) < TILT_MAX_DEG + 1e-6
    nearly = euler_to_matrix(FLOAT, (0.0, np.radians(TILT_MAX_DEG), 0.0))
    _, _, rate_cmd, _ = _hover(v=v, R=nearly)
    assert rate_cmd[1] < 1e-9  # it does not go on turning


def test_control_with_little_lift_feeds_back_sideways_in_proportion_to_it():
    """Full feedback swings a vehicle that stops a climb, because torque takes more thrust than commanded."""

    def sideways(lift):
        a = (0.0, 0.0, GRAVITY * (1.0 - lift))
        tilt = tilt_deg(v=(0.2, 0.0, 0.0), ref=FlatState(ZERO, ZERO, a, ZERO, 0.0, 0.0))
        return np.tan(np.radians(tilt)) * lift * GRAVITY

    full = GAINS.velocity[0] * 0.2
    assert sideways(0.8) == pytest.approx(full)
    assert sideways(LIFT_FULL) == pytest.approx(full)
    assert sideways(0.5 * LIFT_FULL) == pytest.approx(0.5 * full)


def test_control_bounds_the_rate_that_feedback_commands_but_not_that_of_the_reference():
    turned = euler_to_matrix(FLOAT, (1.5, 0.0, 0.0))

    def rates(jerk, R=turned, **changes):
        ref = FlatState(ZERO, ZERO, ZERO, (jerk, 0.0, 0.0), 0.0, 0.0)
        return _hover(R=R, ref=ref, **changes)[2]

    level = euler_to_matrix(FLOAT, (0.0, 0.0, 0.0))
    slow, fast = rates(30.0, level), rates(120.0, level)
    assert np.hypot(*slow[:2]) < RATE_MAX < np.hypot(*fast[:2])
    assert np.hypot(*rates(70.0)[:2]) == pytest.approx(RATE_MAX)
    assert np.hypot(*rates(120.0)[:2]) == pytest.approx(np.hypot(*fast[:2]))
    above = rates(60.0, level, p=(0.0, 0.0, -1.0))  # little lift makes the same jerk a fast turn
    assert np.hypot(*above[:2]) == pytest.approx(RATE_MAX)


def test_control_pulled_down_far_off_asks_for_no_tilt():
    assert tilt_deg(p=(0.0, 0.0, -20.0)) < 1e-6


def test_control_on_a_reference_that_tilts_further_follows_it():
    a = (-30.0, 0.0, 8.0)  # 87 deg
    R, _ = flat_attitude(FLOAT, a, 0.0)
    ref = FlatState(ZERO, ZERO, a, ZERO, 0.0, 0.0)
    _, _, rate_cmd, _ = _hover(R=R, ref=ref)
    assert rate_cmd == pytest.approx(ZERO, abs=1e-9)


def test_control_counters_the_residual_fed_forward():
    """A predicted push to the north is met by thrust that accelerates to the south."""
    R, _ = flat_attitude(FLOAT, (-1.0, 0.0, 0.0), 0.0)
    collective, torque, rate_cmd, _ = _hover(R=R, ff_accel=(1.0, 0.0, 0.0))
    assert (*torque, *rate_cmd) == pytest.approx((0.0,) * 6, abs=1e-12)
    thrust = mat_vec(R, (0.0, 0.0, -collective / BODY.mass_kg))
    assert thrust == pytest.approx((-1.0, 0.0, -GRAVITY))


def test_control_with_an_attitude_offset_settles_at_that_attitude():
    offset = (0.02, -0.03)
    R = euler_to_matrix(FLOAT, (*offset, 0.0))
    _, _, rate_cmd, _ = _hover(R=R, attitude_offset=offset)
    assert np.linalg.norm(rate_cmd) < 0.01
    _, _, without, _ = _hover(R=R)
    assert np.linalg.norm(without) > 0.2


def test_control_damps_the_rate_by_the_filters_derivative():
    _, torque, _, _ = _hover(rate_filtered=(-0.5, 0.0, 0.0))
    expected = -BODY.inertia[0] * GAINS.rate_derivative[0] * GAINS.filter_rate * 0.5
    assert torque[0] == pytest.approx(expected)
