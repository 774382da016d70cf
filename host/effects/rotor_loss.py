"""Loss of one rotor: a chipped propeller or a tired motor gives less thrust than the three others."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import THRUST, TORQUE


def _factors(ops, theta, ctx):
    return tuple(1.0 - loss for loss in theta)


def _feedforward(theta):
    return {"gain": 1.0 - 0.25 * sum(theta)}


def _rotor(number: int) -> Parameter:
    return Parameter(
        key=f"loss_{number}",
        unit="1",
        neutral=0.0,
        typical=0.1,
        tolerance=0.004,
        lower=-0.2,
        upper=0.6,
        description=f"share of its thrust that rotor {number} of the vehicle file does not give",
    )


EFFECT = Effect(
    name="rotor-loss",
    title="Loss of one rotor",
    family="torque",
    equation="T_i = (1 - loss_i) T_i,nominal, for one of the rotors",
    source="damaged propellers and worn motors: 0.8-0.95 of one rotor's thrust left",
    parameters=tuple(_rotor(number) for number in (1, 2, 3, 4)),
    aliases=("com-offset", "torque-bias", "thrust-gain"),
    observable="roll, pitch and yaw torque in one fixed ratio; a centre of mass that is off does not yaw",
    replaced_by=(THRUST, TORQUE),
    closing=Closing(
        model="the thrust of one rotor times a constant",
        planner="without a drag beside it, plans a path of less change of thrust, with which the "
        "lost share changes; what hover "
        "lacks is left out",
        law="the commanded thrust is divided by the mean of the four; the rate integral holds the torque",
    ),
    one_of=True,
    rotor_factors=_factors,
    to_feedforward=_feedforward,
)
