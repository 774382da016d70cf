"""Feed-forward: the residual acceleration that a model predicts along the reference, for compensation.

Form (a) is a block of `FF_SIZE` numbers. Form (b) is a network of at most three hidden layers of 32 neurons.
A feed-forward has one form, or the sum of both. They depend on the reference and its flat attitude, not on
the estimate. The prediction time is an exception: the estimator adds it to the age of every pose.

Layout of the block: gain (actual over nominal rotor thrust), bias_ned 3 (m/s^2), linear drag 3 (1/s) and
quadratic drag 3 (1/m) along FRD axes, both positive against the motion, attitude offset 2
(misalignment, rad: roll and pitch that the poses show when thrust points exactly as intended), prediction
time (s).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import dot, mat_t_vec, mat_vec

FF_SIZE = 13
GAIN = 0
BIAS = slice(1, 4)
LINEAR = slice(4, 7)
QUADRATIC = slice(7, 10)
ATTITUDE_OFFSET = slice(10, 12)
PREDICTION_TIME = 12
NEUTRAL: tuple[float, ...] = (1.0, *(0.0,) * 12)
"""Block that has no effect."""

MAX_LAYERS, MAX_WIDTH = 3, 32
NETWORK_INPUTS, NETWORK_OUTPUTS = 6, 3


def specific_force_ned(ops: Ops, block: Vector, v_ref: Vector, R_flat: Vector) -> tuple[Scalar, ...]:
    """Return the predicted residual acceleration (m/s^2, NED) at a reference velocity (NED) and attitude."""
    v = mat_t_vec(R_flat, v_ref)
    speed = ops.sqrt(dot(v, v) + 1e-12)
    drag = mat_vec(R_flat, _drag(block, v, speed))
    return tuple(bias + d for bias, d in zip(block[BIAS], drag, strict=True))


def specific_force_rate_ned(
    ops: Ops, block: Vector, v_ref: Vector, a_ref: Vector, rate: Vector, R_flat: Vector
) -> tuple[Scalar, ...]:
    """Return the time derivative of `specific_force_ned` (m/s^3, NED) at the acceleration `a_ref` (NED).

    rate: body rate of the flat attitude (FRD).
    """
    v, a = mat_t_vec(R_flat, v_ref), mat_t_vec(R_flat, a_ref)
    p, q, r = rate
    # Derivatives in the rotating body frame: v' = R^T a - omega x v, then F' + omega x F.
    dv = (a[0] - (q * v[2] - r * v[1]), a[1] - (r * v[0] - p * v[2]), a[2] - (p * v[1] - q * v[0]))
    speed = ops.sqrt(dot(v, v) + 1e-12)
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


def _layer(weights: Vector, at: int, width: int, values: Sequence[Scalar]) -> tuple[list[Scalar], int]:
    """Return the weighted sums of a layer, and the index of the next layer's first weight."""
    out = []
    for _ in range(width):
        total = weights[at + len(values)]
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
