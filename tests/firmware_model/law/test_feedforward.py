"""Feed-forward: signs, the neutral block, derivatives by finite differences, the network against numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from trimtab.firmware_model.law import feedforward as ff
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import euler_to_matrix, quat_exp, quat_multiply, quat_to_matrix
from trimtab.protocol import blobs

LEVEL = euler_to_matrix(FLOAT, (0.0, 0.0, 0.0))


def _block(**parts):
    block = list(ff.NEUTRAL)
    for name, value in parts.items():
        block[getattr(ff, name)] = value
    return tuple(block)


def test_block_layout_is_the_blobs():
    assert ff.FF_SIZE == len(ff.NEUTRAL) == blobs.BLOCK_SIZE + len(blobs.TrainedRegion._fields)
    assert (*blobs.NEUTRAL_BLOCK, *ff.OPEN_REGION) == ff.NEUTRAL
    for name, where in (
        ("gain", slice(ff.GAIN, ff.GAIN + 1)),
        ("bias_ned", ff.BIAS),
        ("linear_drag", ff.LINEAR),
        ("quadratic_drag", ff.QUADRATIC),
        ("attitude_offset", ff.ATTITUDE_OFFSET),
        ("prediction_time_s", slice(ff.PREDICTION_TIME, ff.PREDICTION_TIME + 1)),
        ("wind_ned", ff.WIND),
        ("voltage_exponent", slice(ff.VOLTAGE_EXPONENT, ff.VOLTAGE_EXPONENT + 1)),
    ):
        names = [field for field, _ in blobs.BLOCK_FIELDS]
        start = sum(size for _, size in blobs.BLOCK_FIELDS[: names.index(name)])
        assert (where.start, where.stop) == (start, start + dict(blobs.BLOCK_FIELDS)[name])


def test_specific_force_of_the_neutral_block_is_nothing():
    assert ff.specific_force_ned(FLOAT, ff.NEUTRAL, (5.0, -3.0, 1.0), LEVEL) == pytest.approx((0.0,) * 3)


def test_specific_force_of_drag_is_against_the_motion_along_body_axes():
    block = _block(LINEAR=(0.5, 0.3, 0.1), QUADRATIC=(0.02, 0.0, 0.0))
    heading_east = euler_to_matrix(FLOAT, (0.0, 0.0, math.pi / 2))
    force = ff.specific_force_ned(FLOAT, block, (0.0, 4.0, 0.0), heading_east)
    assert force == pytest.approx((0.0, -4.0 * (0.5 + 0.02 * 4.0), 0.0), abs=1e-12)
    force = ff.specific_force_ned(FLOAT, block, (4.0, 0.0, 0.0), heading_east)
    assert force == pytest.approx((-4.0 * 0.3, 0.0, 0.0), abs=1e-12)


def test_specific_force_of_a_bias_is_the_bias_whatever_the_attitude():
    R = euler_to_matrix(FLOAT, (0.4, -0.5, 2.0))
    force = ff.specific_force_ned(FLOAT, _block(BIAS=(0.1, 0.2, 0.3)), (5.0, 1.0, 0.0), R)
    assert force == pytest.approx((0.1, 0.2, 0.3))


def test_specific_force_of_drag_vanishes_at_the_velocity_of_the_air():
    block = _block(LINEAR=(0.5, 0.3, 0.1), QUADRATIC=(0.02, 0.1, 0.0), WIND=(2.0, -1.0, 0.5))
    R = euler_to_matrix(FLOAT, (0.4, -0.5, 2.0))
    assert ff.specific_force_ned(FLOAT, block, (2.0, -1.0, 0.5), R) == pytest.approx((0.0,) * 3, abs=1e-12)
    still = ff.specific_force_ned(
        FLOAT, _block(LINEAR=(0.5, 0.3, 0.1), QUADRATIC=(0.02, 0.1, 0.0)), (1.0, 1.0, -0.5), R
    )
    assert ff.specific_force_ned(FLOAT, block, (3.0, 0.0, 0.0), R) == pytest.approx(still)


REGION = (4.0, 0.5, 7.0, 13.0)


@pytest.mark.parametrize(
    ("v", "tilt", "thrust", "weight"),
    [
        ((4.0, 0.0, 0.0), 0.0, 9.8, 1.0),
        ((4.4, 0.0, 0.0), 0.0, 9.8, 1.0),
        ((0.0, 5.2, 0.0), 0.0, 9.8, 0.5),
        ((0.0, 0.0, 6.0), 0.0, 9.8, 0.0),
        ((0.0, 0.0, 0.0), 0.549, 9.8, 1.0),
        ((0.0, 0.0, 0.0), 0.65, 9.8, 0.5),
        ((0.0, 0.0, 0.0), 0.76, 9.8, 0.0),
        ((0.0, 0.0, 0.0), 0.0, 7.0 / 1.1, 1.0),
        ((0.0, 0.0, 0.0), 0.0, 3.5 * (1.0 / 1.1 + 1.0 / 1.5), 0.5),
        ((0.0, 0.0, 0.0), 0.0, 1.3 * 13.0, 0.5),
        ((0.0, 5.2, 0.0), 0.65, 9.8, 0.25),
    ],
)
def test_weight_fades_between_the_margin_and_the_end_of_each_bound(v, tilt, thrust, weight):
    for roll, pitch in ((tilt, 0.0), (0.0, -tilt)):
        R = euler_to_matrix(FLOAT, (roll, pitch, 1.0))
        assert ff.fade_weight(FLOAT, REGION, v, R, thrust) == pytest.approx(weight, abs=1e-6)


def test_weight_without_bounds_is_exactly_one():
    R = euler_to_matrix(FLOAT, (3.0, 0.2, 1.0))
    assert ff.fade_weight(FLOAT, ff.OPEN_REGION, (1e3, 0.0, 0.0), R, 0.0) == 1.0


@pytest.mark.parametrize("body_frame", [False, True])
def test_network_derivative_matches_finite_differences(body_frame):
    rng = np.random.default_rng(6)
    layers = (7, 5)
    weights = rng.normal(size=ff.weight_count(layers, 3 if body_frame else 6)).tolist()
    for _ in range(20):
        v, a, rate = rng.normal(size=3) * 3, rng.normal(size=3) * 8, rng.normal(size=3) * 4
        q = quat_exp(FLOAT, tuple(0.4 * rng.normal(size=3)))

        def residual(dt, v=v, a=a, rate=rate, q=q):
            R = quat_to_matrix(FLOAT, quat_multiply(q, quat_exp(FLOAT, tuple(dt * rate))))
            motion = ff.FlatMotion(tuple(v + dt * a), tuple(a), R, tuple(rate))
            return ff.network_residual(FLOAT, weights, layers, motion, body_frame=body_frame)

        h = 1e-5
        slope = (np.array(residual(h).accel_ned) - np.array(residual(-h).accel_ned)) / (2.0 * h)
        assert np.allclose(slope, residual(0.0).jerk_ned, atol=1e-5, rtol=1e-5)


def test_gain_is_unchanged_to_the_bit_without_an_exponent():
    assert ff.gain_at_voltage(FLOAT, 0.93, 0.0, 0.87) == 0.93
    assert ff.gain_at_voltage(FLOAT, 0.93, 1.7, 0.87) == pytest.approx(0.93 * 0.87**1.7)


def test_specific_force_rate_matches_finite_differences():
    rng = np.random.default_rng(4)
    for _ in range(50):
        block = tuple(rng.uniform(-0.5, 0.5, ff.FF_SIZE))
        v, a, rate = rng.normal(size=3) * 5, rng.normal(size=3) * 8, rng.normal(size=3) * 4
        q = quat_exp(FLOAT, tuple(rng.normal(size=3)))

        def force(dt, v=v, a=a, rate=rate, q=q, block=block):
            R = quat_to_matrix(FLOAT, quat_multiply(q, quat_exp(FLOAT, tuple(dt * rate))))
            return np.array(ff.specific_force_ned(FLOAT, block, tuple(v + dt * a), R))

        h = 1e-5
        R0 = quat_to_matrix(FLOAT, q)
        found = ff.specific_force_rate_ned(FLOAT, block, tuple(v), tuple(a), tuple(rate), R0)
        assert np.allclose((force(h) - force(-h)) / (2 * h), found, atol=1e-6, rtol=1e-7)


@pytest.mark.parametrize("layers", [(5,), (32, 32), (7, 3, 4)])
def test_network_agrees_with_matrix_products(layers):
    rng = np.random.default_rng(5)
    weights, x = rng.normal(size=ff.weight_count(layers)), rng.normal(size=6)
    at, values = 0, x
    sizes = (*layers, 3)
    for k, width in enumerate(sizes):
        table = weights[at : at + width * (len(values) + 1)].reshape(width, -1)
        at += table.size
        values = table[:, :-1] @ values + table[:, -1]
        values = np.tanh(values) if k < len(sizes) - 1 else values
    found = ff.network(FLOAT, weights.tolist(), layers, tuple(x[:3]), tuple(x[3:]))
    assert np.allclose(found, values, atol=1e-12)


def test_weight_count_of_the_largest_network_is_the_blobs_bound():
    assert ff.weight_count((32, 32, 32)) == 2435


@pytest.mark.parametrize("layers", [(), (33,), (8, 8, 8, 8), (0,)])
def test_weight_count_beyond_the_bound_raises_value_error(layers):
    with pytest.raises(ValueError, match="hidden layers"):
        ff.weight_count(layers)


def test_network_with_a_wrong_number_of_weights_raises_value_error():
    with pytest.raises(ValueError, match="weights"):
        ff.network(FLOAT, [0.0] * 10, (4,), (0.0,) * 3, (0.0,) * 3)
