"""The words of the metadata entry `unknown`, by which a log declares what it does not determine.

Tracing estimates unknown quantities as nuisances and does not count them as effects. Each effect states which
of these words take it out of the candidates (`Effect.replaced_by`) and which free it (`Effect.freed_by`).
"""

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
