"""Feed-forward: the residual acceleration that a model predicts along the reference, for compensation.

Form (a) is a set of coefficients in a block of `FF_SIZE` numbers. Form (b) is a network of at most three
hidden layers of 32 neurons. A feed-forward has one form, or the sum of both. They depend on the reference and
its flat attitude, not on the estimate. The prediction time is an exception: the estimator adds it to the age
of every pose.

Layout of the block: gain (actual over nominal rotor thrust), bias_ned 3 (m/s^2), linear drag 3 (1/s) and
quadratic drag 3 (1/m) along FRD axes, both positive against the motion through the air, attitude offset 2
(misalignment, rad: roll and pitch that the poses show when thrust points exactly as intended), prediction
time (s), wind_ned 3 (velocity of the air, m/s), voltage exponent (rotor thrust goes with this power of
battery voltage over full voltage), region 4.

The region is the part of the state space in which the model was trained: greatest speed (m/s), greatest tilt
(rad), least and greatest thrust over mass (m/s^2). Beyond it the residual acceleration fades out. Gain,
attitude offset and prediction time do not fade, because they are constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import (
    cross,
    dot,
    euler_rates,
    mat_t_vec,
    mat_vec,
    matrix_to_euler,
)

FF_SIZE = 21
GAIN = 0
BIAS = slice(1, 4)
LINEAR = slice(4, 7)
QUADRATIC = slice(7, 10)
ATTITUDE_OFFSET = slice(10, 12)
PREDICTION_TIME = 12
WIND = slice(13, 16)
VOLTAGE_EXPONENT = 16
REGION = slice(17, 21)
OPEN_REGION = (1e9, 1e9, 0.0, 1e9)
"""Region without bounds."""
NEUTRAL: tuple[float, ...] = (1.0, *(0.0,) * 16, *OPEN_REGION)
"""Block that has no effect."""
REGION_MARGIN = 1.1
"""Multiple of its bounds up to which a model is trusted. A plan with the model may go that far."""
REGION_END = 1.5
"""Multiple of the bounds from which on no residual acceleration is fed forward."""

VOLTAGE_RATIO = (0.5, 1.2)
"""Range of battery voltage over full voltage. A voltage outside it is a faulty measurement."""

MAX_LAYERS, MAX_WIDTH = 3, 32
NETWORK_INPUTS, NETWORK_OUTPUTS = 6, 3

_TINY = 1e-12
"""Keeps the derivative of a square root finite at 0."""


class FlatMotion(NamedTuple):
    """Motion along the reference: velocity and acceleration (NED), flat R_ned_frd (9), body rate (FRD)."""

    v_ned: Vector
    a_ned: Vector
    R: Vector
    rate_frd: Vector


class Residual(NamedTuple):
    """Predicted residual acceleration (m/s^2, NED), and its time derivative (m/s^3, NED)."""

    accel_ned: Vector
    jerk_ned: Vector


NO_RESIDUAL = Residual((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def full_block(coefficients: Sequence[float] | None, region: Sequence[float] | None) -> tuple[float, ...]:
    """Return the block of form (a), neutral for None, and of a region, open for None."""
    return (
        *(NEUTRAL[: REGION.start] if coefficients is None else coefficients),
        *(OPEN_REGION if region is None else region),
    )


def gain_at_voltage(ops: Ops, gain: Scalar, exponent: Scalar, voltage_ratio: Scalar) -> Scalar:
    """Return actual over nominal rotor thrust at this battery voltage over full voltage.

    gain: at full voltage. exponent: VOLTAGE_EXPONENT of the block. The ratio is clipped to VOLTAGE_RATIO.
    """
    return gain * ops.exp(exponent * ops.log(ops.clip(voltage_ratio, *VOLTAGE_RATIO)))


def fade_weight(ops: Ops, region: Vector, v_ref: Vector, R_flat: Vector, thrust: Scalar) -> Scalar:
    """Return the weight of the residual acceleration along the reference.

    It is 1 up to REGION_MARGIN times a bound of the region and 0 from REGION_END times it.

    v_ref: reference velocity (m/s, NED). R_flat: flat R_ned_frd, 9 scalars. thrust: thrust over mass (m/s^2).
    """
    speed_max, tilt_max, thrust_min, thrust_max = region
    speed = ops.sqrt(dot(v_ref, v_ref) + _TINY)
    tilt = ops.atan2(ops.sqrt(R_flat[2] * R_flat[2] + R_flat[5] * R_flat[5] + _TINY), R_flat[8])
    weight = 1.0
    for value, trusted, end in (
        (speed, REGION_MARGIN * speed_max, REGION_END * speed_max),
        (tilt, REGION_MARGIN * tilt_max, REGION_END * tilt_max),
        (-thrust, -thrust_min / REGION_MARGIN, -thrust_min / REGION_END),
        (thrust, REGION_MARGIN * thrust_max, REGION_END * thrust_max),
    ):
        x = ops.clip((value - trusted) / (end - trusted + _TINY), 0.0, 1.0)
        weight = weight * (1.0 - x * x * (3.0 - 2.0 * x))
    return weight


def specific_force_ned(ops: Ops, block: Vector, v_ref: Vector, R_flat: Vector) -> tuple[Scalar, ...]:
    """Return the predicted residual acceleration (m/s^2, NED) at a reference velocity (NED) and attitude."""
    v = mat_t_vec(R_flat, _through_air(block, v_ref))
    speed = ops.sqrt(dot(v, v) + _TINY)
    drag = mat_vec(R_flat, _drag(block, v, speed))
    return tuple(bias + d for bias, d in zip(block[BIAS], drag, strict=True))


def specific_force_rate_ned(
    ops: Ops, block: Vector, v_ref: Vector, a_ref: Vector, rate: Vector, R_flat: Vector
) -> tuple[Scalar, ...]:
    """Return the time derivative of `specific_force_ned` (m/s^3, NED) at the acceleration `a_ref` (NED).

    rate: body rate of the flat attitude (FRD).
    """
    v, a = mat_t_vec(R_flat, _through_air(block, v_ref)), mat_t_vec(R_flat, a_ref)
    p, q, r = rate
    # Derivatives in the rotating body frame: v' = R^T a - omega x v, then F' + omega x F.
    dv = (a[0] - (q * v[2] - r * v[1]), a[1] - (r * v[0] - p * v[2]), a[2] - (p * v[1] - q * v[0]))
    speed = ops.sqrt(dot(v, v) + _TINY)
    speed_dot = dot(v, dv) / speed
    fx, fy, fz = _drag(block, v, speed)
    gx, gy, gz = _drag(block, dv, speed)
    kx, ky, kz = block[QUADRATIC]
    return mat_vec(
        R_flat,
        (
            gx - kx * speed_dot * v[0] + (q * fz - r * fy),
            gy - ky * speed_dot * v[1] + (r * fx - p * fz),
            gz - kz * speed_dot * v[2] + (p * fy - q * fx),
        ),
    )


def weight_count(layers: Sequence[int], inputs: int = NETWORK_INPUTS) -> int:
    """Return the number of weights of a network. Raises ValueError for more than 3 hidden layers of 32."""
    if not 1 <= len(layers) <= MAX_LAYERS or not all(1 <= width <= MAX_WIDTH for width in layers):
        raise ValueError(
            f"hidden layers {list(layers)}: must be 1 to {MAX_LAYERS} layers of 1 to {MAX_WIDTH} neurons"
        )
    sizes = (inputs, *layers, NETWORK_OUTPUTS)
    return sum((a + 1) * b for a, b in pairwise(sizes))


def network(ops: Ops, weights: Vector, layers: Sequence[int], v: Vector, rpy: Vector) -> tuple[Scalar, ...]:
    """Return the residual acceleration (m/s^2, NED) of a tanh network at `v` (NED) and Euler angles `rpy`.

    weights: weights by layer; for each neuron its input weights, then its bias. The output layer is linear.
    Raises ValueError if the number of weights does not match `layers`.
    """
    values: list[Scalar] = [*v, *rpy]
    count = weight_count(layers, len(values))
    if len(weights) != count:
        raise ValueError(f"hidden layers {list(layers)} need {count} weights, not {len(weights)}")
    at = 0
    for width in layers:
        values, at = _layer(weights, at, width, values)
        values = [ops.tanh(value) for value in values]
    return tuple(_layer(weights, at, NETWORK_OUTPUTS, values)[0])


def network_residual(
    ops: Ops,
    weights: Vector,
    layers: Sequence[int],
    flight: FlatMotion,
    *,
    body_frame: bool,
    with_jerk: bool = True,
) -> Residual:
    """Return the residual of a tanh network along the reference.

    The network in the world frame takes velocity (NED) and Euler angles, the one in the body frame the
    velocity in FRD. The derivative follows from the chain rule; without `with_jerk` it is 0.
    """
    v, a, R, rate = flight
    if body_frame:
        velocity = mat_t_vec(R, v)
        rates = [x - y for x, y in zip(mat_t_vec(R, a), cross(rate, velocity), strict=True)]
        force, force_rate = _with_rate(ops, weights, layers, velocity, rates)
        turned = [x + y for x, y in zip(force_rate, cross(rate, force), strict=True)]
        residual = Residual(mat_vec(R, force), mat_vec(R, turned))
    else:
        rpy = matrix_to_euler(ops, R)
        inputs, input_rates = (*v, *rpy), (*a, *euler_rates(ops, rpy, rate))
        residual = Residual(*_with_rate(ops, weights, layers, inputs, input_rates))
    return residual if with_jerk else residual._replace(jerk_ned=NO_RESIDUAL.jerk_ned)


def _with_rate(
    ops: Ops, weights: Vector, layers: Sequence[int], inputs: Sequence[Scalar], rates: Sequence[Scalar]
) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
    """Return the outputs of a network, and their time derivatives, for inputs with these derivatives."""
    values, slopes, at = list(inputs), list(rates), 0
    for width in layers:
        slopes, _ = _layer(weights, at, width, slopes, biased=False)
        values, at = _layer(weights, at, width, values)
        values = [ops.tanh(value) for value in values]
        slopes = [(1.0 - y * y) * slope for y, slope in zip(values, slopes, strict=True)]
    slopes, _ = _layer(weights, at, NETWORK_OUTPUTS, slopes, biased=False)
    values, _ = _layer(weights, at, NETWORK_OUTPUTS, values)
    return tuple(values), tuple(slopes)


def _through_air(block: Vector, v_ref: Vector) -> tuple[Scalar, ...]:
    """Return the velocity relative to the air (m/s, NED)."""
    return tuple(v - wind for v, wind in zip(v_ref, block[WIND], strict=True))


def _layer(
    weights: Vector, at: int, width: int, values: Sequence[Scalar], *, biased: bool = True
) -> tuple[list[Scalar], int]:
    """Return the weighted sums of a layer, and the index of the next layer's first weight."""
    out = []
    for _ in range(width):
        total = weights[at + len(values)] if biased else 0.0
        for k, value in enumerate(values):
            total = total + weights[at + k] * value
        out.append(total)
        at += len(values) + 1
    return out, at


def _drag(block: Vector, v: Vector, speed: Scalar) -> tuple[Scalar, ...]:
    """Return the drag (FRD) at a velocity (FRD), with the quadratic part at this speed."""
    return tuple(
        -(linear + quadratic * speed) * component
        for linear, quadratic, component in zip(block[LINEAR], block[QUADRATIC], v, strict=True)
    )
