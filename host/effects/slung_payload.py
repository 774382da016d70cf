"""Slung payload: a mass on a line under the vehicle swings, and pulls it along."""

from __future__ import annotations

from firmware_model.law.constants import GRAVITY
from firmware_model.law.rotations import mat_t_vec
from host.effects.effect import Closing, Effect, Parameter

_DAMPING = 0.1
_STEEPEST = 0.3  # depth over length that a swing goes up to
_LIFT_M = 0.05  # height over which the floor gives it up
_FRICTION = 10.0  # 1/s, of a payload that lies


def _start(ops, theta, ctx):
    return (ctx.p_ned[0], ctx.p_ned[1], 0.0, 0.0)


def _line(ops, theta, ctx):
    """The line from vehicle to payload in NED (3,), how fast it turns (2,) in xy, and lambda, 1/s^2: the pull
    over the payload's mass and the line's length. The floor carries what hangs too low.
    """
    ratio, length = theta
    x, y = (s - p for s, p in zip(ctx.memory[:2], ctx.p_ned[:2], strict=True))
    vx, vy = (s - v for s, v in zip(ctx.memory[2:], ctx.v_ned[:2], strict=True))
    # A line is no longer than it is, and a swing no faster than a fall from its upper end.
    away = ops.sqrt(ops.maximum((x * x + y * y) / (length * length * (1.0 - _STEEPEST**2)), 1.0))
    x, y = x / away, y / away
    fast = ops.sqrt(ops.maximum((vx * vx + vy * vy) / (2.0 * GRAVITY * length), 1.0))
    vx, vy = vx / fast, vy / fast
    z = ops.sqrt(length * length - x * x - y * y)
    vz = -(x * vx + y * vy) / z
    lift = ctx.collective_n / ctx.mass_kg * (ctx.R[2] * x + ctx.R[5] * y + ctx.R[8] * z)
    pull = (lift + vx * vx + vy * vy + vz * vz) / (length * length * (1.0 + ratio))
    hangs = ops.clip((-ctx.p_ned[2] - z) / _LIFT_M, 0.0, 1.0)
    return (x, y, z), (vx, vy), hangs * ops.maximum(pull, 0.0), hangs


def _rates(ops, theta, ctx):
    line, turning, pull, hangs = _line(ops, theta, ctx)
    damping = _DAMPING * ops.sqrt(GRAVITY / theta[1])
    velocity = ctx.memory[2:]
    rates = [
        -pull * s - damping * hangs * v - _FRICTION * (1.0 - hangs) * own
        for s, v, own in zip(line, turning, velocity, strict=False)
    ]
    return (*velocity, *rates)


def _force(ops, theta, ctx):
    line, _, pull, _ = _line(ops, theta, ctx)
    return mat_t_vec(ctx.R, [theta[0] * pull * along for along in line])


def _feedforward(theta):
    return {"gain": 1.0 / (1.0 + theta[0])}


EFFECT = Effect(
    name="slung-payload",
    title="Slung payload",
    equation="s'' = -lambda d_xy - 0.1 sqrt(g/l) d_xy'; a_ned = ratio lambda d; d the line, |d| = l, "
    "lambda = (T/m z_body . d + |d'|^2) / (l^2 (1 + ratio)); none while the floor carries the payload",
    source="the pendulum on a vehicle that moves, the line's pull keeps |d| = l (Lagrange multiplier)",
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
        ),
    ),
    aliases=("mass", "thrust-gain"),
    observable="changes of horizontal speed within a period of the pendulum; in hover it is mass",
    closing=Closing(
        model="a pendulum under the vehicle, with its own place and speed as states",
        planner="counts the weight as a constant pull; the swing is left out",
        law="the commanded thrust is multiplied for the payload's weight; the swing stays",
    ),
    memory=4,
    starts=tuple((0.08, length) for length in (0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95)),
    specific_force_frd=_force,
    memory_start=_start,
    memory_rates=_rates,
    to_feedforward=_feedforward,
)
