"""Battery sag: thrust at a given motor command falls with the battery's voltage."""

from __future__ import annotations

from host.effects.effect import Closing, Effect, Parameter


def _factor(ops, theta, ctx):
    return ops.exp(theta[0] * ops.log(ctx.voltage_ratio))


EFFECT = Effect(
    name="battery-sag",
    title="Battery sag",
    equation="T_i = T_i,nominal (V / V_full)^exponent",
    source="measured on small brushless drives: thrust ~ V^1.5..2 at a fixed command",
    parameters=(
        Parameter(
            key="exponent",
            unit="1",
            neutral=0.0,
            typical=1.7,
            tolerance=0.1,
            lower=-1.0,
            upper=5.0,
            description="power of the voltage ratio that thrust follows",
        ),
    ),
    aliases=("thrust-gain", "mass"),
    closing=Closing(
        model="every rotor's thrust times a power of the measured voltage ratio",
        planner="plans with the thrust left at the voltage seen in flight",
        law=None,
    ),
    thrust_factor=_factor,
)
