"""Offset of the centre of mass: collective thrust then exerts a torque on the vehicle."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import TORQUE


def _torque(ops, theta, ctx):
    x, y, _ = theta
    return (y * ctx.collective_n, -x * ctx.collective_n, 0.0)


def _inertia(ops, theta, mass_kg):
    # A share s of the mass moved by d: r = s d, and about the new centre J grows by s m d^2 - m r^2.
    x, y, spread = theta
    roll, pitch = spread * mass_kg * y * y, spread * mass_kg * x * x
    return (roll, pitch, roll + pitch, -spread * mass_kg * x * y)


def _axis(key: str, direction: str) -> Parameter:
    return Parameter(
        key=key,
        unit="m",
        neutral=0.0,
        typical=0.004,
        tolerance=0.0002,
        lower=-0.03,
        upper=0.03,
        description=f"offset of the centre of mass {direction} of the origin of the rotor positions",
    )


EFFECT = Effect(
    name="com-offset",
    title="Offset of the centre of mass",
    family="torque",
    equation="tau_frd = -(x, y, 0) x (0, 0, -T) = (y T, -x T, 0); "
    "J = J_nominal + spread m (r^2 I - r r^T), r = (x, y, 0)",
    source="2-10 mm after a change of battery or payload; rigid-body statics, parallel axis theorem",
    parameters=(
        _axis("x", "ahead"),
        _axis("y", "to the right"),
        # Of a share s of the mass that moved, it is 1/s - 1. A battery is a quarter to a half of the mass.
        form("spread", 1.0, 0.0, 10.0, "inertia that the moved mass adds, over m r^2", neutral=2.0),
    ),
    aliases=("wind", "torque-bias", "rotor-loss", "frame-tilt"),
    separated_by={"torque-bias": "balance the vehicle on an edge"},
    observable="changes of thrust, as in climbs and fast turns; in hover it looks like a torque bias",
    replaced_by=(TORQUE,),
    changes_hover=True,
    closing=Closing(
        model="a torque proportional to the collective thrust",
        planner="if the model has no drag, prefers paths on which the thrust, and with it the torque, "
        "changes less; the torque at hover is ignored",
        law=None,
        no_law="the feed-forward has no torque; the rate integral balances it",
    ),
    torque_frd=_torque,
    added_inertia_kg_m2=_inertia,
)
