"""Mocap latency: a pose is older than its time stamp, both on the vehicle and in the log."""

from __future__ import annotations

from trimtab.host.effects.effect import Closing, Effect
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import POSE_LATENCY


def _latency(ops, theta):
    return theta[0]


def _feedforward(theta):
    return {"prediction_time_s": theta[0]}


EFFECT = Effect(
    name="mocap-latency",
    title="Undeclared mocap latency",
    family="timing",
    equation="pose(t) = true pose(t - latency_s)",
    source="5-15 ms for exposure, computation and network in camera systems",
    parameters=(
        Parameter(
            key="latency_s",
            unit="s",
            neutral=0.0,
            typical=0.015,
            tolerance=0.0005,
            lower=0.0,
            upper=0.08,
            description="age of a pose at its time stamp",
            discrepancy=0.1,
            # Clocks that were aligned after the flight may be off in either direction.
            free_sigma=0.02,
            free_lower=-0.08,
        ),
    ),
    aliases=("motor-lag", "actuation-delay", "linear-drag"),
    observable="fast flight, as an error along the velocity; without a gyro it looks like an actuation delay",
    freed_by=(POSE_LATENCY,),
    closing=Closing(
        model="the poses that the estimator uses, and the logged poses, are delayed",
        planner="nothing: only a slower plan would reduce the error",
        law="the estimate is predicted forward by the latency",
    ),
    mocap_latency_s=_latency,
    to_feedforward=_feedforward,
)
