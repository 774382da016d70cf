"""Thrust loss of one rotor: a damaged propeller or a worn motor gives less thrust than the other three."""

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
        description=f"share of its thrust that rotor {number} of the vehicle file loses",
    )


EFFECT = Effect(
    name="rotor-loss",
    title="Loss of one rotor",
    family="torque",
    equation="T_i = (1 - loss_i) T_i,nominal, for one of the rotors",
    source="damaged propellers and worn motors: 0.8-0.95 of the thrust of one rotor remains",
    parameters=tuple(_rotor(number) for number in (1, 2, 3, 4)),
    aliases=("com-offset", "torque-bias", "thrust-gain"),
    observable="roll, pitch and yaw torque in a fixed ratio; an offset of the centre of mass has no yaw part",
    replaced_by=(THRUST, TORQUE),
    closing=Closing(
        model="the thrust of one rotor is multiplied by a constant",
        planner="if the model has no drag, prefers paths on which the thrust, and with it the loss, "
        "changes less; the loss at hover is ignored",
        law="the commanded thrust is divided by the mean factor of the four rotors; the rate integral "
        "compensates the torque",
    ),
    one_of=True,
    rotor_factors=_factors,
    to_feedforward=_feedforward,
)
