"""Control allocation: rotor thrusts for collective thrust and torque, and motor commands for thrusts.

[T, tau_x, tau_y, tau_z] = C [T1..T4], paper equation 1, with tau = r x (0, 0, -T) and the rotors' reaction
torque about +z_frd: +kappa T for a rotor that turns counter-clockwise as seen from above, -kappa T for a
clockwise one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from trimtab.firmware_model.law.ops import Ops, Scalar, Vector

TABLE_SIZE = 32
"""Size of an `allocation_table`."""


def allocation_matrix(
    rotor_positions: Sequence[Sequence[float]], spins: Sequence[float], kappa: float
) -> tuple[float, ...]:
    """Return C (16 floats, row-major).

    rotor_positions: x and y in FRD (m); further components are ignored. spins: +1 counter-clockwise, -1
    clockwise. kappa: reaction torque over thrust (m).
    """
    return (
        *(1.0 for _ in rotor_positions),
        *(-float(position[1]) for position in rotor_positions),
        *(float(position[0]) for position in rotor_positions),
        *(kappa * spin for spin in spins),
    )


def invert4(m16: Sequence[float]) -> tuple[float, ...]:
    """Return the inverse of a 4 x 4 matrix, row-major, by Gaussian elimination with row pivots (floats only).

    Raises ValueError if the matrix is singular to working precision.
    """
    rows = [[*map(float, m16[4 * i : 4 * i + 4]), *(float(i == k) for k in range(4))] for i in range(4)]
    for row in rows:  # makes pivots of rows with different units comparable
        scale = max(abs(value) for value in row[:4]) or 1.0
        row[:] = [value / scale for value in row]
    for i in range(4):
        pivot = max(range(i, 4), key=lambda k: abs(rows[k][i]))
        if not abs(rows[pivot][i]) > 1e-12:
            raise ValueError("singular: the rotors cannot produce thrust and all three torques")
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(4):
            if k != i:
                factor = rows[k][i]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return tuple(value for row in rows for value in row[4:])


def allocation_table(inverse16: Sequence[float]) -> tuple[float, ...]:
    """Return the constants of `allocate` for C^-1 (16 floats, row-major).

    The table starts with five groups of four values, one for each rotor: its share of the collective thrust;
    the inverse of that share; its roll, pitch and yaw coefficients over its share. Two weights for each pair
    of rotors follow, see `_lowest_above`. A share of 0 is replaced by 1e-6: such a vehicle cannot fly, but
    its numbers stay finite.
    """
    share = [max(inverse16[4 * i], 1e-6) for i in range(4)]
    per = [1.0 / part for part in share]
    roll, pitch, yaw = ([per[i] * inverse16[4 * i + k] for i in range(4)] for k in (1, 2, 3))
    weights: list[float] = []
    for a, b in combinations(yaw, 2):
        weights += (b / (b - a), a / (a - b)) if a * b < 0.0 else (0.0, 0.0)
    return (*share, *per, *roll, *pitch, *yaw, *weights)


def allocate(
    ops: Ops, table: Vector, collective_n: Scalar, torque3: Vector, t_min: Scalar, t_max: Scalar
) -> tuple[tuple[Scalar, ...], Scalar]:
    """Return the thrust of the four rotors (N, within t_min..t_max) and 1 if they saturate, else 0.

    A feasible demand is met exactly. Otherwise the demand is reduced in this order: yaw torque is scaled,
    down to 0; collective thrust is shifted as little as necessary; roll and pitch torque are scaled together.
    If the rotors do not share thrust equally, roll and pitch are scaled slightly earlier than necessary.

    Parameters
    ----------
    table
        `allocation_table` of the rotors.
    collective_n, torque3
        Demanded collective thrust (N), and demanded torque about x, y, z of FRD (N m).
    t_min, t_max
        Bounds of a rotor's thrust (N), not negative.
    """
    share, per, roll, pitch, yaw = (table[4 * k : 4 * k + 4] for k in range(5))

    # In units of collective thrust, a rotor's thrust over its share: rotor i is within low_i..high_i.
    low, high = [t_min * k for k in per], [t_max * k for k in per]
    tilt = [r * torque3[0] + p * torque3[1] for r, p in zip(roll, pitch, strict=True)]
    turn = [y * torque3[2] for y in yaw]
    spread = ops.maximum(_greatest(ops, tilt) - _least(ops, tilt), 1e-9)
    tilt_scale = ops.minimum((_least(ops, high) - _greatest(ops, low)) / spread, 1.0)
    tilt = [tilt_scale * t for t in tilt]

    # low_i <= collective + tilt_i + k turn_i <= high_i for some fraction k of the yaw demand. The mean of
    # low, weighted by shares, is 4 t_min, that of high 4 t_max: no floor is below 0, no ceiling above `top`.
    top = 4.0 * t_max
    weights = table[20:]
    floor = _lowest_above(ops, [a - t for a, t in zip(low, tilt, strict=True)], turn, weights)
    room = _lowest_above(
        ops, [top - b + t for b, t in zip(high, tilt, strict=True)], [-y for y in turn], weights
    )
    collective = ops.minimum(ops.maximum(collective_n, floor), top - room)

    level = [collective + t for t in tilt]
    yaw_scale = 1.0
    for a, x, b, y in zip(low, level, high, turn, strict=True):
        margin = ops.where(y > 0.0, b - x, x - a)
        yaw_scale = ops.minimum(yaw_scale, margin / ops.maximum(ops.fabs(y), 1e-9))
    yaw_scale = ops.maximum(yaw_scale, 0.0)
    thrust = [
        ops.clip(part * (x + yaw_scale * y), t_min, t_max)
        for part, x, y in zip(share, level, turn, strict=True)
    ]

    # Below 1e-9 a reduction is rounding, not saturation.
    reduction = (1.0 - tilt_scale) + (1.0 - yaw_scale) + ops.fabs(collective - collective_n) / t_max
    return tuple(thrust), ops.where(reduction > 1e-9, 1.0, 0.0)


def _lowest_above(ops: Ops, lines: Vector, fall: Vector, weights: Vector) -> Scalar:
    """Return the minimum over k in 0..1 of the maximum of the four lines `lines_i - k fall_i`.

    The result must not be negative. The minimum is at the end of a line, or where a falling line crosses a
    rising one: the lines of two rotors with opposite spins. The weighted mean of these two lines is constant,
    so it equals their value at the crossing. Pairs with equal spins have weights 0 and no effect.
    """
    lowest = _greatest(ops, [ops.minimum(line, line - f) for line, f in zip(lines, fall, strict=True)])
    for pair, (i, j) in enumerate(combinations(range(4), 2)):
        lowest = ops.maximum(lowest, weights[2 * pair] * lines[i] + weights[2 * pair + 1] * lines[j])
    return lowest


def thrust_to_command(ops: Ops, thrust_n: Scalar, t_max: Scalar, c1: Scalar, c2: Scalar) -> Scalar:
    """Return the motor command u in 0..1 with c1 u + c2 u^2 = thrust / t_max (full battery)."""
    share = ops.clip(thrust_n / t_max, 0.0, 1.0)
    root = ops.sqrt(c1 * c1 + 4.0 * c2 * share)
    # Root of the quadratic without cancellation; also valid for c1 = 0 and for c2 = 0.
    return ops.minimum(2.0 * share / ops.maximum(c1 + root, 1e-9), 1.0)


def command_to_thrust(command: Scalar, t_max: Scalar, c1: Scalar, c2: Scalar) -> Scalar:
    """Return the steady-state rotor thrust (N) of a motor command in 0..1 at full battery."""
    return t_max * command * (c1 + c2 * command)


def _greatest(ops: Ops, values: Sequence[Scalar]) -> Scalar:
    a, b, c, d = values
    return ops.maximum(ops.maximum(a, b), ops.maximum(c, d))


def _least(ops: Ops, values: Sequence[Scalar]) -> Scalar:
    a, b, c, d = values
    return ops.minimum(ops.minimum(a, b), ops.minimum(c, d))
