"""Ground effect: near the floor the rotors' wake is dammed up and thrust rises."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import THRUST

_LEAST_HEIGHT_M = 0.25
_GREATEST = 1.5


def _factor(ops, theta, ctx):
    (k,) = theta
    height = ops.maximum(-ctx.p_ned[2], _LEAST_HEIGHT_M)
    return 1.0 / ops.maximum(1.0 - k / (height * height), 1.0 / _GREATEST)


EFFECT = Effect(
    name="ground-effect",
    title="Ground effect",
    family="aerodynamic",
    equation="T_i = T_i,nominal min(1.5, 1 / (1 - k / h^2)), h the height over the floor, at least 0.25 m",
    source="Cheeseman and Bennett 1955 with k = (R/4)^2; for whole quadrotors several times a rotor's k",
    parameters=(
        Parameter(
            key="k",
            unit="m^2",
            neutral=0.0,
            typical=0.012,
            tolerance=0.0005,
            lower=0.0,
            upper=0.05,
            description="square of a quarter of the radius that the vehicle acts like",
        ),
    ),
    aliases=("thrust-gain", "mass", "battery-sag"),
    observable="a flight that goes low, below some 0.8 m, and high; at one height it is a thrust gain",
    replaced_by=(THRUST,),
    closing=Closing(
        model="every rotor's thrust rises towards the floor",
        planner="without a drag beside it, plans a path that keeps off the floor where its waypoints let it",
        law=None,
    ),
    thrust_factor=_factor,
)
