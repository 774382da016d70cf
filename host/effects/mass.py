"""Mass: the mass of the vehicle differs from that in its file."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter


def _factor(ops, theta):
    return theta[0]


def _feedforward(theta):
    return {"gain": 1.0 / theta[0]}


EFFECT = Effect(
    name="mass",
    title="Mass",
    equation="m = factor m_nominal",
    source="payloads and batteries: 5-30 %; flights show only thrust over mass",
    parameters=(
        Parameter(
            key="factor",
            unit="1",
            neutral=1.0,
            typical=0.08,
            tolerance=0.01,
            lower=0.4,
            upper=2.5,
            description="mass over the vehicle file's mass",
            # The vehicle was weighed.
            measured_below=0.005,
        ),
    ),
    aliases=("thrust-gain", "battery-sag", "ground-effect", "slung-payload"),
    observable="only thrust over mass is observable in flight; weigh the vehicle",
    adjustment=True,
    changes_hover=True,
    comes_with=("com-offset",),
    closing=Closing(
        model="the mass is multiplied by a constant",
        planner="if the model has no drag, prefers paths with less acceleration, since a share of it is "
        "missing; the missing share at hover is ignored",
        law="the commanded thrust is multiplied by the factor",
    ),
    mass_factor=_factor,
    to_feedforward=_feedforward,
)
