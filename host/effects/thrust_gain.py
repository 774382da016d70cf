"""Thrust gain: every rotor gives a constant share more or less than its curve says."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect, ExactAlias
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import THRUST, THRUST_CURVE


def _factor(ops, theta, ctx):
    return theta[0]


def _feedforward(theta):
    return {"gain": theta[0]}


EFFECT = Effect(
    name="thrust-gain",
    title="Thrust gain",
    equation="T_i = gain T_i,nominal",
    source="5-10 % between propellers, batteries and motor controllers of one type",
    parameters=(
        Parameter(
            key="gain",
            unit="1",
            neutral=1.0,
            typical=0.08,
            tolerance=0.01,
            lower=0.4,
            upper=2.0,
            description="thrust over the vehicle file's thrust, all rotors alike",
        ),
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
            remedy="weigh the vehicle to tell mass from thrust",
        ),
    ),
    observable="any flight; from mass only by weighing",
    replaced_by=(THRUST, THRUST_CURVE),
    closing=Closing(
        model="every rotor's thrust times a constant",
        planner="without a drag beside it, plans a path of less acceleration, of which a share "
        "is missing; what hover lacks is "
        "left out",
        law="the commanded thrust is divided by the gain",
    ),
    thrust_factor=_factor,
    to_feedforward=_feedforward,
)
