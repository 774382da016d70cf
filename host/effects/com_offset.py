"""Offset of the centre of mass: thrust through the rotors' middle turns the vehicle."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import TORQUE


def _torque(ops, theta, ctx):
    x, y = theta
    return (y * ctx.collective_n, -x * ctx.collective_n, 0.0)


def _axis(key: str, direction: str) -> Parameter:
    return Parameter(
        key=key,
        unit="m",
        neutral=0.0,
        typical=0.004,
        tolerance=0.0002,
        lower=-0.03,
        upper=0.03,
        description=f"centre of mass {direction} of the origin the rotor positions are given from",
    )


EFFECT = Effect(
    name="com-offset",
    title="Offset of the centre of mass",
    family="torque",
    equation="tau_frd = -(x, y, 0) x (0, 0, -T) = (y T, -x T, 0)",
    source="2-10 mm after a change of battery or payload; rigid-body statics",
    parameters=(_axis("x", "ahead"), _axis("y", "to the right")),
    aliases=("wind", "torque-bias", "rotor-loss", "frame-tilt"),
    separated_by={"torque-bias": "balance the vehicle on an edge"},
    observable="changes of thrust, as in climbs and fast turns; in hover it is a torque bias",
    replaced_by=(TORQUE,),
    closing=Closing(
        model="a torque in proportion to the collective thrust",
        planner="without a drag beside it, plans a path of less change of thrust, with which the "
        "torque changes; hover's is left out",
        law=None,
    ),
    torque_frd=_torque,
)
