"""The disturbance observer: estimates the acceleration that gravity and nominal thrust do not explain.

    d_hat' = L (v' - g e3 + R e3 T/m - d_hat),     T' = (T_cmd - T) / tau

v is the estimated velocity, R e3 the body z axis of the estimated attitude, and T the commanded collective
thrust after the nominal rotor lag. d_hat therefore follows d in v' = g e3 - R e3 T/m + d as a first-order lag
with bandwidth L. Over a tick v' is the change of velocity. (Guo and Cao, Anti-Disturbance Control, 2014; the
baseline DO of paper section V-B.)

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


def measured_disturbance(v_dot: Vector, R: Vector, thrust_n: Scalar, mass_kg: Scalar) -> list[Scalar]:
    """Return the acceleration beyond gravity and nominal thrust (m/s^2, NED), which d_hat follows.

    v_dot: derivative of the estimated velocity (m/s^2, NED). R: estimated R_ned_frd, 9 scalars.
    """
    up = thrust_n / mass_kg
    return [v_dot[0] + R[2] * up, v_dot[1] + R[5] * up, v_dot[2] + R[8] * up - GRAVITY]


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
