"""Battery sag: thrust at a given motor command falls with the battery's voltage."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import THRUST

_VOLTMETER_NOISE = 0.01  # share of the full voltage; a battery that stayed closer shows no sag


def _factor(ops, theta, ctx):
    return ops.exp(theta[0] * ops.log(ctx.voltage_ratio))


def _feedforward(theta):
    return {"voltage_exponent": theta[0]}


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
    aliases=("thrust-gain", "mass", "ground-effect"),
    separated_by={"thrust-gain": "fly once more with a full battery and log its voltage"},
    observable="flights from a full and from an emptier battery, or one long flight, with the voltage logged",
    needs_signals={"voltage_ratio": _VOLTMETER_NOISE},
    replaced_by=(THRUST,),
    closing=Closing(
        model="every rotor's thrust times a power of the measured voltage ratio",
        planner="nothing: plans are made for a full battery",
        law="the commanded thrust is divided by the sag at one voltage, the mean of the flights learned "
        "from; what another battery differs by stays",
    ),
    thrust_factor=_factor,
    to_feedforward=_feedforward,
)
