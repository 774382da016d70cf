"""Torque bias: a constant torque, for example from a bent arm or a residual trim."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter, form
from trimtab.host.effects.unknowns import TORQUE


def _torque(ops, theta, ctx):
    grown = 1.0 + theta[3] * (ctx.collective_n / (4.0 * ctx.hover_n) - 1.0)
    return tuple(j * alpha * grown for j, alpha in zip(ctx.inertia_kg_m2, theta, strict=False))


def _axis(key: str) -> Parameter:
    return Parameter(
        key=key,
        unit="rad/s^2",
        neutral=0.0,
        typical=2.5,
        tolerance=0.3,
        lower=-30.0,
        upper=30.0,
        description=f"constant torque about body {key} over the moment of inertia in the vehicle file",
    )


EFFECT = Effect(
    name="torque-bias",
    title="Torque bias",
    family="torque",
    equation="tau_frd = J_nominal (x, y, z) (1 + thrust_share (T / T_hover - 1))",
    source="bent arms and tilted motor mounts; about 5-10 mN m on a 0.75 kg quadrotor",
    parameters=(
        _axis("x"),
        _axis("y"),
        _axis("z"),
        # The torque of a bent arm grows with thrust, that of a trim does not.
        form("thrust_share", 0.3, 0.0, 0.6, "share of the torque that grows with the collective thrust"),
    ),
    aliases=("com-offset", "rotor-loss"),
    observable="flight with changing thrust; in hover it looks like an offset of the centre of mass",
    replaced_by=(TORQUE,),
    changes_hover=True,
    closing=Closing(
        model="a constant torque, of which a share may grow with the thrust",
        planner="if the model has no drag, prefers paths on which the share that grows with the thrust "
        "changes less; the torque at hover is ignored",
        law=None,
        no_law="the feed-forward has no torque; the rate integral balances it",
    ),
    torque_frd=_torque,
)
