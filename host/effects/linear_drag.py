"""Linear rotor drag: a force of the rotor blades against the air velocity, proportional to it."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter


def _force(ops, theta, ctx):
    return tuple(-d * v for d, v in zip(theta, ctx.v_air_frd, strict=True))


def _feedforward(theta):
    return {"linear_drag": tuple(theta)}


def _axis(key: str, typical: float) -> Parameter:
    return Parameter(
        key=key,
        unit="1/s",
        neutral=0.0,
        typical=typical,
        tolerance=0.01,
        lower=-0.2,
        upper=3.0,
        description=f"drag over mass along body {key[1]}, positive against the motion",
    )


EFFECT = Effect(
    name="linear-drag",
    title="Linear rotor drag",
    family="aerodynamic",
    equation="a_frd = -diag(dx, dy, dz) v_air_frd",
    source="Faessler, Franchi, Scaramuzza 2018 (dx 0.43-0.54, dy 0.24-0.39 1/s)",
    parameters=(_axis("dx", 0.4), _axis("dy", 0.35), _axis("dz", 0.2)),
    aliases=("quadratic-drag", "wind", "mocap-latency", "thrust-inflow", "translational-lift"),
    observable="above 1 m/s along each body axis; at several speeds, to distinguish it from quadratic drag",
    closing=Closing(
        model="a drag force linear in the air velocity along each body axis",
        planner="prefers paths with less drag: slower where drag costs most; keeps the heading of the route",
        law="the predicted drag along the reference is fed forward",
    ),
    specific_force_frd=_force,
    to_feedforward=_feedforward,
)
