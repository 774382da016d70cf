"""The words of the metadata entry `unknown`, by which a log declares what it does not determine.

Tracing estimates unknown quantities as nuisances and does not count them as effects. Each effect states which
of these words take it out of the candidates (`Effect.replaced_by`) and which free it (`Effect.freed_by`).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

THRUST = "thrust"
THRUST_CURVE = "thrust-curve"
MOTOR_LAG = "motor-lag"
MOUNTING_TILT = "mounting-tilt"
FRAME_TILT = "frame-tilt"
INERTIA = "inertia"
TORQUE = "torque"
POSE_LATENCY = "pose-latency"

UNKNOWN = (
    THRUST,
    THRUST_CURVE,
    MOTOR_LAG,
    MOUNTING_TILT,
    FRAME_TILT,
    INERTIA,
    TORQUE,
    POSE_LATENCY,
)
"""All words, in the order in which messages list them."""

UNKNOWN_WITHOUT_INPUTS = frozenset({THRUST, MOTOR_LAG, INERTIA, TORQUE})
"""What a log of only poses does not determine."""

UNKNOWN_IF_SLOW = frozenset({MOTOR_LAG, INERTIA, TORQUE})
"""What commands do not determine if their sampling interval is longer than the motor lag."""


def undetermined(input_us: Annotated[np.ndarray, "inputs"] | None, motor_lag_s: float) -> frozenset[str]:
    """Return what recorded motor commands or thrusts at these times do not determine; None for none."""
    if input_us is None:
        return UNKNOWN_WITHOUT_INPUTS
    slow = len(input_us) > 1 and float(np.median(np.diff(input_us))) * 1e-6 > motor_lag_s
    return UNKNOWN_IF_SLOW if slow else frozenset()
