"""One tick of the flight MCU at 1 kHz: estimate, reference, feed-forward, control, allocation, running sums.

`step(ops, inputs) -> outputs` is a pure function: its state is the block `memory`, both input and output. The
same source runs on floats and on numpy arrays with one entry for each independent vehicle (lanes), and CasADi
traces it for the compiled engines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trimtab.firmware_model.law import feedforward
from trimtab.firmware_model.law.allocation import (
    TABLE_SIZE,
    allocate,
    allocation_matrix,
    allocation_table,
    invert4,
    thrust_to_command,
)
from trimtab.firmware_model.law.dfbc import FlatState, Gains, outer_loop, rate_loop
from trimtab.firmware_model.law.estimator import Estimate, EstimatorGains, correct, predict
from trimtab.firmware_model.law.flatness import Body, flat_attitude, flat_rates
from trimtab.firmware_model.law.observer import lagged_thrust, measured_disturbance, observe
from trimtab.firmware_model.law.ops import Ops, Scalar, Vector
from trimtab.firmware_model.law.reference import CUBIC_SIZE, SEPTIC_SIZE, cubic_at, septic_at
from trimtab.firmware_model.law.rotations import attitude_error, quat_to_matrix

TICK_S = 0.001
MOTOR_COUNTS = 65536.0
"""Counts of the running sum per unit of motor command and tick."""
GYRO_COUNTS = 4096.0
"""Counts of the running sum per rad/s and tick."""
FORCE_COUNTS = 1024.0
"""Counts of the running sum per m/s^2 and tick."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """A named input or output vector."""

    name: str
    size: int


EST_P, EST_V, EST_Q, EST_BIAS = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)
"""Estimate in the block `memory`: p_ned, v_ned, q_ned_frd, gyro bias."""
RATE_FILTERED = slice(13, 16)
RATE_INTEGRAL = slice(16, 19)
MOTOR_SUM, GYRO_SUM, FORCE_SUM = slice(19, 23), slice(23, 26), slice(26, 29)
"""Running sums in counts since boot, before rounding: telemetry takes the floor modulo 2^32."""
LAST_COMMAND = slice(29, 33)
OBSERVER = slice(33, 36)
"""Estimate d_hat of the disturbance observer (m/s^2, NED)."""
OBSERVER_THRUST = slice(36, 37)
"""Commanded collective thrust (N) after the nominal rotor lag."""
MEMORY_SIZE = 37
MEMORY: dict[str, slice] = {
    "p": EST_P,
    "v": EST_V,
    "q": EST_Q,
    "gyro_bias": EST_BIAS,
    "rate_filtered": RATE_FILTERED,
    "rate_integral": RATE_INTEGRAL,
    "motor_sum": MOTOR_SUM,
    "gyro_sum": GYRO_SUM,
    "force_sum": FORCE_SUM,
    "motor_command": LAST_COMMAND,
    "observer": OBSERVER,
    "observer_thrust": OBSERVER_THRUST,
}

_DIRECT = (
    "MASS", "INERTIA_X", "INERTIA_Y", "INERTIA_Z",
    "THRUST_MAX", "THRUST_C1", "THRUST_C2", "THRUST_MIN",
    "POS_P_N", "POS_P_E", "POS_P_D",
    "VEL_D_N", "VEL_D_E", "VEL_D_D",
    "ATT_P_X", "ATT_P_Y", "ATT_P_Z",
    "RATE_P_X", "RATE_P_Y", "RATE_P_Z",
    "RATE_I_X", "RATE_I_Y", "RATE_I_Z",
    "RATE_D_X", "RATE_D_Y", "RATE_D_Z",
    "RATE_ILIM_X", "RATE_ILIM_Y", "RATE_ILIM_Z",
    "RATE_FILT_HZ", "THRUST_FLOOR",
    "EST_POS", "EST_VEL", "EST_ATT", "EST_BIAS", "EST_BIAS_MAX",
    "OBS_GAIN", "MOTOR_LAG",
)  # fmt: skip
_ROTORS = tuple(f"ROTOR{i}_{field}" for i in (1, 2, 3, 4) for field in ("X", "Y", "SPIN"))
SOURCES: tuple[str, ...] = (*_DIRECT, *_ROTORS, "TORQUE_PER_N")
"""Names of the parameters that the control law reads from the protocol's table."""
PARAMETERS: tuple[str, ...] = (*_DIRECT, *(f"ALLOCATION_{k}" for k in range(TABLE_SIZE)))
"""Layout of the block `parameters`: values from the table, then the `allocation_table` of its rotors."""
_AT = {name: k for k, name in enumerate(PARAMETERS)}
_ALLOCATION = slice(_AT["ALLOCATION_0"], None)

