"""The smoother against curves that are known, and its sigma against the error it makes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.estimator import EstimatorGains
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.log.smoothing import Series, Smoothed, smooth
from trimtab.host.models import estimator
from trimtab.host.models.bias import accelerometer_bias, standing_errors


def curve(t):
    return np.stack([1.5 * np.sin(1.9 * t), np.sin(2.7 * t + 0.3), 0.3 * np.sin(1.3 * t)], axis=1)


def slope(t):
    terms = (1.5 * 1.9 * np.cos(1.9 * t), 2.7 * np.cos(2.7 * t + 0.3), 0.39 * np.cos(1.3 * t))
    return np.stack(terms, axis=1)


def smoothed(t, samples, sigma, at, *, jerk_density) -> Smoothed:
    return smooth([Series(t_s=t, samples=samples, sigma=sigma, at_s=at, jerk_density=jerk_density)])[0]


def test_smooth_noisy_curve_gives_position_velocity_and_honest_sigma():
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0.0, 6.0, 600))
    at = np.linspace(0.5, 5.5, 101)
    samples = curve(t) + 1e-3 * rng.standard_normal((600, 3))
    found = smoothed(t, samples, 1e-3, at, jerk_density=20.0)
    p_rms = np.sqrt(np.square(found.p - curve(at)).mean())
    v_rms = np.sqrt(np.square(found.v - slope(at)).mean())
    assert p_rms < 0.5e-3
    assert v_rms < 0.012
    assert 0.5 < p_rms / np.median(found.sigma_p) < 1.5
    assert 0.5 < v_rms / np.median(found.sigma_v) < 1.5


def test_smooth_gap_is_bridged_with_a_larger_sigma():
    t = np.arange(0.0, 4.0, 0.01)
    t = t[(t < 1.9) | (t > 2.1)]
    found = smoothed(t, curve(t), 1e-3, np.array([1.0, 2.0, 3.0]), jerk_density=20.0)
    assert found.sigma_p[1] > 2.0 * found.sigma_p[0]
    np.testing.assert_allclose(found.p, curve(np.array([1.0, 2.0, 3.0])), atol=3e-3)


def test_smooth_times_in_any_order_keep_theirs():
    t = np.arange(0.0, 2.0, 0.01)
    at = np.array([1.5, 0.5, 1.0])
    found = smoothed(t, curve(t), 1e-3, at, jerk_density=20.0)
    np.testing.assert_allclose(found.p, curve(at), atol=1e-3)


def test_smooth_of_many_is_as_of_each_alone():
    rng = np.random.default_rng(2)
    series = []
    for count, sigma, density in ((200, 1e-3, 20.0), (120, 3e-3, 0.1), (160, 1e-4, 5.0)):
        t = np.sort(rng.uniform(0.0, 2.0, count))
        samples = curve(t) + sigma * rng.standard_normal((count, 3))
        series.append(
            Series(t_s=t, samples=samples, sigma=sigma, at_s=np.linspace(0.1, 1.9, 40), jerk_density=density)
        )
    for one, found in zip(series, smooth(series), strict=True):
        (alone,) = smooth([one])
        for kind in ("p", "v", "sigma_p", "sigma_v"):
            np.testing.assert_allclose(getattr(found, kind), getattr(alone, kind), rtol=1e-9, atol=1e-12)


def test_smooth_too_few_samples_are_refused():
    with pytest.raises(ValueError, match="at least 3 samples"):
        smoothed(np.zeros(2), np.zeros((2, 3)), 1e-3, np.zeros(1), jerk_density=1.0)


GAINS = EstimatorGains(20.0, 120.0, 5.0, 0.5)
LATE = {"gains": GAINS, "age_s": 0.015, "interval_s": 0.01, "step_s": 0.02}


def test_accelerometer_bias_is_found_beside_lateness():
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 10.0, 0.02)
    v, a = slope(t), np.gradient(slope(t), 0.02, axis=0)
    R = np.repeat(np.eye(3)[None], len(t), axis=0)
    bias = np.array([0.03, -0.02, 0.05])
    per_bias, velocity = standing_errors(GAINS, 0.015, 0.01)
    assert velocity == pytest.approx(20.0 / 120.0 + 0.015)
    error = per_bias * bias - 0.012 * v + 2e-4 * a + 3e-4 * rng.standard_normal(v.shape)
    found, _ = accelerometer_bias(error, R, v, a, np.zeros_like(v), **LATE)
    np.testing.assert_allclose(found, bias, atol=0.005)


@pytest.mark.parametrize(("latency_s", "within"), [(0.0, 0.005), (0.015, 0.01), (0.03, 0.025)])
def test_accelerometer_bias_is_not_what_late_poses_do_in_quick_turns(latency_s, within):
    """The estimator's own equations along a circle of 3 rad/s and 10 m/s^2 that grows from rest."""
    bias, step_s = np.array([0.03, -0.02, 0.04]), 0.02
    t = np.arange(0.0, 10.0, 0.5 * step_s)
    grown = 1.2 * (1.0 - np.exp(-((t / 2.0) ** 3)))[:, None]
    p = grown * np.column_stack([np.cos(3.0 * t), np.sin(3.0 * t), 0.2 * np.sin(6.0 * t)])
    v = np.gradient(p, t, axis=0)
    a = np.gradient(v, t, axis=0)
    down = np.array([0.0, 0.0, 9.81]) - a
    down /= np.linalg.norm(down, axis=1)[:, None]
    right = np.cross(down, [1.0, 0.0, 0.0])
    right /= np.linalg.norm(right, axis=1)[:, None]
    R = np.stack([np.cross(right, down), right, down], axis=2)
    turns = Rotation.from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:]).as_rotvec() / (t[1] - t[0])
    rate = np.concatenate([turns, turns[-1:]])
    rate[1:-1] = 0.5 * (turns[1:] + turns[:-1])
    rate_dot = np.gradient(rate, t, axis=0)

    def slopes(k, x):
        acceleration, omega = tuple(a[k]), tuple(rate[k])
        e = estimator.errors_of(x, acceleration, omega)
        attitude = tuple(R[k].ravel())
        estimated = estimator.turn(FLOAT, attitude, e[6:9])
        late = (LATE["age_s"], 0.0, latency_s, LATE["interval_s"], tuple(bias))
        motion = (tuple(v[k]), acceleration, omega, tuple(rate_dot[k]))
        return np.array(estimator.error_rates(GAINS, e, attitude, estimated, *motion, *late))

    per_bias, velocity = standing_errors(GAINS, LATE["age_s"], LATE["interval_s"])
    x = np.concatenate([per_bias * (R[0] @ bias), velocity * (R[0] @ bias), np.zeros(6)])
    errors = [x[:3]]
    for k in range(0, len(t) - 2, 2):
        middle = x + 0.5 * step_s * slopes(k, x)
        x = x + step_s * slopes(k + 1, middle)
        errors.append(x[:3])
    whole = slice(0, 2 * len(errors) - 1, 2)
    shown = -latency_s * v[whole] + 0.5 * latency_s**2 * a[whole]  # by the camera, over the truth
    seen = np.array(errors) - shown
    found, _ = accelerometer_bias(seen, R[whole], v[whole], a[whole], rate[whole], **LATE)
    np.testing.assert_allclose(found, bias, atol=within)


def test_accelerometer_bias_says_how_much_of_it_a_leaning_frame_may_be():
    """At one heading all of it; over whole turns hardly any."""
    t = np.arange(0.0, 10.0, 0.02)
    v, a = slope(t), np.gradient(slope(t), 0.02, axis=0)
    gravity = np.array([0.1, -0.2, 0.0])
    per_bias, _ = standing_errors(GAINS, 0.015, 0.01)
    for turns, left in ((0.0, 0.0), (4.0, 1.0)):
        R = Rotation.from_rotvec(np.outer(0.4 + 0.2 * np.pi * turns * t, (0, 0, 1))).as_matrix()
        rate = np.repeat([[0.0, 0.0, 0.2 * np.pi * turns]], len(t), axis=0)
        error = np.repeat(-per_bias * gravity[None], len(t), axis=0)
        found, share = accelerometer_bias(error, R, v, a, rate, **LATE)
        np.testing.assert_allclose(found + share @ gravity[:2], 0.0, atol=1e-6)
        excess = R @ found + gravity
        assert np.sqrt((excess**2).sum(1).mean() / 0.05) == pytest.approx(left, abs=0.05)
