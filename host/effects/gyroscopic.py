"""Gyroscopic torque of the rotors: if rotors of one spin are faster, roll and pitch are coupled."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import INERTIA, TORQUE

_FLOOR_N = 1e-9  # keeps the derivative of the square root finite at zero thrust


def _torque(ops, theta, ctx):
    (h,) = theta
    excess_speed = sum(
        sign * ops.sqrt(ops.maximum(thrust, 0.0) + _FLOOR_N)
        for sign, thrust in zip(ctx.spin_signs, ctx.thrust, strict=True)
    )
    momentum = h * ctx.inertia_kg_m2[0] * excess_speed / (ctx.hover_n + _FLOOR_N) ** 0.5
    x, y, _ = ctx.rate_frd
    return (momentum * y, -momentum * x, 0.0)


EFFECT = Effect(
    name="gyroscopic",
    title="Gyroscopic torque of the rotors",
    family="torque",
    equation="tau_frd = h J_x sum_i s_i sqrt(T_i / T_hover) (omega x e3), s_i = +1 for ccw from above",
    source="angular momentum J_r Omega of a rotor; J_r 3e-8 (nano) to 1e-5 kg m^2 (5-inch propellers)",
    parameters=(
        Parameter(
            key="h",
            unit="1/s",
            neutral=0.0,
            typical=4.0,
            tolerance=0.2,
            lower=0.0,
            upper=40.0,
            description="angular momentum of one rotor at hover over the vehicle's moment of inertia about x",
        ),
    ),
    aliases=("inertia",),
    observable="rotations in roll and pitch during strong yaw acceleration; hardly observable otherwise",
    replaced_by=(INERTIA, TORQUE),
    closing=Closing(
        model="a torque perpendicular to the body rate, proportional to the excess rotor speed of one spin",
        planner="if the model has no drag, prefers lower body rates where the rotor speeds differ",
        law=None,
        no_law="the feed-forward has no torque; the rate loop rejects it",
    ),
    torque_frd=_torque,
)
