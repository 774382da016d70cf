"""Interpolation of a reference between its nodes: septic pieces in position, cubic pieces in yaw.

A node holds p, v, a, j in NED, 12 scalars. Adjacent pieces share a node, so p, v, a, j are continuous (C3).
The caller selects the piece and holds yaw outside its nodes. It computes the coefficients once for each piece
and evaluates them at the time inside the piece, which must be within 0..dt.
"""

from __future__ import annotations

from trimtab.firmware_model.law.ops import Scalar, Vector

Triple = tuple[Scalar, Scalar, Scalar]

SEPTIC_SIZE = 24
CUBIC_SIZE = 4


def septic_coefficients(dt_s: Scalar, node0: Vector, node1: Vector) -> tuple[Scalar, ...]:
    """Return the 24 coefficients of the piece of length `dt_s` between two nodes: x, y, z of power 0 first.

    The piece is the polynomial of degree 7 in x = s/dt that interpolates p, v, a, j at both ends. Its first
    four coefficients follow from node0 alone. The other four solve a constant 4 x 4 system: its right-hand
    side is the difference between node1 and the cubic of the first four coefficients at x = 1.
    """
    h = dt_s
    h2, h3 = 0.5 * h * h, h * h * h * (1.0 / 6.0)
    per = 1.0 / (h * h * h * h)
    rows = []
    for axis in range(3):
        c0, c1 = node0[axis], h * node0[3 + axis]
        c2, c3 = h2 * node0[6 + axis], h3 * node0[9 + axis]
        j_missing = h3 * node1[9 + axis] - c3
        a_missing = h2 * node1[6 + axis] - (c2 + 3.0 * c3)
        v_missing = h * node1[3 + axis] - (c1 + 2.0 * c2 + 3.0 * c3)
        p_missing = (node1[axis] - c0) - (c1 + c2 + c3)
        c4 = 35.0 * p_missing - 15.0 * v_missing + 5.0 * a_missing - j_missing
        c5 = -84.0 * p_missing + 39.0 * v_missing - 14.0 * a_missing + 3.0 * j_missing
        c6 = 70.0 * p_missing - 34.0 * v_missing + 13.0 * a_missing - 3.0 * j_missing
        c7 = -20.0 * p_missing + 10.0 * v_missing - 4.0 * a_missing + j_missing
        low = (c0, node0[3 + axis], 0.5 * node0[6 + axis], node0[9 + axis] * (1.0 / 6.0))
        rows.append((*low, c4 * per, c5 * (per / h), c6 * (per / (h * h)), c7 * (per / (h * h * h))))
    x, y, z = rows
    return tuple(row[power] for power in range(8) for row in (x, y, z))


def septic_at(coefficients: Vector, s_s: Scalar) -> tuple[Triple, Triple, Triple, Triple, Triple]:
    """Return position, velocity, acceleration, jerk and snap at time `s_s` inside a piece."""
    p, v, a, j, snap = [], [], [], [], []
    for axis in range(3):
        c0, c1, c2, c3, c4, c5, c6, c7 = (coefficients[3 * power + axis] for power in range(8))
        # Repeated synthetic division: k passes leave the k-th Taylor coefficient at s.
        b6 = c7 * s_s + c6
        b5 = b6 * s_s + c5
        b4 = b5 * s_s + c4
        b3 = b4 * s_s + c3
        b2 = b3 * s_s + c2
        b1 = b2 * s_s + c1
        p.append(b1 * s_s + c0)
        d6 = c7 * s_s + b6
        d5 = d6 * s_s + b5
        d4 = d5 * s_s + b4
        d3 = d4 * s_s + b3
        d2 = d3 * s_s + b2
        v.append(d2 * s_s + b1)
        e6 = c7 * s_s + d6
        e5 = e6 * s_s + d5
        e4 = e5 * s_s + d4
        e3 = e4 * s_s + d3
        a.append(2.0 * (e3 * s_s + d2))
        f6 = c7 * s_s + e6
        f5 = f6 * s_s + e5
        f4 = f5 * s_s + e4
        j.append(6.0 * (f4 * s_s + e3))
        g6 = c7 * s_s + f6
        g5 = g6 * s_s + f5
        snap.append(24.0 * (g5 * s_s + f4))
    return (
        (p[0], p[1], p[2]),
        (v[0], v[1], v[2]),
        (a[0], a[1], a[2]),
        (j[0], j[1], j[2]),
        (snap[0], snap[1], snap[2]),
    )


def septic(
    dt_s: Scalar, s_s: Scalar, node0: Vector, node1: Vector
) -> tuple[Triple, Triple, Triple, Triple, Triple]:
    """Return position to snap at time `s_s` inside the piece of length `dt_s` between two nodes."""
    return septic_at(septic_coefficients(dt_s, node0, node1), s_s)


def cubic_coefficients(
    dt_s: Scalar, y0: Scalar, r0: Scalar, y1: Scalar, r1: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Return the coefficients, power 0 first, of the cubic from yaw y0 and rate r0 to y1 and r1 in `dt_s`.

    Yaw is not wrapped: the vehicle turns by y1 - y0. A constant yaw has y0 = y1, r0 = r1 = 0.
    """
    mean_rate_change = (y1 - y0) / dt_s - r0
    rate_change = r1 - r0
    return (
        y0,
        r0,
        (3.0 * mean_rate_change - rate_change) / dt_s,
        (rate_change - 2.0 * mean_rate_change) / (dt_s * dt_s),
    )


def cubic_at(coefficients: Vector, s_s: Scalar) -> tuple[Scalar, Scalar]:
    """Return yaw and yaw rate at time `s_s` inside a piece."""
    c0, c1, c2, c3 = (coefficients[power] for power in range(4))
    b2 = c3 * s_s + c2
    b1 = b2 * s_s + c1
    return b1 * s_s + c0, (c3 * s_s + b2) * s_s + b1


def cubic_acceleration(coefficients: Vector, s_s: Scalar) -> Scalar:
    """Return the yaw acceleration at time `s_s` inside a piece."""
    return 2.0 * coefficients[2] + 6.0 * coefficients[3] * s_s


def hermite_yaw(
    dt_s: Scalar, s_s: Scalar, y0: Scalar, r0: Scalar, y1: Scalar, r1: Scalar
) -> tuple[Scalar, Scalar]:
    """Return yaw and yaw rate at time `s_s` inside the cubic of length `dt_s` from (y0, r0) to (y1, r1)."""
    return cubic_at(cubic_coefficients(dt_s, y0, r0, y1, r1), s_s)
