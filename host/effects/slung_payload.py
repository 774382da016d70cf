"""Slung payload: a mass on a line under the vehicle swings, and pulls it along."""

from __future__ import annotations

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.rotations import mat_t_vec
from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter

_AIR = 0.023  # 1/m, drag of a cube of 6 cm and 100 g
_TAUT = 20.0  # 1/s, at which the line's length comes back to what it is
_FLOOR = 20.0  # 1/s, at which the floor gives way
_FLOOR_M = 0.01  # depth from which on it does
_HARDEST = 5.0  # times gravity, that it pushes back
_FRICTION, _SLIP_M_S = 0.5, 0.2


def _start(ops, theta, ctx):
    return (*ctx.p_ned, *ctx.v_ned)  # hangs below, and moves along


def _line(ops, theta, ctx):
    """Return the line's direction from vehicle to payload, NED (3,), by how much the payload is too near
    (m), how fast it goes away along the line (m/s) and across it (3,), and the tension over the payload's
    mass, none where the line is slack.
    """
    ratio, length, _ = theta
    x, y, z = (s - p for s, p in zip(ctx.memory[:3], ctx.p_ned, strict=True))
    away = ops.sqrt(x * x + y * y + (z + length) * (z + length))
    line = (x / away, y / away, (z + length) / away)
    relative = [s - v for s, v in zip(ctx.memory[3:], ctx.v_ned, strict=True)]
    leaving = _dot(line, relative)
    turning = [r - leaving * n for r, n in zip(relative, line, strict=True)]
    lift = ctx.collective_n / ctx.mass_kg * _dot((ctx.R[2], ctx.R[5], ctx.R[8]), line)
    tension = ops.maximum(lift + _dot(turning, turning) / length, 0.0) / (1.0 + ratio)
    return line, length - away, leaving, turning, tension


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _rates(ops, theta, ctx):
    _, length, damping = theta
    line, near, leaving, turning, tension = _line(ops, theta, ctx)
    slowed = 2.0 * damping * ops.sqrt(GRAVITY / length)
    velocity, deep = ctx.memory[3:], ctx.memory[2] + length
    push = ops.clip(deep / _FLOOR_M, 0.0, 1.0) * (_FLOOR * _FLOOR * deep + 2.0 * _FLOOR * velocity[2])
    push = ops.clip(push, 0.0, _HARDEST * GRAVITY)
    sliding = ops.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1] + _SLIP_M_S * _SLIP_M_S)
    floor = (
        -_FRICTION * push * velocity[0] / sliding,
        -_FRICTION * push * velocity[1] / sliding,
        GRAVITY - push,
    )
    air = _AIR * ops.sqrt(_dot(velocity, velocity) + 1e-6)
    along = tension + _TAUT * leaving
    moves = [v + _TAUT * near * n for v, n in zip(velocity, line, strict=True)]
    rates = [
        f - along * n - slowed * t - air * v
        for f, n, t, v in zip(floor, line, turning, velocity, strict=True)
    ]
    return (*moves, *rates)


def _force(ops, theta, ctx):
    line, _, _, _, tension = _line(ops, theta, ctx)
    return mat_t_vec(ctx.R, [theta[0] * tension * n for n in line])


def _feedforward(theta):
    return {"gain": 1.0 / (1.0 + theta[0])}


EFFECT = Effect(
    name="slung-payload",
    title="Slung payload",
    equation="s'' = g - lambda n - 2 damping sqrt(g/l) w - 0.023 |s'| s', a_ned = ratio lambda n above a "
    "floor; n the line's direction, w the payload's velocity across it: "
    "lambda = max(0, T/m z_body . n + |w|^2 / l) / (1 + ratio)",
    source="the pendulum on a vehicle that moves, the line's pull keeps its length (Lagrange multiplier)",
    parameters=(
        Parameter(
            key="ratio",
            unit="1",
            neutral=0.0,
            typical=0.08,
            tolerance=0.003,
            lower=0.0,
            upper=0.5,
            description="mass of the payload over the vehicle file's mass",
            # A payload pulls against slow changes of speed as a hundredth of the attitude or thrust does.
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
            # The line of a payload too light to name may have any length.
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
            description="damping of the swing, over the critical one",
            strength=False,
        ),
    ),
    aliases=("mass", "thrust-gain"),
    observable="changes of horizontal speed within a period of the pendulum; in hover it is mass",
    closing=Closing(
        model="a pendulum under the vehicle, with its own place and velocity as states",
        planner="counts the weight as a constant pull; the swing is left out",
        law="the commanded thrust is multiplied for the payload's weight; the swing stays",
    ),
    memory=6,
    starts=tuple((0.08, 0.25 + 0.1 * step, 0.05) for step in range(8)),
    specific_force_frd=_force,
    memory_start=_start,
    memory_rates=_rates,
    to_feedforward=_feedforward,
)
