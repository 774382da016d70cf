"""Quadratic body drag: air resistance of the frame, proportional to the square of the air speed."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter

_SPEED_SQUARED_FLOOR = 1e-12  # (1e-6 m/s)^2, keeps the derivative of |v| finite at rest


def _force(ops, theta, ctx):
    (c,) = theta
    x, y, z = ctx.v_air_frd
    scale = -c * ops.sqrt(x * x + y * y + z * z + _SPEED_SQUARED_FLOOR)
    return (scale * x, scale * y, scale * z)


def _feedforward(theta):
    (c,) = theta
    return {"quadratic_drag": (c, c, c)}


EFFECT = Effect(
    name="quadratic-drag",
    title="Quadratic body drag",
    family="aerodynamic",
    equation="a_frd = -c |v_air| v_air_frd",
    source="1/2 rho CdA / m with CdA 5e-3..3.3e-2 m^2 measured on quadrotors (0.004-0.03 1/m at 0.75 kg)",
    parameters=(
        Parameter(
            key="c",
            unit="1/m",
            neutral=0.0,
            typical=0.03,
            tolerance=0.002,
            lower=-0.05,
            upper=0.5,
            description="half the air density times the drag area over mass, positive against the motion",
        ),
    ),
    aliases=("linear-drag", "wind", "translational-lift"),
    observable="level flight over a range of speeds, up to 4 m/s or more",
    closing=Closing(
        model="a drag force quadratic in the air speed",
        planner="prefers paths with less drag: slower where the speed is greatest",
        law="the predicted drag along the reference is fed forward",
    ),
    specific_force_frd=_force,
    to_feedforward=_feedforward,
)
