"""The estimator: exact where its assumptions hold, convergent from a wrong start, bounded after gaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.estimator import (
    ACCELERATION_MAX,
    INTERVAL_MAX_S,
    LATE_S,
    Estimate,
    EstimatorGains,
    converges,
    correct,
    predict,
)
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import (
    mat_t_vec,
    quat_exp,
    quat_from_euler,
    quat_multiply,
    quat_to_matrix,
)
from trimtab.firmware_model.law.step import TICK_S

GAINS = EstimatorGains(20.0, 150.0, 6.0, 0.5)
number = st.floats(-3.0, 3.0)
vector = st.tuples(number, number, number)


def _late_pose(p, v, a, q, rate, age):
    """The pose `age` ago under constant acceleration and body rate."""
    p_late = [x - age * y + 0.5 * age * age * z for x, y, z in zip(p, v, a, strict=True)]
    return p_late, quat_multiply(q, quat_exp(FLOAT, [-age * w for w in rate]))


def _flat(est):
    return np.concatenate(est)


@given(vector, vector, vector, vector, vector, st.floats(0.0, 0.1))
def test_correct_by_a_late_pose_of_a_true_estimate_changes_nothing(p, v, a, turn, rate, age):
    est = Estimate(p, v, quat_exp(FLOAT, turn), (0.01, 0.02, 0.03))
    pose = _late_pose(p, v, a, est.q, rate, age)
    after = correct(FLOAT, est, rate, a, *pose, age, 0.01, GAINS)
    assert np.allclose(_flat(after), _flat(est), atol=1e-13)


@given(vector, vector, vector, vector, vector)
def test_correct_with_interval_zero_changes_nothing(p, v, a, turn, rate):
    est = Estimate(p, v, quat_exp(FLOAT, turn), (0.01, 0.02, 0.03))
    after = correct(FLOAT, est, rate, a, (1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5), 0.02, 0.0, GAINS)
    assert np.allclose(_flat(after), _flat(est), atol=1e-15)


def test_correct_by_either_sign_of_the_quaternion_is_the_same():
    est = Estimate((0.0,) * 3, (0.0,) * 3, quat_exp(FLOAT, (0.1, 0.2, 0.3)), (0.0,) * 3)
    q = quat_exp(FLOAT, (0.2, 0.1, 0.5))
    rest = ((0.0,) * 3, (0.0,) * 3, (1.0, 2.0, 3.0))
    one = correct(FLOAT, est, *rest, q, 0.0, 0.01, GAINS)
    other = correct(FLOAT, est, *rest, [-x for x in q], 0.0, 0.01, GAINS)
    assert np.allclose(_flat(one), _flat(other), atol=1e-15)


def test_correct_moves_by_gain_times_interval_towards_the_pose():
    est = Estimate((0.0,) * 3, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3)
    q = quat_from_euler(FLOAT, 0.0, 0.0, 0.02)
    after = correct(FLOAT, est, (0.0,) * 3, (0.0,) * 3, (0.1, 0.0, 0.0), q, 0.0, 0.01, GAINS)
    assert after.p[0] == pytest.approx(0.1 * 20.0 * 0.01)
    assert after.v[0] == pytest.approx(0.1 * 150.0 * 0.01)
    assert 2 * math.asin(after.q[3]) == pytest.approx(0.02 * 6.0 * 0.01, rel=1e-3)
    assert after.bias[2] == pytest.approx(-0.02 * 0.5 * 0.01, rel=1e-3)


def test_predict_of_a_fall_is_a_parabola():
    est = Estimate((0.0, 0.0, -10.0), (3.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0,) * 3)
    for _ in range(500):
        est, _, a, _ = predict(FLOAT, est, (0.0,) * 3, (0.0,) * 3, TICK_S)
        assert a == (0.0, 0.0, GRAVITY)
    assert est.p == pytest.approx((1.5, 0.0, -10.0 + 0.5 * GRAVITY * 0.25))
    assert est.v == pytest.approx((3.0, 0.0, GRAVITY * 0.5))


def test_predict_of_a_constant_rate_turns_exactly():
    est = Estimate((0.0,) * 3, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3))
    rate = np.array([2.0, -1.0, 0.5])
    seen = None
    for _ in range(1000):
        est, seen, *_ = predict(FLOAT, est, tuple(rate + est.bias), (0.0,) * 3, TICK_S)
    assert seen == pytest.approx(rate)
    assert est.q == pytest.approx(quat_exp(FLOAT, tuple(rate)), abs=1e-12)


def _truth(t):
    """p, v, a, q, rate of a circle of 2 m at 3 m/s, level, turning at half that pace."""
    w = 1.5
    c, s = math.cos(w * t), math.sin(w * t)
    p, v, a = (2 * c, 2 * s, -2.0), (-2 * w * s, 2 * w * c, 0.0), (-2 * w * w * c, -2 * w * w * s, 0.0)
    return p, v, a, quat_from_euler(FLOAT, 0.0, 0.0, 0.5 * w * t), (0.0, 0.0, 0.5 * w)


def _fly(latency_s, stated_age_s, seconds=8.0):
    """The errors of p, v, attitude (rad) and bias at the end, from a wrong start, with poses at 100 Hz."""
    gains = GAINS._replace(bias=4.0)  # a bias found within the test's time
    bias = np.array([0.05, -0.03, 0.02])
    p, v, *_ = _truth(0.0)
    est = Estimate(
        tuple(np.add(p, 0.3)), tuple(np.add(v, -0.5)), quat_exp(FLOAT, (0.1, -0.1, 0.2)), (0.0,) * 3
    )
    ticks = round(seconds / TICK_S)
    for tick in range(1, ticks + 1):
        t = tick * TICK_S
        _, _, a, q, rate = _truth(t)
        force = mat_t_vec(quat_to_matrix(FLOAT, q), (a[0], a[1], a[2] - GRAVITY))
        est, rate_seen, accel, _ = predict(FLOAT, est, tuple(np.add(rate, bias)), force, TICK_S)
        if tick % 10 == 0:
            p_late, *_, q_late, _ = _truth(t - latency_s)
            est = correct(FLOAT, est, rate_seen, accel, p_late, q_late, stated_age_s, 0.01, gains)
    p, v, _, q, _ = _truth(ticks * TICK_S)
    turn = quat_multiply([est.q[0], *(-x for x in est.q[1:])], q)
    return (
        math.dist(p, est.p),
        math.dist(v, est.v),
        2 * math.hypot(*turn[1:]),
        float(np.linalg.norm(bias - est.bias)),
    )


def test_estimator_from_a_wrong_start_finds_the_state_and_the_bias():
    p, v, attitude, bias = _fly(0.015, 0.015)
    assert p < 1e-3
    assert v < 1e-2
    assert attitude < 2e-3
    assert bias < 1e-2


def test_correct_by_a_late_attitude_in_a_quick_turn_counts_less():
    est = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def turned(age, rate):
        q = quat_exp(FLOAT, (0.1 - age * rate, 0.0, 0.0))  # 0.1 rad off after the turn
        after = correct(FLOAT, est, (rate, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, q, age, 0.01, GAINS)
        return after.q[1] / (0.01 * GAINS.attitude + age * 0.01 * GAINS.bias)

    calm = turned(0.0, 0.0)
    assert turned(0.02, 5.0) == pytest.approx(calm)  # in time
    assert turned(0.1, 0.2) == pytest.approx(calm)  # hardly a turn
    assert turned(0.1, 3.0) < 0.1 * calm


def test_correct_in_a_shock_does_not_extrapolate_it_over_the_age_of_the_pose():
    est = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def moved(shock):
        pose = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        after = correct(FLOAT, est, (0.0,) * 3, (0.0, 0.0, -shock), *pose, 0.12, 0.01, GAINS)
        return after.p[2], after.v[2]

    assert moved(500.0) == moved(ACCELERATION_MAX)
    assert moved(0.5 * ACCELERATION_MAX)[1] == pytest.approx(0.5 * moved(ACCELERATION_MAX)[1])


@pytest.mark.parametrize(("age_s", "seconds"), [(0.05, 8.0), (0.1, 8.0), (0.15, 30.0)])
def test_errors_die_out_however_old_the_poses_are(age_s: float, seconds: float):
    """Later, since late attitudes of a turning vehicle count less."""
    p, v, attitude, bias = _fly(age_s, age_s, seconds)
    assert p < 0.01
    assert v < 0.1
    assert attitude < 2e-3
    assert bias < 1e-2


def test_correction_of_an_old_pose_is_that_of_its_moment_carried_on():
    q = quat_exp(FLOAT, (0.0, 0.0, 0.02))
    at_rest = Estimate((0.0,) * 3, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3)
    rest = (0.0,) * 3, (0.0,) * 3, (0.1, 0.0, 0.0), q
    then = correct(FLOAT, at_rest, *rest, 0.0, 0.01, GAINS)
    carried = then
    for _ in range(200):
        carried, *_ = predict(FLOAT, carried, (0.0,) * 3, (0.0, 0.0, -GRAVITY), TICK_S)
    late = correct(FLOAT, at_rest, *rest, 0.2, 0.01, GAINS)
    assert late.p == pytest.approx(carried.p, abs=1e-12)
    assert (late.v[0], late.bias[2]) == (then.v[0], then.bias[2])
    assert late.q == pytest.approx(carried.q, abs=1e-9)


def test_estimator_told_no_age_lags_by_the_latency():
    """At 3 m/s a pose 15 ms old is 45 mm behind; the age takes that away."""
    assert _fly(0.015, 0.0)[0] > 0.03
    assert _fly(0.015, 0.015)[0] < 0.001


def test_estimator_after_a_long_gap_does_not_overshoot():
    est = Estimate((0.0,) * 3, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3)
    after = correct(FLOAT, est, (0.0,) * 3, (0.0,) * 3, (1.0, 0.0, 0.0), est.q, 0.0, 3.0, GAINS)
    assert 0.0 < after.p[0] < 1.0


def _worst_left(gains, interval, age):
    """Errors of p and q, and of v and bias, left of 1 cm and 10 mrad after 400 poses of a vehicle at rest."""
    est = Estimate((0.01, 0.0, 0.0), (0.0,) * 3, quat_exp(FLOAT, (0.01, 0.0, 0.0)), (0.0,) * 3)
    level = ((0.0,) * 3, (1.0, 0.0, 0.0, 0.0))
    still, steps = (0.0,) * 3, round(interval / 1e-3)
    for k in range(400 * steps):
        felt = mat_t_vec(quat_to_matrix(FLOAT, est.q), (0.0, 0.0, -GRAVITY))  # so that p and q do not mix
        est, rate, a, _ = predict(FLOAT, est, still, felt, 1e-3)
        if k % steps == steps - 1:
            est = correct(FLOAT, est, rate, a, *level, age, interval, gains)
    return max(abs(est.p[0]), abs(est.v[0])) / 0.01, max(abs(2.0 * est.q[1]), abs(est.bias[0])) / 0.01


@pytest.mark.parametrize("share", [0.1, 0.4, 0.7, 0.99])
@pytest.mark.parametrize("age", [0.0, 0.1])
def test_errors_die_out_within_the_bound_of_the_gains_and_grow_beyond_it(share, age):
    """share: of 2 h gain in 2 h gain + h^2 rate_gain, which is 4 at the bound."""
    h = INTERVAL_MAX_S
    for size, stable in ((0.95, True), (1.05, False)):
        gain, rate_gain = 4.0 * size * share / (2.0 * h), 4.0 * size * (1.0 - share) / (h * h)
        assert converges(gain, rate_gain) == stable
        p_left, q_left = _worst_left(EstimatorGains(gain, rate_gain, gain, rate_gain), h, age)
        assert p_left < 0.5 if stable else p_left > 10.0
        if age <= LATE_S:  # a late attitude counts less once it turns the estimate quickly
            assert q_left < 0.5 if stable else q_left > 10.0
        sooner = _worst_left(EstimatorGains(gain, rate_gain, gain, rate_gain), 0.02, age)
        assert max(sooner if age <= LATE_S else sooner[:1]) < 0.5  # they die out in either case


@pytest.mark.parametrize(
    ("gain", "rate_gain", "stable"), [(0.0, 1.0, False), (5.0, 0.0, True), (5.0, -0.1, False)]
)
def test_gains_that_correct_nothing_do_not_converge(gain, rate_gain, stable):
    assert converges(gain, rate_gain) == stable
