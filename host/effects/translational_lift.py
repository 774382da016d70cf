"""Translational lift: in horizontal flight the rotors meet undisturbed air and give more thrust."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import THRUST


def _force(ops, theta, ctx):
    k, rotor_share, saturation = theta
    x, y, _ = ctx.v_air_frd
    across = x * x + y * y
    grown = 1.0 + rotor_share * ctx.excess_speed(ops)
    return (0.0, 0.0, -k * grown * across / (1.0 + saturation * across / _SATURATES_M_S**2))


_SATURATES_M_S = 10.0  # twice a typical induced velocity at hover


EFFECT = Effect(
    name="translational-lift",
    title="Translational lift",
    family="aerodynamic",
    equation="a_frd = (0, 0, -k s u^2 / (1 + saturation (u / 10 m/s)^2)), u^2 = v_air,x^2 + v_air,y^2, "
    "s = 1 + rotor_share (sqrt(T / T_hover) - 1)",
    source="Faessler, Franchi, Scaramuzza 2018 (0.009 1/m); 3.4e-3 N/(m/s)^2 per rotor at 0.75 kg",
    parameters=(
        Parameter(
            key="k",
            unit="1/m",
            neutral=0.0,
            typical=0.015,
            tolerance=0.001,
            lower=0.0,
            upper=0.2,
            description="lift over mass per square of the air speed across the rotors, positive upwards",
            # What phi fits to flights of a simulated vehicle without noise, turbulence and effects.
            loop_discrepancy=0.05,
        ),
        form("rotor_share", 0.5, 0.0, 1.0, "share of the lift that grows with rotor speed"),
        # Glauert: the induced velocity cannot fall below zero.
        form("saturation", 0.5, 0.0, 1.5, "share of the lift that saturates at a speed of 10 m/s"),
    ),
    aliases=("thrust-gain", "quadratic-drag", "linear-drag"),
    observable="level flight at several speeds above 2 m/s; at one speed it looks like a thrust gain",
    replaced_by=(THRUST,),
    closing=Closing(
        model="a force along body -z that grows with the square of the air speed across the rotors",
        planner="prefers paths with less lift: slower where the speed is greatest",
        law=None,
        no_law="the feed-forward has no force that grows with the square of the speed across the rotors",
    ),
    specific_force_frd=_force,
)
