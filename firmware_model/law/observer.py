"""The disturbance observer: the acceleration that gravity and the rotors' nominal thrust do not account for.

    d_hat' = L (v' - g e3 + R e3 T/m - d_hat),     T' = (T_cmd - T) / tau

v is the estimator's velocity, R e3 its attitude's z axis, T the collective thrust commanded, behind the
nominal rotor lag. So d_hat follows d in v' = g e3 - R e3 T/m + d to first order, with bandwidth L; over a
tick v' is the step of the velocity. (Guo and Cao, Anti-Disturbance Control, 2014; the baseline DO of paper
section V-B.)

Why the velocity and not the accelerometer itself: between poses the estimator's velocity is the
accelerometer's integral, so nothing is differentiated that is noisy; over longer times it is the camera's.
An accelerometer's bias, which no flight shows, would be flown as a standing disturbance; here it cancels.
What attitude and mass get wrong is in d_hat as it is in the flight. The thrust acts through the nominal lag,
not at once, so that d_hat does not depend on how fast the loop is: for a nominal vehicle it is 0 in any
manoeuvre.
"""

from __future__ import annotations

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import dot

GREATEST = 5.0
"""Longest d_hat, m/s^2; a longer one is cut down in its direction."""


def disturbance_seen(v_dot: Vector, R: Vector, thrust_n: Scalar, mass_kg: Scalar) -> list[Scalar]:
    """Return what accelerates beyond gravity and nominal thrust (m/s^2, NED), d_hat's target.

    v_dot: change of the estimated velocity (m/s^2, NED); R: R_ned_frd as estimated, 9 scalars.
    """
    up = thrust_n / mass_kg
    return [v_dot[0] + R[2] * up, v_dot[1] + R[5] * up, v_dot[2] + R[8] * up - GRAVITY]


def observe(ops: Ops, gain: Scalar, d_hat: Vector, seen: Vector, dt: Scalar) -> list[Scalar]:
    """d_hat (m/s^2, NED) `dt` later, within its bound; as it was where `gain` (1/s) is 0."""
    return bounded(ops, [d + dt * (gain * (s - d)) for d, s in zip(d_hat, seen, strict=True)])


def bounded(ops: Ops, d_hat: Vector) -> list[Scalar]:
    """d_hat, no longer than GREATEST."""
    most = GREATEST * GREATEST
    # Exactly 1 while within the bound.
    scale = ops.sqrt(most / ops.maximum(dot(d_hat, d_hat), most))
    return [scale * d for d in d_hat]


def lagged_thrust(thrust_n: Scalar, commanded_n: Scalar, lag_s: Scalar, dt: Scalar) -> Scalar:
    """Return collective thrust (N) `dt` later with this command held over it, behind a lag of `lag_s`."""
    return thrust_n + dt / (lag_s + 0.5 * dt) * (commanded_n - thrust_n)
