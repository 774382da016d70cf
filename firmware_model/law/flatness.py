"""Differential flatness: attitude, body rate, thrust and torque from flat outputs and their derivatives.

f = g e3 - a is minus the specific force of the rotors, without residual forces. z_frd points along f, thrust
along -z_frd. x_frd lies in the vertical plane of the heading, so yaw is the yaw of ZYX Euler angles. The
computation uses the heading frame: NED rotated by yaw. It is singular only if f lies along the y axis of this
frame (a roll of 90 degrees).

Sources: paper section III-B; Mellinger and Kumar 2011; Faessler, Franchi and Scaramuzza 2018 (choice of x).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.rotations import cross

_TINY = 1e-9
"""Least squared norm, (m/s^2)^2: keeps free fall finite without a measurable effect on a flight."""


class Body(NamedTuple):
    """Mass (kg) and moments of inertia about x, y, z of FRD (kg m^2)."""

    mass_kg: Any
    inertia: Vector


class Heading(NamedTuple):
    """Direction of f, minus the specific force, in the heading frame.

    z: unit vector along f. n: length of its projection on the plane of x and z. force: |f|. cos, sin: of yaw.
    """

    z: Vector
    n: Any
    force: Any
    cos: Any
    sin: Any


def heading(ops: Ops, f: Vector, yaw: Scalar) -> Heading:
    """Return the direction of f = g e3 - a (NED), minus the specific force, at this yaw."""
    c, s = ops.cos(yaw), ops.sin(yaw)
    fx, fy, fz = c * f[0] + s * f[1], c * f[1] - s * f[0], f[2]
    square = fx * fx + fz * fz
    force = ops.sqrt(ops.maximum(square + fy * fy, _TINY))
    per = 1.0 / force
    n = ops.sqrt(ops.maximum(square, _TINY)) * per
    return Heading(z=(fx * per, fy * per, fz * per), n=n, force=force, cos=c, sin=s)


def heading_matrix(thrust_axis: Heading) -> tuple[Scalar, ...]:
    """Return R_ned_frd of this direction, 9 scalars, row-major."""
    zx, zy, zz = thrust_axis.z
    c, s = thrust_axis.cos, thrust_axis.sin
    per = 1.0 / thrust_axis.n
    xx, xz = zz * per, -zx * per
    yx, yz = zy * xz, -zy * xx
    yy = thrust_axis.n
    return (
        c * xx, c * yx - s * yy, c * zx - s * zy,
        s * xx, s * yx + c * yy, s * zx + c * zy,
        xz, yz, zz,
    )  # fmt: skip


def heading_rates(thrust_axis: Heading, f_dot: Vector, yaw_rate: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Return the body rate (FRD) that keeps z_frd along f, given f_dot (NED) and the yaw rate."""
    rate_x, rate_y = _tilt_rates(thrust_axis, *_to_heading(thrust_axis, f_dot))
    per = 1.0 / thrust_axis.n
    return rate_x, rate_y, (yaw_rate * thrust_axis.z[2] * per + rate_y * thrust_axis.z[1]) * per


def flat_attitude(ops: Ops, a: Vector, yaw: Scalar) -> tuple[tuple[Scalar, ...], Scalar]:
    """Return R_ned_frd (9 scalars) and specific thrust |f| (m/s^2) at an acceleration (NED) and yaw."""
    thrust_axis = heading(ops, (-a[0], -a[1], GRAVITY - a[2]), yaw)
    return heading_matrix(thrust_axis), thrust_axis.force


