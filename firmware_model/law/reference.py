"""The reference between its nodes: septic pieces in position, cubic pieces in yaw.

A node holds p, v, a, j in NED, 12 scalars. Pieces that share nodes join with continuous p, v, a and j (C3).
The time inside a piece is expected within 0..dt; who calls picks the piece and holds yaw outside its nodes.
"""

from __future__ import annotations

from firmware_model.law.ops import Scalar, Vector

Triple = tuple[Scalar, Scalar, Scalar]


def septic(
    dt_s: Scalar, s_s: Scalar, node0: Vector, node1: Vector
) -> tuple[Triple, Triple, Triple, Triple, Triple]:
    """Position, velocity, acceleration, jerk, snap: `s_s` into the piece of length `dt_s` between two nodes.

    The polynomial of degree 7 in x = s/dt that meets p, v, a, j at both ends. Its first four coefficients are
    node0's own; the other four solve a constant 4 x 4 system for what is then missing at x = 1.
    """
    h = dt_s
    x = s_s / h
    h2, h3 = 0.5 * h * h, h * h * h * (1.0 / 6.0)
    per_v, per_a = 1.0 / h, 1.0 / h2
    per_j, per_snap = 1.0 / h3, 24.0 / (h * h * h * h)
    p, v, a, j, snap = [], [], [], [], []
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
        # Repeated synthetic division: k passes leave the k-th Taylor coefficient at x.
        b6 = c7 * x + c6
        b5 = b6 * x + c5
        b4 = b5 * x + c4
        b3 = b4 * x + c3
        b2 = b3 * x + c2
        b1 = b2 * x + c1
        p.append(b1 * x + c0)
        d6 = c7 * x + b6
        d5 = d6 * x + b5
        d4 = d5 * x + b4
        d3 = d4 * x + b3
        d2 = d3 * x + b2
        v.append((d2 * x + b1) * per_v)
        e6 = c7 * x + d6
        e5 = e6 * x + d5
        e4 = e5 * x + d4
        e3 = e4 * x + d3
        a.append((e3 * x + d2) * per_a)
        f6 = c7 * x + e6
        f5 = f6 * x + e5
        f4 = f5 * x + e4
        j.append((f4 * x + e3) * per_j)
        g6 = c7 * x + f6
        g5 = g6 * x + f5
        snap.append((g5 * x + f4) * per_snap)
    return (
        (p[0], p[1], p[2]),
        (v[0], v[1], v[2]),
        (a[0], a[1], a[2]),
        (j[0], j[1], j[2]),
        (snap[0], snap[1], snap[2]),
    )


def hermite_yaw(
    dt_s: Scalar, s_s: Scalar, y0: Scalar, r0: Scalar, y1: Scalar, r1: Scalar
) -> tuple[Scalar, Scalar]:
    """Yaw and yaw rate, `s_s` into the cubic piece of length `dt_s` between (y0, r0) and (y1, r1).

    Yaw is not wrapped: y1 - y0 is the turn made. A held yaw is y0 = y1, r0 = r1 = 0.
    """
    x = s_s / dt_s
    c1 = dt_s * r0
    turn = (y1 - y0) - c1
    bend = dt_s * r1 - c1
    c2 = 3.0 * turn - bend
    c3 = bend - 2.0 * turn
    yaw = y0 + x * (c1 + x * (c2 + x * c3))
    return yaw, (c1 + x * (2.0 * c2 + 3.0 * c3 * x)) / dt_s
