"""Rotations: quaternions (Hamilton, w first, q_ned_frd), matrices (9, row-major, R_ned_frd), Euler angles.

v_ned = R_ned_frd v_frd. Euler angles Theta are (roll, pitch, yaw). No branch depends on a value, so the same
source serves floats, CasADi symbols and numpy arrays.
"""

from __future__ import annotations

from trimtab.firmware_model.law.ops import Ops, Scalar, Vector


def quat_to_matrix(ops: Ops, q: Vector) -> tuple[Scalar, ...]:
    """Return R_ned_frd of a unit quaternion q_ned_frd, 9 scalars, row-major."""
    w, x, y, z = q
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    return (
        1.0 - (yy + zz), xy - wz, xz + wy,
        xy + wz, 1.0 - (xx + zz), yz - wx,
        xz - wy, yz + wx, 1.0 - (xx + yy),
    )  # fmt: skip


def quat_multiply(q: Vector, r: Vector) -> tuple[Scalar, ...]:
    """Return the Hamilton product q r: q_a_c = q_a_b q_b_c."""
    qw, qx, qy, qz = q
    rw, rx, ry, rz = r
    return (
        qw * rw - qx * rx - qy * ry - qz * rz,
        qw * rx + qx * rw + qy * rz - qz * ry,
        qw * ry - qx * rz + qy * rw + qz * rx,
        qw * rz + qx * ry - qy * rx + qz * rw,
    )


def quat_conjugate(q: Vector) -> tuple[Scalar, ...]:
    """Return the inverse rotation of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def quat_normalize(ops: Ops, q: Vector) -> tuple[Scalar, ...]:
    """Return `q` normalized to unit length; finite even for the zero quaternion."""
    w, x, y, z = q
    scale = 1.0 / ops.sqrt(ops.maximum(w * w + x * x + y * y + z * z, 1e-30))
    return (w * scale, x * scale, y * scale, z * scale)


def quat_exp(ops: Ops, rotvec: Vector) -> tuple[Scalar, ...]:
    """Return the unit quaternion of a rotation vector (axis times angle, rad)."""
    x, y, z = rotvec
    # The constant keeps the quotient and its derivatives finite at 0; elsewhere rounding absorbs it.
    angle = ops.sqrt(x * x + y * y + z * z + 1e-20)
    scale = ops.sin(0.5 * angle) / angle
    return (ops.cos(0.5 * angle), x * scale, y * scale, z * scale)


def quat_from_euler(ops: Ops, roll: Scalar, pitch: Scalar, yaw: Scalar) -> tuple[Scalar, ...]:
    """Return q_ned_frd of ZYX Euler angles."""
    cr, sr = ops.cos(0.5 * roll), ops.sin(0.5 * roll)
    cp, sp = ops.cos(0.5 * pitch), ops.sin(0.5 * pitch)
    cy, sy = ops.cos(0.5 * yaw), ops.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def matrix_to_euler(ops: Ops, R: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return roll, pitch and yaw of R_ned_frd; pitch is within +-pi/2."""
    pitch = ops.asin(ops.clip(-R[6], -1.0, 1.0))
    return (ops.atan2(R[7], R[8]), pitch, ops.atan2(R[3], R[0]))


def euler_to_matrix(ops: Ops, rpy: Vector) -> tuple[Scalar, ...]:
    """Return R_ned_frd of (roll, pitch, yaw), 9 scalars, row-major."""
    roll, pitch, yaw = rpy
    cr, sr = ops.cos(roll), ops.sin(roll)
    cp, sp = ops.cos(pitch), ops.sin(pitch)
    cy, sy = ops.cos(yaw), ops.sin(yaw)
    sp_cy, sp_sy = sp * cy, sp * sy
    return (
        cp * cy, sr * sp_cy - cr * sy, cr * sp_cy + sr * sy,
        cp * sy, sr * sp_sy + cr * cy, cr * sp_sy - sr * cy,
        -sp, sr * cp, cr * cp,
    )  # fmt: skip


def euler_rates(ops: Ops, rpy: Vector, rate: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return d/dt (roll, pitch, yaw) for a body rate in FRD: W(Theta) omega of paper equation 1."""
    roll, pitch, _ = rpy
    p, q, r = rate
    cr, sr = ops.cos(roll), ops.sin(roll)
    cp = ops.cos(pitch)
    yaw_rate = (sr * q + cr * r) / cp
    return (p + ops.sin(pitch) * yaw_rate, cr * q - sr * r, yaw_rate)


def mat_vec(R: Vector, v: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return R v."""
    x, y, z = v
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )


def mat_t_vec(R: Vector, v: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return R^T v. For R_ned_frd this maps NED to FRD."""
    x, y, z = v
    return (
        R[0] * x + R[3] * y + R[6] * z,
        R[1] * x + R[4] * y + R[7] * z,
        R[2] * x + R[5] * y + R[8] * z,
    )


def cross(a: Vector, b: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Vector, b: Vector) -> Scalar:
    """Return the scalar product a . b of two vectors of 3 scalars."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def attitude_error(R_des: Vector, R: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return e_R = 1/2 vee(R_des^T R - R^T R_des) in FRD.

    e_R is sin(angle) times the axis of the rotation from R_des to R.
    """
    a, b = R_des, R
    return (
        0.5 * ((a[2] * b[1] + a[5] * b[4] + a[8] * b[7]) - (a[1] * b[2] + a[4] * b[5] + a[7] * b[8])),
        0.5 * ((a[0] * b[2] + a[3] * b[5] + a[6] * b[8]) - (a[2] * b[0] + a[5] * b[3] + a[8] * b[6])),
        0.5 * ((a[1] * b[0] + a[4] * b[3] + a[7] * b[6]) - (a[0] * b[1] + a[3] * b[4] + a[6] * b[7])),
    )
