"""Thrust against axial speed: climbing, the blades meet the air at a smaller angle and give less thrust."""

from __future__ import annotations

from host.effects.effect import Closing, Effect, Parameter


def _force(ops, theta, ctx):
    (k,) = theta
    turning = sum(ops.sqrt(ops.maximum(thrust, 0.0) + _FLOOR_N) for thrust in ctx.thrust)
    relative = 0.25 * turning / (ctx.hover_n + _FLOOR_N) ** 0.5
    return (0.0, 0.0, -k * relative * ctx.v_air_frd[2])


def _feedforward(theta):
    return {"linear_drag": (0.0, 0.0, theta[0])}


_FLOOR_N = 1e-9  # keeps the derivative of the root finite where a rotor stands

EFFECT = Effect(
    name="thrust-inflow",
    title="Thrust against axial speed",
    equation="a_frd = (0, 0, -k v_air,z mean_i sqrt(T_i / T_hover))",
    source="blade element theory: thrust falls by k_z Omega v_z, about 0.44 N/(m/s) in all at 0.75 kg",
    parameters=(
        Parameter(
            key="k",
            unit="1/s",
            neutral=0.0,
            typical=0.5,
            tolerance=0.01,
            lower=-0.2,
            upper=3.0,
            description="thrust lost over mass a metre a second of axial air speed, at hover rotor speed",
        ),
    ),
    aliases=("linear-drag", "motor-lag"),
    observable="climbs and descents beyond 1 m/s; from drag along z only where thrust changes meanwhile",
    closing=Closing(
        model="a force against the axial air speed that grows with rotor speed",
        planner="plans a path of less of it: slower climbs and descents",
        law="what it is at hover's rotor speed is fed forward like a drag along body z",
    ),
    specific_force_frd=_force,
    to_feedforward=_feedforward,
)