OFFBOARD_SIZE = 10
"""Size of the block `offboard`: 1 if direct commands replace the outer loop, 0 with position setpoints;
collective thrust (N); body rate (rad/s, FRD); weight of the attitude error; attitude q_ned_frd, a unit
quaternion.
"""
NO_OFFBOARD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

INPUTS: tuple[Block, ...] = (
    Block(name="memory", size=MEMORY_SIZE),
    Block(name="gyro", size=3),
    Block(name="specific_force", size=3),
    Block(name="mocap_new", size=1),
    Block(name="mocap_p", size=3),
    Block(name="mocap_q", size=4),
    Block(name="mocap_age_s", size=1),
    Block(name="mocap_interval_s", size=1),
    Block(name="armed", size=1),
    Block(name="observing", size=1),
    Block(name="feedback_weights", size=2),
    Block(name="piece", size=1 + SEPTIC_SIZE),  # time inside the piece (s), coefficients
    Block(name="yaw_piece", size=1 + CUBIC_SIZE),
    Block(name="offboard", size=OFFBOARD_SIZE),
    Block(name="feedforward", size=feedforward.FF_SIZE),
    Block(name="ff_accel_ned", size=3),
    Block(name="ff_jerk_ned", size=3),
    Block(name="parameters", size=len(PARAMETERS)),
)
OUTPUTS: tuple[Block, ...] = (
    Block(name="memory", size=MEMORY_SIZE),
    Block(name="motor_command", size=4),
    Block(name="collective_n", size=1),
    Block(name="rate_cmd", size=3),
    Block(name="torque", size=3),
    Block(name="saturated", size=1),
    Block(name="reference", size=14),
    Block(name="cos_tilt", size=1),
    Block(name="ff_weight", size=1),
)


def parameter_vector(table: Mapping[str, float]) -> tuple[float, ...]:
    """Return the block `parameters` from a mapping that has the names in `SOURCES`.

    Raises KeyError for a missing name and ValueError if the rotors cannot produce every torque.
    """
    positions = [(table[f"ROTOR{i}_X"], table[f"ROTOR{i}_Y"]) for i in (1, 2, 3, 4)]
    spins = [table[f"ROTOR{i}_SPIN"] for i in (1, 2, 3, 4)]
    inverse = invert4(allocation_matrix(positions, spins, table["TORQUE_PER_N"]))
    return (*(float(table[name]) for name in _DIRECT), *allocation_table(inverse))


def initial_memory(
    p: Sequence[float] = (0.0, 0.0, 0.0), q: Sequence[float] = (1.0, 0.0, 0.0, 0.0)
) -> tuple[float, ...]:
    """Return the block `memory` of a vehicle at rest at position p (NED) and attitude q_ned_frd."""
    memory = [0.0] * MEMORY_SIZE
    memory[EST_P], memory[EST_Q] = p, q
    return tuple(memory)


def body(parameters: Vector) -> Body:
    """Return mass and inertia from the block `parameters`."""
    return Body(parameters[0], parameters[1:4])


def gains(parameters: Vector) -> Gains:
    """Return the controller's gains from the block `parameters`."""
    start = _AT["POS_P_N"]
    triples = [parameters[start + 3 * k : start + 3 * k + 3] for k in range(6)]
    return Gains(
        *triples,
        filter_rate=6.283185307179586 * parameters[_AT["RATE_FILT_HZ"]],
        thrust_floor=parameters[_AT["THRUST_FLOOR"]],
    )


def integral_limit(parameters: Vector) -> Vector:
    """Return the bounds of the rate integral (rad/s^2) from the block `parameters`."""
    start = _AT["RATE_ILIM_X"]
    return parameters[start : start + 3]


def estimator_gains(parameters: Vector) -> EstimatorGains:
    """Return the estimator's gains from the block `parameters`."""
    start = _AT["EST_POS"]
    return EstimatorGains(*parameters[start : start + 4])


def observer(parameters: Vector) -> tuple[Scalar, Scalar]:
    """Return observer gain (1/s) and nominal rotor lag (s) from the block `parameters`."""
    return parameters[_AT["OBS_GAIN"]], parameters[_AT["MOTOR_LAG"]]


