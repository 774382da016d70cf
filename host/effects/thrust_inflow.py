"""Thrust against axial speed: in a climb the angle of attack of the blades, and so the thrust, decreases."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import THRUST


def _losses(ops, theta, ctx):
    """Return the thrust loss of each rotor per m/s of axial air speed, over the mass of the vehicle, 1/s."""
    scale = 0.25 * theta[0] / (ctx.hover_n + _FLOOR_N) ** 0.5
    return [scale * ops.sqrt(ops.maximum(thrust, 0.0) + _FLOOR_N) for thrust in ctx.thrust]


def _force(ops, theta, ctx):
    axial = ctx.v_air_frd[2]
    falls = 1.0 - theta[1] * (1.0 - 1.0 / ops.sqrt(1.0 + axial * axial / _INDUCED_M_S**2))
    return (0.0, 0.0, -sum(_losses(ops, theta, ctx)) * falls * axial)


def _torque(ops, theta, ctx):
    p, q, _ = ctx.rate_frd
    x_torque = y_torque = 0.0
    for loss, (x, y, _) in zip(_losses(ops, theta, ctx), ctx.rotor_positions, strict=True):
        force = -loss * (1.0 + theta[2]) * ctx.mass_kg * (p * y - q * x)
        x_torque, y_torque = x_torque + y * force, y_torque - x * force
    return (x_torque, y_torque, 0.0)


def _feedforward(theta):
    return {"linear_drag": (0.0, 0.0, theta[0])}


_INDUCED_M_S = 5.0  # typical induced velocity at hover
_FLOOR_N = 1e-9  # keeps the derivative of the square root finite at zero thrust

EFFECT = Effect(
    name="thrust-inflow",
    title="Thrust against axial speed",
    family="aerodynamic",
    equation="F_i = -(k m / 4) sqrt(T_i / T_hover) (u + (1 + damping) omega x r_i)_z along z_frd, "
    "u = v_air (1 - saturation (1 - 1 / sqrt(1 + (v_air,z / 5 m/s)^2)))",
    source="blade element theory: thrust falls by k_z Omega v_z, about 0.44 N/(m/s) in total at 0.75 kg",
    parameters=(
        Parameter(
            key="k",
            unit="1/s",
            neutral=0.0,
            typical=0.5,
            tolerance=0.01,
            lower=0.0,
            upper=3.0,
            description="thrust loss over mass per m/s of axial air speed, at hover rotor speed",
        ),
        # Momentum theory: the loss saturates as the axial speed approaches the induced velocity.
        form("saturation", 0.5, 0.0, 1.0, "share of the loss that saturates at an axial speed of 5 m/s"),
        # The induced velocity takes some revolutions to follow a fast rotation.
        form(
            "damping", 0.1, -0.5, 0.5, "excess of the torque that damps rotations over that of the equation"
        ),
    ),
    aliases=("linear-drag", "motor-lag", "actuation-delay"),
    observable="climbs and descents above 1 m/s; changing thrust, to distinguish it from drag along z",
    replaced_by=(THRUST,),
    closing=Closing(
        model="a force of each rotor against its axial air speed, which grows with rotor speed",
        planner="prefers slower climbs and descents",
        law="its value at hover rotor speed is fed forward as a drag along body z",
    ),
    specific_force_frd=_force,
    torque_frd=_torque,
    to_feedforward=_feedforward,
)
