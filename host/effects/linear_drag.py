"""Linear rotor drag: a force of the rotor blades against the air velocity, proportional to it."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form


def _force(ops, theta, ctx):
    dx, dy, dz, rotor_share, _ = theta
    grown = 1.0 + rotor_share * ctx.excess_speed(ops)
    x, y, z = ctx.v_air_frd
    return (-dx * grown * x, -dy * grown * y, -dz * z)


def _torque(ops, theta, ctx):
    x, y, _ = _force(ops, theta, ctx)
    lever = theta[4] * ctx.mass_kg
    return (lever * y, -lever * x, 0.0)


def _feedforward(theta):
    return {"linear_drag": tuple(theta[:3])}


def _axis(key: str, typical: float) -> Parameter:
    return Parameter(
        key=key,
        unit="1/s",
        neutral=0.0,
        typical=typical,
        tolerance=0.01,
        lower=0.0,
        upper=3.0,
        description=f"drag over mass along body {key[1]}, positive against the motion",
    )


EFFECT = Effect(
    name="linear-drag",
    title="Linear rotor drag",
    family="aerodynamic",
    equation="a_frd = -diag(dx s, dy s, dz) v_air_frd, s = 1 + rotor_share (sqrt(T / T_hover) - 1); it acts "
    "height_m above the centre of mass",
    source="Faessler, Franchi, Scaramuzza 2018 (dx 0.43-0.54, dy 0.24-0.39 1/s)",
    parameters=(
        _axis("dx", 0.4),
        _axis("dy", 0.35),
        _axis("dz", 0.2),
        # The in-plane force of a blade is proportional to its speed, that of the frame is not.
        form("rotor_share", 0.5, 0.0, 1.0, "share of the drag across the rotors that grows with rotor speed"),
        form(
            "height_m",
            0.01,
            -0.03,
            0.03,
            "height of the drag's line of action over the centre of mass",
            unit="m",
        ),
    ),
    aliases=("quadratic-drag", "wind", "mocap-latency", "thrust-inflow", "translational-lift"),
    observable="above 1 m/s along each body axis; at several speeds, to distinguish it from quadratic drag",
    closing=Closing(
        model="a drag force linear in the air velocity along each body axis",
        planner="prefers paths with less drag: slower where drag costs most; keeps the heading of the route",
        law="the predicted drag along the reference is fed forward",
    ),
    specific_force_frd=_force,
    torque_frd=_torque,
    form_torque=True,
    to_feedforward=_feedforward,
)
