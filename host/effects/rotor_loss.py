"""Thrust loss of one rotor: a damaged propeller or a worn motor gives less thrust than the other three."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import THRUST, TORQUE


def _factors(ops, theta, ctx):
    return tuple(1.0 - lost for lost in _lost(ops, theta, ctx))


def _torque(ops, theta, ctx):
    # The nominal model lowers the drag torque by the same share as the thrust, of which ctx has the rest.
    lost = _lost(ops, theta, ctx)
    yaw = sum(
        spin * share / (1.0 - share) * thrust
        for spin, share, thrust in zip(ctx.spin_signs, lost, ctx.thrust, strict=True)
    )
    return (0.0, 0.0, (1.0 - theta[5]) * ctx.torque_per_thrust_m * yaw)


def _lost(ops, theta, ctx):
    """Return the share of its thrust that each rotor loses."""
    return [
        ops.minimum(loss * (1.0 + theta[4] * ctx.excess_speed(ops, thrust)), _MOST_LOST)
        for loss, thrust in zip(theta[:4], ctx.thrust, strict=True)
    ]


def _feedforward(theta):
    return {"gain": 1.0 - 0.25 * sum(theta[:4])}


_MOST_LOST = 0.95


def _rotor(number: int) -> Parameter:
    return Parameter(
        key=f"loss_{number}",
        unit="1",
        neutral=0.0,
        typical=0.1,
        tolerance=0.004,
        lower=-0.02,  # five tolerances: the other three rotors are never exactly alike
        upper=0.6,
        description=f"share of its thrust that rotor {number} of the vehicle file loses",
    )


EFFECT = Effect(
    name="rotor-loss",
    title="Loss of one rotor",
    family="torque",
    equation="T_i = (1 - loss_i (1 + rotor_share (sqrt(T_i / T_hover) - 1))) T_i,nominal, for one of the "
    "rotors; its drag torque falls by torque_ratio loss_i",
    source="damaged propellers and worn motors: 0.8-0.95 of the thrust of one rotor remains",
    parameters=(
        *(_rotor(number) for number in (1, 2, 3, 4)),
        # A damaged blade changes with the Reynolds number, a worn motor with the load.
        form("rotor_share", 0.3, -1.0, 1.0, "share of the loss that grows with the speed of the rotor"),
        # A short blade loses more drag torque than thrust (R^5 against R^4), a bent or taped one less.
        form(
            "torque_ratio",
            0.4,
            -1.0,
            2.0,
            "share of the drag torque lost over that of the thrust",
            neutral=1.0,
        ),
    ),
    aliases=("com-offset", "torque-bias", "thrust-gain"),
    observable="roll, pitch and yaw torque in a fixed ratio; an offset of the centre of mass has no yaw part",
    replaced_by=(THRUST, TORQUE),
    changes_hover=True,
    closing=Closing(
        model="the thrust of one rotor is multiplied by a constant",
        planner="if the model has no drag, prefers paths on which the thrust, and with it the loss, "
        "changes less; the loss at hover is ignored",
        law="the commanded thrust is divided by the mean factor of the four rotors; the rate integral "
        "compensates the torque",
    ),
    one_of=True,
    rotor_factors=_factors,
    torque_frd=_torque,
    form_torque=True,
    to_feedforward=_feedforward,
)
