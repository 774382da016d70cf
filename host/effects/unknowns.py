"""What a log may declare unknown: the words of its metadata entry `unknown`.

Tracing estimates what a log does not determine as a nuisance and counts it as no effect. Each effect states
which of these words take it out of the candidates (`Effect.replaced_by`) and which leave it free
(`Effect.freed_by`).
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
"""Every word, in the order of messages."""