def flat_rates(
    ops: Ops, a: Vector, j: Vector, yaw: Scalar, yaw_rate: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Return the body rate (FRD) at acceleration `a` and jerk `j` (NED), yaw and yaw rate."""
    thrust_axis = heading(ops, (-a[0], -a[1], GRAVITY - a[2]), yaw)
    return heading_rates(thrust_axis, (-j[0], -j[1], -j[2]), yaw_rate)


def flat_full(
    ops: Ops,
    a: Vector,
    j: Vector,
    snap: Vector,
    yaw: Scalar,
    yaw_rate: Scalar,
    model: Body,
    yaw_accel: Scalar = 0.0,
) -> tuple[tuple[Scalar, ...], Vector, Vector, Scalar, Vector]:
    """Return R_ned_frd (9), body rate, its derivative, collective thrust (N) and torque (N m).

    Inverts paper equation 1. a, j and snap are in NED; the results are in FRD.
    """
    thrust_axis = heading(ops, (-a[0], -a[1], GRAVITY - a[2]), yaw)
    zx, zy, zz = thrust_axis.z
    n, force = thrust_axis.n, thrust_axis.force
    per_n, per_f = 1.0 / n, 1.0 / force
    fx, fy, fz = _to_heading(thrust_axis, (-j[0], -j[1], -j[2]))
    rate_x, rate_y = _tilt_rates(thrust_axis, fx, fy, fz)
    rate_z = (yaw_rate * zz * per_n + rate_y * zy) * per_n

    force_dot = fx * zx + fy * zy + fz * zz
    # z' in NED; (hx, hy, dz) is z' relative to the rotating heading frame, for n'.
    dx, dy, dz = (fx - force_dot * zx) * per_f, (fy - force_dot * zy) * per_f, (fz - force_dot * zz) * per_f
    gx, gy, gz = _to_heading(thrust_axis, (-snap[0], -snap[1], -snap[2]))
    # z'' = (f'' - 2 |f|' z') / |f| except for a component along z, which changes no rate.
    ddx, ddy, ddz = (
        (gx - 2.0 * force_dot * dx) * per_f,
        (gy - 2.0 * force_dot * dy) * per_f,
        (gz - 2.0 * force_dot * dz) * per_f,
    )
    along_x = (ddx * zz - ddz * zx) * per_n
    along_y = n * ddy - zy * (ddx * zx + ddz * zz) * per_n
    dot_x = rate_z * rate_y - along_y
    dot_y = along_x - rate_z * rate_x
    hx, hy = dx + yaw_rate * zy, dy - yaw_rate * zx
    n_dot = (zx * hx + zz * dz) * per_n
    dot_z = per_n * (
        (yaw_accel * zz + yaw_rate * (dz - 2.0 * zz * n_dot * per_n)) * per_n
        + dot_y * zy
        + rate_y * (hy - zy * n_dot * per_n)
    )

    jx, jy, jz = model.inertia
    rate, rate_dot = (rate_x, rate_y, rate_z), (dot_x, dot_y, dot_z)
    gyroscopic = cross(rate, (jx * rate_x, jy * rate_y, jz * rate_z))
    torque = (jx * dot_x + gyroscopic[0], jy * dot_y + gyroscopic[1], jz * dot_z + gyroscopic[2])
    return heading_matrix(thrust_axis), rate, rate_dot, model.mass_kg * force, torque


def _to_heading(thrust_axis: Heading, v: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return a NED vector in the heading frame."""
    return (
        thrust_axis.cos * v[0] + thrust_axis.sin * v[1],
        thrust_axis.cos * v[1] - thrust_axis.sin * v[0],
        v[2],
    )


def _tilt_rates(thrust_axis: Heading, fx: Scalar, fy: Scalar, fz: Scalar) -> tuple[Scalar, Scalar]:
    """Return roll and pitch rate from f' in the heading frame: z' = omega_y x - omega_x y."""
    zx, zy, zz = thrust_axis.z
    per = 1.0 / thrust_axis.n
    per_f = 1.0 / thrust_axis.force
    rate_y = (fx * zz - fz * zx) * per * per_f
    rate_x = (zy * (fx * zx + fz * zz) * per - thrust_axis.n * fy) * per_f
    return rate_x, rate_y