def motors(
    ops: Ops, parameters: Vector, collective_n: Scalar, torque: Vector, gain: Scalar
) -> tuple[list[Scalar], list[Scalar], Scalar]:
    """Return motor commands (0..1), their nominal rotor thrusts (N), and 1 if the rotors saturate, else 0.

    gain: actual over nominal rotor thrust. The demand is divided by it.
    """
    thrust_max, c1, c2 = parameters[4], parameters[5], parameters[6]
    per_gain = 1.0 / gain
    thrust, saturated = allocate(
        ops,
        parameters[_ALLOCATION],
        collective_n * per_gain,
        [per_gain * t for t in torque],
        parameters[7],
        thrust_max,
    )
    return [thrust_to_command(ops, t, thrust_max, c1, c2) for t in thrust], list(thrust), saturated


def flat_motion(ops: Ops, ref: FlatState) -> tuple[feedforward.FlatMotion, Scalar]:
    """Return the motion along the reference, and its specific thrust (m/s^2)."""
    R_flat, thrust = flat_attitude(ops, ref.a, ref.yaw)
    rate = flat_rates(ops, ref.a, ref.j, ref.yaw, ref.yaw_rate)
    return feedforward.FlatMotion(ref.v, ref.a, R_flat, rate), thrust


def feedforward_terms(
    ops: Ops, block: Vector, ref: FlatState, network: feedforward.Residual
) -> tuple[Vector, Vector, Scalar]:
    """Return the residual acceleration along the reference, its derivative (NED), and its weight.

    The acceleration is the sum of block and network times the weight that fades it out beyond the region. The
    derivative leaves out that of the weight.
    """
    motion, thrust = flat_motion(ops, ref)
    v, a, R_flat, rate = motion
    weight = feedforward.fade_weight(ops, block[feedforward.REGION], v, R_flat, thrust)
    accel = feedforward.specific_force_ned(ops, block, v, R_flat)
    jerk = feedforward.specific_force_rate_ned(ops, block, v, a, rate, R_flat)
    return (
        [weight * (x + y) for x, y in zip(accel, network.accel_ned, strict=True)],
        [weight * (x + y) for x, y in zip(jerk, network.jerk_ned, strict=True)],
        weight,
    )


def step(ops: Ops, inputs: Mapping[str, Vector]) -> dict[str, Vector]:
    """Return the output blocks of one tick. Inputs must be finite.

    `mocap_new`, `armed`, `observing` and the first value of `offboard` are 0 or 1. `armed` is 1 while the
    rotors are on. The observer's estimate stays constant while `observing` is 0.
    """
    memory, parameters, block = inputs["memory"], inputs["parameters"], inputs["feedforward"]
    gyro, force = inputs["gyro"], inputs["specific_force"]
    est, R, rate = _estimate(ops, inputs)

    # Reference, and the residual acceleration along it.
    piece, yaw_piece = inputs["piece"], inputs["yaw_piece"]
    p_r, v_r, a_r, j_r, _ = septic_at(piece[1:], piece[0])
    yaw, yaw_rate = cubic_at(yaw_piece[1:], yaw_piece[0])
    ref = FlatState(p_r, v_r, a_r, j_r, yaw, yaw_rate)
    network = feedforward.Residual(inputs["ff_accel_ned"], inputs["ff_jerk_ned"])
    ff_accel, ff_jerk, ff_weight = feedforward_terms(ops, block, ref, network)
    d_hat = _disturbance(ops, inputs, est, R, ff_accel)
    ff_accel = [a + d for a, d in zip(ff_accel, d_hat, strict=True)]

    # Controller.
    k = gains(parameters)
    model = body(parameters)
    collective, rate_cmd = outer_loop(
        ops, k, model, est.p, est.v, R, ref, ff_accel,
        inputs["feedback_weights"], ff_jerk, block[feedforward.ATTITUDE_OFFSET],
    )  # fmt: skip
    collective, rate_cmd = _offboard(ops, k, inputs["offboard"], R, collective, rate_cmd)
    filtered = memory[RATE_FILTERED]
    integral = memory[RATE_INTEGRAL]
    torque, integral_dot = rate_loop(k, model, rate, filtered, integral, rate_cmd)
    gain = block[feedforward.GAIN]
    command, thrust, saturated = motors(ops, parameters, collective, torque, gain)

    # Memory.
    on = ops.where(inputs["armed"][0] > 0.5, 1.0, 0.0)
    command = [on * u for u in command]
    saturated = on * saturated
    advance = TICK_S * k.filter_rate
    advance = advance / (1.0 + 0.5 * advance)
    filtered = [f + advance * (w - f) for f, w in zip(filtered, rate, strict=True)]
    integral = [
        on * ops.clip(i + TICK_S * d, -limit, limit)
        for i, d, limit in zip(integral, integral_dot, integral_limit(parameters), strict=True)
    ]
    commanded = gain * (thrust[0] + thrust[1] + thrust[2] + thrust[3])
    _, lag_s = observer(parameters)
    lagged = lagged_thrust(memory[OBSERVER_THRUST.start], commanded, lag_s, TICK_S)
    observed = [on * x for x in (*d_hat, lagged)]
    # The previous command acted over the interval that ends with this tick.
    last = memory[LAST_COMMAND]
    sums = [
        *(s + MOTOR_COUNTS * u for s, u in zip(memory[MOTOR_SUM], last, strict=True)),
        *(s + GYRO_COUNTS * g for s, g in zip(memory[GYRO_SUM], gyro, strict=True)),
        *(s + FORCE_COUNTS * f for s, f in zip(memory[FORCE_SUM], force, strict=True)),
    ]
    return {
        "memory": [*est.p, *est.v, *est.q, *est.bias, *filtered, *integral, *sums, *command, *observed],
        "motor_command": command,
        "collective_n": [collective],
        "rate_cmd": rate_cmd,
        "torque": torque,
        "saturated": [saturated],
        "reference": [*p_r, *v_r, *a_r, *j_r, yaw, yaw_rate],
        "cos_tilt": [R[8]],
        "ff_weight": [ff_weight],
    }


