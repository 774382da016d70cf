"""Quadratic body drag: air resistance of the frame, proportional to the square of the air speed."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form

_SPEED_SQUARED_FLOOR = 1e-12  # (1e-6 m/s)^2, keeps the derivative of |v| finite at rest


def _force(ops, theta, ctx):
    c, side, top = theta
    x, y, z = ctx.v_air_frd
    scale = -c * ops.sqrt(x * x + y * y + z * z + _SPEED_SQUARED_FLOOR)
    return (scale * (1.0 - side) * x, scale * (1.0 + side) * y, scale * (1.0 + top) * z)


def _feedforward(theta):
    c, side, top = theta
    return {"quadratic_drag": (c * (1.0 - side), c * (1.0 + side), c * (1.0 + top))}


EFFECT = Effect(
    name="quadratic-drag",
    title="Quadratic body drag",
    family="aerodynamic",
    equation="a_frd = -c |v_air| diag(1 - side, 1 + side, 1 + top) v_air_frd",
    source="1/2 rho CdA / m with CdA 5e-3..3.3e-2 m^2 measured on quadrotors (0.004-0.03 1/m at 0.75 kg)",
    parameters=(
        Parameter(
            key="c",
            unit="1/m",
            neutral=0.0,
            typical=0.03,
            tolerance=0.002,
            lower=0.0,
            upper=0.5,
            description="half the air density times the drag area over mass, positive against the motion",
        ),
        # A frame has another area from each side; seen from above it is up to a few times larger.
        form("side", 0.15, -0.5, 0.5, "half the excess of the drag area from the side over that from ahead"),
        form("top", 0.5, -0.5, 3.0, "excess of the drag area from above over the mean of ahead and side"),
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
