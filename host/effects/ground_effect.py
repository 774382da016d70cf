"""Ground effect: near the floor, the obstructed wake of the rotors increases thrust."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import THRUST

_LEAST_HEIGHT_M = 0.25
_GREATEST_FACTOR = 1.5
_MIDDLE_HEIGHT_M = 0.7


def _factor(ops, theta, ctx):
    k, fade = theta
    height = ops.maximum(-ctx.p_ned[2], _LEAST_HEIGHT_M)
    k = k * ops.maximum(1.0 - fade * (height - _MIDDLE_HEIGHT_M), 0.0)
    return 1.0 / ops.maximum(1.0 - k / (height * height), 1.0 / _GREATEST_FACTOR)


EFFECT = Effect(
    name="ground-effect",
    title="Ground effect",
    family="aerodynamic",
    equation="T_i = T_i,nominal min(1.5, 1 / (1 - k (1 - fade (h - 0.7 m)) / h^2)), h the height over "
    "the floor, at least 0.25 m",
    source="Cheeseman and Bennett 1955 with k = (R/4)^2; k of a quadrotor is several times that of one rotor",
    parameters=(
        Parameter(
            key="k",
            unit="m^2",
            neutral=0.0,
            typical=0.012,
            tolerance=0.0005,
            lower=0.0,
            upper=0.08,
            description="square of a quarter of the effective rotor radius of the vehicle",
        ),
        # Measured laws of quadrotors fall faster or more slowly than the inverse square.
        form("fade", 0.2, -0.5, 0.5, "relative decrease of k per metre of height, from 0.7 m on", unit="1/m"),
    ),
    aliases=("thrust-gain", "mass", "battery-sag"),
    observable="a flight both below about 0.8 m and high above the floor; at one height it looks like a "
    "thrust gain",
    replaced_by=(THRUST,),
    closing=Closing(
        model="the thrust of every rotor increases near the floor",
        planner="if the model has no drag, stays away from the floor where the waypoints permit it",
        law=None,
        no_law="the feed-forward does not depend on height",
    ),
    thrust_factor=_factor,
)
