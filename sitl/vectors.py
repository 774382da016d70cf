"""Vectors, rotations and quaternions as lists of scalars of any arithmetic. World NED, body FRD."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Scalar = Any
Vector = Sequence[Scalar]


def rotation(q: Vector) -> list[Scalar]:
    """Return R_ned_frd, row-major, of a unit quaternion (Hamilton, w first)."""
    w, x, y, z = q
    xx, yy, zz = 2 * x * x, 2 * y * y, 2 * z * z
    xy, xz, yz = 2 * x * y, 2 * x * z, 2 * y * z
    wx, wy, wz = 2 * w * x, 2 * w * y, 2 * w * z
    return [1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy]


def quaternion_rate(q: Vector, w: Vector) -> list[Scalar]:
    """Return the derivative of a quaternion q_ned_frd under a body rate in FRD."""
    a, b, c, d = q
    x, y, z = w
    return [
        -0.5 * (b * x + c * y + d * z),
        0.5 * (a * x + c * z - d * y),
        0.5 * (a * y + d * x - b * z),
        0.5 * (a * z + b * y - c * x),
    ]


def unit(ops: Any, q: Vector) -> list[Scalar]:
    """Return a quaternion normalised to unit length."""
    scale = 1 / ops.sqrt(dot(q, q))
    return [scale * c for c in q]


def ahead(y: Vector, slope: Vector, h: float) -> list[Scalar]:
    """Return `y` after a time `h` at a constant slope."""
    return [a + h * b for a, b in zip(y, slope, strict=True)]


def into_world(R: Vector, u: Vector) -> list[Scalar]:
    """Return the NED components of a vector in FRD."""
    return [R[3 * i] * u[0] + R[3 * i + 1] * u[1] + R[3 * i + 2] * u[2] for i in range(3)]


def into_body(R: Vector, u: Vector) -> list[Scalar]:
    """Return the FRD components of a vector in NED."""
    return [R[i] * u[0] + R[3 + i] * u[1] + R[6 + i] * u[2] for i in range(3)]


def symmetric(m: Vector, u: Vector) -> list[Scalar]:
    """Return the product of a symmetric tensor, given as xx yy zz xy xz yz, and a vector."""
    xx, yy, zz, xy, xz, yz = m
    return [
        xx * u[0] + xy * u[1] + xz * u[2],
        xy * u[0] + yy * u[1] + yz * u[2],
        xz * u[0] + yz * u[1] + zz * u[2],
    ]


def cross(a: Vector, b: Vector) -> list[Scalar]:
    """Return the cross product of two 3-vectors."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a: Vector, b: Vector) -> Scalar:
    """Return the scalar product of two vectors."""
    total: Scalar = a[0] * b[0]
    for s, t in zip(a[1:], b[1:], strict=True):
        total = total + s * t
    return total


def add(a: Vector, b: Vector) -> list[Scalar]:
    """Return the sum of two vectors."""
    return [s + t for s, t in zip(a, b, strict=True)]
