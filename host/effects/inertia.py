"""Inertia: the principal moments differ from those in the vehicle file."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import INERTIA, TORQUE


def _factors(ops, theta):
    return tuple(theta)


def _axis(key: str, tolerance: float) -> Parameter:
    return Parameter(
        key=key,
        unit="1",
        neutral=1.0,
        typical=0.2,
        tolerance=tolerance,
        lower=0.3,
        upper=3.0,
        description=f"moment of inertia about body {key} over that in the vehicle file",
        # The response of the loop to noise within a step looks like a wrong inertia.
        discrepancy=0.2,
        free_sigma=0.5,
    )


EFFECT = Effect(
    name="inertia",
    title="Inertia",
    family="torque",
    equation="J = diag(x, y, z) J_nominal",
    source="payloads, batteries, and CAD models without wiring: 10-30 %",
    parameters=(_axis("x", 0.02), _axis("y", 0.02), _axis("z", 0.04)),
    aliases=("motor-lag", "actuation-delay", "thrust-gain", "gyroscopic"),
    observed_relative_to="thrust-gain",
    observable="fast rotations, which show only thrust times arm over inertia; swing the vehicle as a "
    "pendulum to measure the inertia itself",
    replaced_by=(TORQUE,),
    freed_by=(INERTIA,),
    closing=Closing(
        model="the principal moments are multiplied by constants",
        planner="if the model has no drag, prefers gentler rotations, which need less torque",
        law=None,
        no_law="the rate loop takes the moments of inertia from the vehicle file; correct them there",
    ),
    inertia_factors=_factors,
)
