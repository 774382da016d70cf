"""Rotor thrusts for a collective thrust and a torque, and motor commands for rotor thrusts.

[T, tau_x, tau_y, tau_z] = C [T1..T4], paper equation 1, with tau = r x (0, 0, -T) and the rotors' reaction
torque about +z_frd: +kappa T for a rotor that turns counter-clockwise seen from above, -kappa T for a
clockwise one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from firmware_model.law.ops import Ops, Scalar, Vector


def allocation_matrix(
    rotor_positions: Sequence[Sequence[float]], spins: Sequence[float], kappa: float
) -> tuple[float, ...]:
    """C, 16 floats row-major, of rotors at FRD positions (m; x, y and anything) with spins +1 ccw, -1 cw."""
    return (
        *(1.0 for _ in rotor_positions),
        *(-float(position[1]) for position in rotor_positions),
        *(float(position[0]) for position in rotor_positions),
        *(kappa * spin for spin in spins),
    )


def invert4(m16: Sequence[float]) -> tuple[float, ...]:
    """The inverse of a 4 x 4 matrix, row-major, by elimination with row pivots (floats only).

    Raises ValueError where the matrix is singular to working precision.
    """
    rows = [[*map(float, m16[4 * i : 4 * i + 4]), *(float(i == k) for k in range(4))] for i in range(4)]
    for row in rows:  # pivots are compared between rows of very different units
        scale = max(abs(value) for value in row[:4]) or 1.0
        row[:] = [value / scale for value in row]
    for i in range(4):
        pivot = max(range(i, 4), key=lambda k: abs(rows[k][i]))
        if not abs(rows[pivot][i]) > 1e-12:
            raise ValueError(
                "the rotors cannot produce thrust and all three torques: their matrix is singular"
            )
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(4):
            if k != i:
                factor = rows[k][i]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return tuple(value for row in rows for value in row[4:])


def allocate(
    ops: Ops, inverse16: Vector, collective_n: Scalar, torque3: Vector, t_min: Scalar, t_max: Scalar
) -> tuple[tuple[Scalar, ...], Scalar]:
    """Thrust of the four rotors (N, within t_min..t_max) and 1 where something was given up, else 0.

    A demand the rotors can meet is met exactly. Else, given up first: yaw torque, down to none; then
    collective thrust, shifted up or down as little as needed; last, roll and pitch torque, scaled together.
    Where rotors do not share thrust equally, roll and pitch are scaled somewhat before they must be.

    Args:
        inverse16: C^-1, row-major; its first column (how rotors share thrust) must be positive.
        collective_n, torque3: what is wanted; N and N m about x, y, z of FRD.
    """
    share = (inverse16[0], inverse16[4], inverse16[8], inverse16[12])
    turn = (inverse16[3], inverse16[7], inverse16[11], inverse16[15])
    per = [1.0 / part for part in share]
    tilt = [inverse16[4 * i + 1] * torque3[0] + inverse16[4 * i + 2] * torque3[1] for i in range(4)]
    yaw = [part * torque3[2] for part in turn]

    # In units of collective thrust: rotor i stands at its bound for collective = bound_i - yaw_scale yaw_i.
    need = [t * k for t, k in zip(tilt, per, strict=True)]
    low, high = [t_min * k for k in per], [t_max * k for k in per]
    spread = ops.maximum(_greatest(ops, need) - _least(ops, need), 1e-9)
    tilt_scale = ops.minimum((_least(ops, high) - _greatest(ops, low)) / spread, 1.0)
    low = [bound - tilt_scale * t for bound, t in zip(low, need, strict=True)]
    high = [bound - tilt_scale * t for bound, t in zip(high, need, strict=True)]
    turned = [y * k for y, k in zip(yaw, per, strict=True)]
    floor, ceiling = _collective_range(ops, low, high, turn, turned, per)
    collective = ops.minimum(ops.maximum(collective_n, floor), ceiling)
    thrust = [part * collective + tilt_scale * t for part, t in zip(share, tilt, strict=True)]

    yaw_scale = 1.0
    for t, y in zip(thrust, yaw, strict=True):
        room = ops.where(y > 0.0, t_max - t, t - t_min)
        yaw_scale = ops.minimum(yaw_scale, room / ops.maximum(ops.fabs(y), 1e-9))
    yaw_scale = ops.maximum(yaw_scale, 0.0)
    thrust = [ops.clip(t + yaw_scale * y, t_min, t_max) for t, y in zip(thrust, yaw, strict=True)]

    # Shifts of rounding's size are no saturation.
    lost = (1.0 - tilt_scale) + (1.0 - yaw_scale) + ops.fabs(collective - collective_n) / t_max
    return tuple(thrust), ops.where(lost > 1e-9, 1.0, 0.0)


def _collective_range(
    ops: Ops, low: Sequence[Scalar], high: Sequence[Scalar], turn: Vector, yaw: Sequence[Scalar], per: Vector
) -> tuple[Scalar, Scalar]:
    """Least and greatest collective thrust at which some part k of the yaw demand keeps rotors in range.

    low_i - k yaw_i <= collective <= high_i - k yaw_i are lines over k in 0..1. The lowest point above four
    lines is the end of one of them or where a falling one meets a rising one: rotors that turn opposite ways.
    """
    ends_low = [ops.minimum(bound, bound - y) for bound, y in zip(low, yaw, strict=True)]
    ends_high = [ops.maximum(bound, bound - y) for bound, y in zip(high, yaw, strict=True)]
    floor, ceiling = _greatest(ops, ends_low), _least(ops, ends_high)
    slope = [ops.fabs(part) * k for part, k in zip(turn, per, strict=True)]
    for i, j in combinations(range(4), 2):
        part = slope[j] / (slope[i] + slope[j])
        opposite = turn[i] * turn[j] < 0.0
        floor = ops.maximum(floor, ops.where(opposite, low[j] + part * (low[i] - low[j]), ends_low[i]))
        ceiling = ops.minimum(
            ceiling, ops.where(opposite, high[j] + part * (high[i] - high[j]), ends_high[i])
        )
    return floor, ceiling


def thrust_to_command(ops: Ops, thrust_n: Scalar, t_max: Scalar, c1: Scalar, c2: Scalar) -> Scalar:
    """Motor command u in 0..1 for which c1 u + c2 u^2 = thrust / t_max (full battery)."""
    share = ops.clip(thrust_n / t_max, 0.0, 1.0)
    root = ops.sqrt(c1 * c1 + 4.0 * c2 * share)
    # The quadratic's root without cancellation, for c2 = 0 and for c1 = 0 alike.
    return ops.minimum(2.0 * share / ops.maximum(c1 + root, 1e-9), 1.0)


def command_to_thrust(command: Scalar, t_max: Scalar, c1: Scalar, c2: Scalar) -> Scalar:
    """Rotor thrust in N of a motor command in 0..1 at full battery, once the motor has settled."""
    return t_max * command * (c1 + c2 * command)


def _greatest(ops: Ops, values: Sequence[Scalar]) -> Scalar:
    a, b, c, d = values
    return ops.maximum(ops.maximum(a, b), ops.maximum(c, d))


def _least(ops: Ops, values: Sequence[Scalar]) -> Scalar:
    a, b, c, d = values
    return ops.minimum(ops.minimum(a, b), ops.minimum(c, d))
