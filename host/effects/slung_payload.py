"""Slung payload: a mass on a line under the vehicle swings and pulls on the vehicle."""

from __future__ import annotations

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.rotations import mat_t_vec
from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter

_AIR = 0.023  # 1/m, drag of a cube of 6 cm and 100 g
_LINE_RATE = 20.0  # 1/s, at which errors of the line's length decay
_FLOOR_RATE = 20.0  # 1/s, natural frequency of the critically damped floor
_FLOOR_M = 0.01  # depth at which the floor force is fully active
_FLOOR_FORCE_MAX = 5.0  # greatest floor force, times gravity
_FRICTION, _SLIP_M_S = 0.5, 0.2  # friction coefficient of the floor, speed that smooths its direction


def _start(ops, theta, ctx):
    # The payload hangs below the vehicle and moves with it. The position state is the position of the payload
    # raised by the length of the line.
    return (*ctx.p_ned, *ctx.v_ned)


def _line(ops, theta, ctx):
    """Return the geometry and the tension of the line.

    Returns the direction from vehicle to payload, NED (3,); the length minus the distance, m; the velocity of
    the payload relative to the vehicle, along the line, m/s, and across it (3,), m/s; and the tension over
    the payload's mass, m/s^2, which is 0 if the line is slack.
    """
    ratio, length, _ = theta
    x, y, z = (s - p for s, p in zip(ctx.memory[:3], ctx.p_ned, strict=True))
    distance = ops.sqrt(x * x + y * y + (z + length) * (z + length))
    line = (x / distance, y / distance, (z + length) / distance)
    relative = [s - v for s, v in zip(ctx.memory[3:], ctx.v_ned, strict=True)]
    speed_along = _dot(line, relative)
    across = [r - speed_along * n for r, n in zip(relative, line, strict=True)]
    lift = ctx.collective_n / ctx.mass_kg * _dot((ctx.R[2], ctx.R[5], ctx.R[8]), line)
    tension = ops.maximum(lift + _dot(across, across) / length, 0.0) / (1.0 + ratio)
    return line, length - distance, speed_along, across, tension


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _rates(ops, theta, ctx):
    _, length, damping = theta
    line, shortening, speed_along, across, tension = _line(ops, theta, ctx)
    swing_damping = 2.0 * damping * ops.sqrt(GRAVITY / length)
    velocity, depth = ctx.memory[3:], ctx.memory[2] + length
    contact = ops.clip(depth / _FLOOR_M, 0.0, 1.0)
    normal = contact * (_FLOOR_RATE * _FLOOR_RATE * depth + 2.0 * _FLOOR_RATE * velocity[2])
    normal = ops.clip(normal, 0.0, _FLOOR_FORCE_MAX * GRAVITY)
    sliding = ops.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1] + _SLIP_M_S * _SLIP_M_S)
    floor = (
        -_FRICTION * normal * velocity[0] / sliding,
        -_FRICTION * normal * velocity[1] / sliding,
        GRAVITY - normal,
    )
    air = _AIR * ops.sqrt(_dot(velocity, velocity) + 1e-6)
    pull = tension + _LINE_RATE * speed_along
    position_rates = [v + _LINE_RATE * shortening * n for v, n in zip(velocity, line, strict=True)]
    velocity_rates = [
        f - pull * n - swing_damping * t - air * v
        for f, n, t, v in zip(floor, line, across, velocity, strict=True)
    ]
    return (*position_rates, *velocity_rates)


def _force(ops, theta, ctx):
    line, _, _, _, tension = _line(ops, theta, ctx)
    return mat_t_vec(ctx.R, [theta[0] * tension * n for n in line])


def _feedforward(theta):
    return {"gain": 1.0 / (1.0 + theta[0])}


EFFECT = Effect(
    name="slung-payload",
    title="Slung payload",
    equation="s'' = g - lambda n - 2 damping sqrt(g/l) w - 0.023 |s'| s', a_ned = ratio lambda n above a "
    "floor; n: direction of the line, w: velocity of the payload across it: "
    "lambda = max(0, T/m z_body . n + |w|^2 / l) / (1 + ratio)",
    source="pendulum on a moving vehicle; the tension keeps the length of the line (Lagrange multiplier)",
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
    ),
    aliases=("mass", "thrust-gain"),
    observable="changes of horizontal speed within a period of the pendulum; in hover it looks like mass",
    changes_hover=True,
    closing=Closing(
        model="a pendulum under the vehicle, with position and velocity of the payload as states",
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
