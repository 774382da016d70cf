"""Slung payload: a mass on a line under the vehicle swings, and pulls it along."""

from __future__ import annotations

from firmware_model.law.constants import GRAVITY
from firmware_model.law.rotations import mat_t_vec
from host.effects.effect import Closing, Effect, Parameter

_DAMPING = 0.1


def _start(ops, theta, ctx):
    return (ctx.p_ned[0], ctx.p_ned[1], 0.0, 0.0)


def _rates(ops, theta, ctx):
    _, length = theta
    stiffness = GRAVITY / length
    damping = _DAMPING * ops.sqrt(stiffness)
    *place, vx, vy = ctx.memory
    pull = [
        -stiffness * (s - p) - damping * (speed - v)
        for s, speed, p, v in zip(place, (vx, vy), ctx.p_ned[:2], ctx.v_ned[:2], strict=True)
    ]
    return (vx, vy, *pull)


def _force(ops, theta, ctx):
    ratio, length = theta
    scale = ratio * GRAVITY / length
    x, y = (scale * (s - p) for s, p in zip(ctx.memory[:2], ctx.p_ned[:2], strict=True))
    return mat_t_vec(ctx.R, (x, y, ratio * GRAVITY))


def _feedforward(theta):
    return {"gain": 1.0 / (1.0 + theta[0])}


EFFECT = Effect(
    name="slung-payload",
    title="Slung payload",
    equation="s'' = -(g/l) (s - p_xy) - 0.1 sqrt(g/l) (s' - v_xy); a_ned = ratio g ((s - p_xy)/l, 1)",
    source="the pendulum for small angles, on a vehicle that moves; 0.5-1 Hz",
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
    specific_force_frd=_force,
    memory_start=_start,
    memory_rates=_rates,
    to_feedforward=_feedforward,
)