def _estimate(ops: Ops, inputs: Mapping[str, Vector]) -> tuple[Estimate, Vector, list[Scalar]]:
    """Return the state estimate, its R_ned_frd (9 values) and the body rate (rad/s, FRD)."""
    memory, parameters = inputs["memory"], inputs["parameters"]
    gyro, block = inputs["gyro"], inputs["feedforward"]
    est = Estimate(memory[EST_P], memory[EST_V], memory[EST_Q], memory[EST_BIAS])
    est, rate, a, _ = predict(ops, est, gyro, inputs["specific_force"], TICK_S)
    interval = ops.where(inputs["mocap_new"][0] > 0.5, inputs["mocap_interval_s"][0], 0.0)
    age = inputs["mocap_age_s"][0] + block[feedforward.PREDICTION_TIME]
    pose = (inputs["mocap_p"], inputs["mocap_q"])
    est = correct(ops, est, rate, a, *pose, age, interval, estimator_gains(parameters))
    bias_max = parameters[_AT["EST_BIAS_MAX"]]
    est = est._replace(bias=[ops.clip(b, -bias_max, bias_max) for b in est.bias])
    R = quat_to_matrix(ops, est.q)
    return est, R, [g - b for g, b in zip(gyro, est.bias, strict=True)]


def _disturbance(
    ops: Ops, inputs: Mapping[str, Vector], est: Estimate, R: Vector, predicted: Vector
) -> Vector:
    """Return the observer's estimate of the disturbance acceleration beyond `predicted` (m/s^2, NED)."""
    memory, parameters = inputs["memory"], inputs["parameters"]
    obs_gain, _ = observer(parameters)
    v_dot = [(now - before) / TICK_S for now, before in zip(est.v, memory[EST_V], strict=True)]
    offset = inputs["feedforward"][feedforward.ATTITUDE_OFFSET]
    thrust = memory[OBSERVER_THRUST.start]
    measured = measured_disturbance(v_dot, R, thrust, parameters[0], predicted, offset)
    observing = ops.where(inputs["observing"][0] > 0.5, obs_gain, 0.0)
    return observe(ops, observing, memory[OBSERVER], measured, TICK_S)


def _offboard(
    ops: Ops, k: Gains, block: Vector, R: Vector, collective: Scalar, rate_cmd: Vector
) -> tuple[Scalar, list[Scalar]]:
    """Return collective thrust and body rate of the block `offboard` if it is on, else the given ones."""
    direct = block[0] > 0.5
    error = attitude_error(quat_to_matrix(ops, block[6:10]), R)
    rates = [w - block[5] * gain * e for w, gain, e in zip(block[2:5], k.attitude, error, strict=True)]
    return (
        ops.where(direct, block[1], collective),
        [ops.where(direct, a, w) for a, w in zip(rates, rate_cmd, strict=True)],
    )
