"""Angular momentum of the rotors: it couples roll and pitch, and rotors that spin up turn the vehicle."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import INERTIA, TORQUE

_FLOOR_N = 1e-9  # keeps the derivative of the square root finite at zero thrust
_SLOWEST = 0.05  # thrust over that at hover below which a rotor does not spin up faster


def _torque(ops, theta, ctx):
    excess_speed = sum(
        sign * ops.sqrt(ops.maximum(thrust, 0.0) + _FLOOR_N)
        for sign, thrust in zip(ctx.spin_signs, ctx.thrust, strict=True)
    )
    momentum = theta[0] * ctx.inertia_kg_m2[0] * excess_speed / (ctx.hover_n + _FLOOR_N) ** 0.5
    x, y, _ = ctx.rate_frd
    return (momentum * y, -momentum * x, 0.0)


def _spin_up_torque(ops, theta, ctx, thrust_rates):
    h, spin_up = theta
    excess_acceleration = sum(
        sign * rate / ops.sqrt(ops.maximum(thrust, _SLOWEST * ctx.hover_n))
        for sign, thrust, rate in zip(ctx.spin_signs, ctx.thrust, thrust_rates, strict=True)
    )
    momentum_rate = h * ctx.inertia_kg_m2[0] * excess_acceleration / (2.0 * ctx.hover_n**0.5)
    return (0.0, 0.0, spin_up * momentum_rate)


EFFECT = Effect(
    name="gyroscopic",
    title="Gyroscopic torque of the rotors",
    family="torque",
    equation="tau_frd = omega x H + spin_up dH/dt, H = h J_x sum_i s_i sqrt(T_i / T_hover) e3, "
    "s_i = +1 for ccw from above",
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
        # A drag torque in the vehicle file that was identified in flight contains it already.
        form("spin_up", 1.0, 0.0, 1.0, "share of the torque against the acceleration of the rotors"),
    ),
    aliases=("inertia",),
    observable="rotations in roll and pitch during strong yaw acceleration, and yaw if rotors spin up",
    replaced_by=(INERTIA, TORQUE),
    closing=Closing(
        model="a torque perpendicular to the body rate, proportional to the excess rotor speed of one spin, "
        "and a yaw torque while this changes",
        planner="if the model has no drag, prefers lower body rates where the rotor speeds differ",
        law=None,
        no_law="the feed-forward has no torque; the rate loop rejects it",
    ),
    torque_frd=_torque,
    thrust_rate_torque_frd=_spin_up_torque,
)
