"""Slung payload: a mass on a line under the vehicle swings and pulls on the vehicle."""

from __future__ import annotations

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.rotations import mat_t_vec
from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form

_AIR = 0.023  # 1/m, drag of a cube of 6 cm and 100 g
_LINE_RATE = 20.0  # 1/s, natural frequency of the critically damped stretch of the line
_FLOOR_RATE = 20.0  # 1/s, natural frequency of the critically damped floor
_FLOOR_M = 0.01  # depth at which the floor force is fully active
_FLOOR_FORCE_MAX = 5.0  # greatest floor force, times gravity
_FRICTION, _SLIP_M_S = 0.5, 0.2  # friction coefficient of the floor, speed that smooths its direction


def _start(ops, theta, ctx):
    # The states are the offset of the payload from where it hangs under a level vehicle, and its velocity
    # relative to the vehicle. Near the floor it lies below the vehicle.
    return (0.0, 0.0, -ops.maximum(ctx.p_ned[2] + theta[1], 0.0), 0.0, 0.0, 0.0)


def _motion(ops, theta, ctx):
    """Return the acceleration of the payload and the pull of the line, both NED (3,), m/s^2.

    The pull is over the payload's mass. It acts on the payload, and reversed on the vehicle.
    """
    ratio, length, damping, tension_share = theta
    x, y, z = ctx.memory[:3]
    distance = ops.sqrt(x * x + y * y + (z + length) * (z + length) + 1e-6)  # 0 before take-off
    line = (x / distance, y / distance, (z + length) / distance)
    relative = ctx.memory[3:]
    speed_along = _dot(line, relative)
    across = [r - speed_along * n for r, n in zip(relative, line, strict=True)]

    velocity = [v + r for v, r in zip(ctx.v_ned, relative, strict=True)]
    depth = ctx.p_ned[2] + z + length
    contact = ops.clip(depth / _FLOOR_M, 0.0, 1.0)
    normal = contact * (_FLOOR_RATE * _FLOOR_RATE * depth + 2.0 * _FLOOR_RATE * velocity[2])
    normal = ops.clip(normal, 0.0, _FLOOR_FORCE_MAX * GRAVITY)
    sliding = ops.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1] + _SLIP_M_S * _SLIP_M_S)
    grip = _FRICTION * normal / sliding
    air = _AIR * ops.sqrt(_dot(velocity, velocity) + 1e-6)
    others = [-(grip + air) * velocity[0], -(grip + air) * velocity[1], -normal - air * velocity[2]]

    lift = ctx.collective_n / ctx.mass_kg * _dot((ctx.R[2], ctx.R[5], ctx.R[8]), line)
    kept = 2.0 * _LINE_RATE * speed_along + _LINE_RATE * _LINE_RATE * (distance - length)
    tension = lift + _dot(across, across) / length + _dot(others, line) + kept
    tension = ops.maximum(tension, 0.0) / (1.0 + ratio)
    swing_damping = 2.0 * damping * ops.sqrt(GRAVITY / length)
    swing_damping = swing_damping * (1.0 + tension_share * (tension / GRAVITY - 1.0))
    pull = [tension * n + swing_damping * w for n, w in zip(line, across, strict=True)]
    return [f - a for f, a in zip((*others[:2], others[2] + GRAVITY), pull, strict=True)], pull


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _rates(ops, theta, ctx):
    acceleration, _ = _motion(ops, theta, ctx)
    return (*ctx.memory[3:], *(a - a_vehicle for a, a_vehicle in zip(acceleration, ctx.a_ned, strict=True)))


def _force(ops, theta, ctx):
    _, pull = _motion(ops, theta, ctx)
    return mat_t_vec(ctx.R, [theta[0] * a for a in pull])


def _feedforward(theta):
    return {"gain": 1.0 / (1.0 + theta[0])}


EFFECT = Effect(
    name="slung-payload",
    title="Slung payload",
    equation="s'' = g + f - u, a_ned = ratio u, "
    "u = lambda n + 2 damping sqrt(g/l) (1 + tension_share (lambda/g - 1)) w; "
    "n: direction of the line, w: velocity of the payload across it, "
    "f: floor and air (-0.023 |s'| s') on the payload, d = |s - p| - l: "
    "lambda = max(0, T/m z_body . n + |w|^2 / l + f . n + 40 d' + 400 d) / (1 + ratio)",
    source="pendulum on a moving vehicle; the tension keeps the length of the line (Lagrange multiplier, "
    "stabilised after Baumgarte 1972); a slack line pulls nothing, and a payload on the floor is not carried",
    parameters=(
        Parameter(
            key="ratio",
            unit="1",
            neutral=0.0,
            typical=0.08,
            tolerance=0.003,
            lower=0.0,
            upper=0.5,
            description="mass of the payload over the mass in the vehicle file",
            # In slow changes of speed, an attitude or thrust error of 1 % acts like a payload.
            discrepancy=0.15,
        ),
        Parameter(
            key="length_m",
            unit="m",
            neutral=0.6,
            typical=0.3,
            tolerance=0.05,
            lower=0.15,
            upper=2.0,
            description="length of the line",
            strength=False,
            # The length is not determined if the payload is too light to be named.
            discrepancy=1.0,
        ),
        Parameter(
            key="damping",
            unit="1",
            neutral=0.05,
            typical=0.05,
            tolerance=0.02,
            lower=0.0,
            upper=0.5,
            description="damping of the swing over critical damping",
            strength=False,
        ),
        # Friction at the attachment grows with the tension; the drag of the line in the air does not.
        form("tension_share", 0.5, 0.0, 1.0, "share of the damping that grows with the tension", neutral=0.5),
    ),
    aliases=("mass", "thrust-gain"),
    observable="changes of horizontal speed within a period of the pendulum; in hover it looks like mass",
    changes_hover=True,
    closing=Closing(
        model="a pendulum under the vehicle, with offset and relative velocity of the payload as states",
        planner="treats the weight as a constant force; the swing is ignored",
        law="the commanded thrust is scaled for the weight of the payload; the swing remains",
    ),
    memory=6,
    starts=tuple((0.08, 0.25 + 0.1 * step, 0.05) for step in range(8)),
    specific_force_frd=_force,
    memory_start=_start,
    memory_rates=_rates,
    to_feedforward=_feedforward,
)
