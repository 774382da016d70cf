"""Thrust gain: the thrust of every rotor differs from its curve by the same factor."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect, ExactAlias
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import THRUST, THRUST_CURVE


def _factor(ops, theta, ctx):
    gain, rotor_share = theta
    return 1.0 + (gain - 1.0) * (1.0 + rotor_share * ctx.excess_speed(ops))


def _feedforward(theta):
    return {"gain": theta[0]}


EFFECT = Effect(
    name="thrust-gain",
    title="Thrust gain",
    tolerance_of_motors=True,
    equation="T_i = (1 + (gain - 1) (1 + rotor_share (sqrt(T / T_hover) - 1))) T_i,nominal",
    source="5-10 % between propellers, batteries and motor controllers of the same type",
    parameters=(
        Parameter(
            key="gain",
            unit="1",
            neutral=1.0,
            typical=0.08,
            tolerance=0.01,
            lower=0.4,
            upper=2.0,
            description="thrust over that in the vehicle file, the same for all rotors",
        ),
        # The error of a thrust curve, or of a propeller at another Reynolds number, changes with speed.
        form("rotor_share", 0.3, -1.0, 1.0, "share of the excess thrust that grows with rotor speed"),
    ),
    aliases=(
        "mass",
        "battery-sag",
        "ground-effect",
        "inertia",
        "rotor-loss",
        "slung-payload",
        "translational-lift",
    ),
    exact_aliases=(
        ExactAlias(
            effect="mass",
            ratio="thrust over mass",
            remedy="weigh the vehicle to distinguish mass from thrust",
        ),
    ),
    observable="any flight; weigh the vehicle to distinguish it from mass",
    replaced_by=(THRUST, THRUST_CURVE),
    closing=Closing(
        model="the thrust of every rotor is multiplied by a constant",
        planner="if the model has no drag, prefers paths with less acceleration, since a share of it is "
        "missing; the missing share at hover is ignored",
        law="the commanded thrust is divided by the gain",
    ),
    thrust_factor=_factor,
    to_feedforward=_feedforward,
)
