"""The disturbance observer: estimates the acceleration that gravity and nominal thrust do not explain.

    d_hat' = L (v' - g e3 + R z_T T/m - d_ff - d_hat),     T' = (T_cmd - T) / tau

v is the estimated velocity, R the estimated attitude, and T the commanded collective thrust after the nominal
rotor lag. z_T is opposite to the thrust in the frame of the poses: e3 without an attitude offset in the
feed-forward. d_ff is the residual acceleration that the feed-forward predicts. d_hat therefore follows the
remainder d - d_ff in v' = g e3 - R z_T T/m + d as a first-order lag with bandwidth L. Over a tick v' is the
change of velocity. (Guo and Cao, Anti-Disturbance Control, 2014; DO and Neural DO of paper sections V-B and
VI-D.)

The observer uses the estimated velocity instead of the accelerometer. Between poses this velocity is the
integral of the accelerometer, so no noisy signal is differentiated; over longer times the camera determines
it. A bias of the accelerometer, which no flight reveals, would act as a constant disturbance; here it
cancels. Errors of attitude and mass appear in d_hat, because they act on the flight like a disturbance.
Thrust acts through the nominal lag, so d_hat does not depend on the bandwidth of the loop: for a nominal
vehicle it is 0 in any manoeuvre.
"""

from __future__ import annotations

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import dot

DISTURBANCE_MAX = 5.0
"""Greatest magnitude of d_hat, m/s^2. A greater d_hat is scaled down."""


def measured_disturbance(
    v_dot: Vector,
    R: Vector,
    thrust_n: Scalar,
    mass_kg: Scalar,
    predicted: Vector = (0.0, 0.0, 0.0),
    attitude_offset: Vector = (0.0, 0.0),
) -> list[Scalar]:
    """Return the acceleration beyond gravity, nominal thrust and `predicted` (m/s^2, NED).

    v_dot: derivative of the estimated velocity (m/s^2, NED). R: estimated R_ned_frd, 9 scalars. predicted:
    residual acceleration that the feed-forward compensates (m/s^2, NED). attitude_offset: roll and pitch
    (rad) that the poses show when thrust points exactly as intended; to first order.
    """
    up = thrust_n / mass_kg
    roll, pitch = attitude_offset
    z = [R[3 * i + 2] - pitch * R[3 * i] + roll * R[3 * i + 1] for i in range(3)]
    return [
        v_dot[0] + z[0] * up - predicted[0],
        v_dot[1] + z[1] * up - predicted[1],
        v_dot[2] + z[2] * up - GRAVITY - predicted[2],
    ]


def observe(ops: Ops, gain: Scalar, d_hat: Vector, measured: Vector, dt: Scalar) -> list[Scalar]:
    """Return d_hat (m/s^2, NED) after `dt`, within its bound; unchanged if `gain` (1/s) is 0.

    measured: as `measured_disturbance` returns it.
    """
    return bounded(ops, [d + dt * (gain * (m - d)) for d, m in zip(d_hat, measured, strict=True)])


def bounded(ops: Ops, d_hat: Vector) -> list[Scalar]:
    """Return d_hat with at most the magnitude DISTURBANCE_MAX."""
    bound_squared = DISTURBANCE_MAX * DISTURBANCE_MAX
    # Exactly 1 within the bound.
    scale = ops.sqrt(bound_squared / ops.maximum(dot(d_hat, d_hat), bound_squared))
    return [scale * d for d in d_hat]


def lagged_thrust(thrust_n: Scalar, commanded_n: Scalar, lag_s: Scalar, dt: Scalar) -> Scalar:
    """Return collective thrust (N) after `dt` under a constant command, with a first-order lag of `lag_s`."""
    return thrust_n + dt / (lag_s + 0.5 * dt) * (commanded_n - thrust_n)
