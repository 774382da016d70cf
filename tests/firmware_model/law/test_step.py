"""One tick as a whole: equivariance, memory, sums, arming; and a closed loop on the law's own rigid body."""

from __future__ import annotations

import math

import numpy as np
import pytest

from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.allocation import allocation_matrix, command_to_thrust
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.feedforward import ATTITUDE_OFFSET, BIAS, GAIN, NEUTRAL, PREDICTION_TIME, WIND
from trimtab.firmware_model.law.flatness import flat_attitude
from trimtab.firmware_model.law.observer import DISTURBANCE_MAX
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.reference import septic_coefficients
from trimtab.firmware_model.law.rotations import (
    mat_t_vec,
    mat_vec,
    quat_exp,
    quat_from_euler,
    quat_multiply,
    quat_normalize,
    quat_to_matrix,
)
from trimtab.host.codegen.ops import NUMPY
from trimtab.protocol.parameters import DEFAULTS, complete

TABLE = complete({})
PARAMETERS = law.parameter_vector(TABLE)
ROTORS = [[TABLE[f"ROTOR{i}_{axis}"] for axis in "XY"] for i in (1, 2, 3, 4)]
SPINS = [TABLE[f"ROTOR{i}_SPIN"] for i in (1, 2, 3, 4)]
MATRIX = np.reshape(allocation_matrix(ROTORS, SPINS, TABLE["TORQUE_PER_N"]), (4, 4))


def _hover_inputs(**changes):
    node = (0.0, 0.0, -1.0, *(0.0,) * 9)
    inputs = {
        "memory": law.initial_memory((0.0, 0.0, -1.0)),
        "gyro": (0.0, 0.0, 0.0),
        "specific_force": (0.0, 0.0, -GRAVITY),
        "mocap_new": (0.0,),
        "mocap_p": (0.0, 0.0, -1.0),
        "mocap_q": (1.0, 0.0, 0.0, 0.0),
        "mocap_age_s": (0.0,),
        "mocap_interval_s": (0.01,),
        "armed": (1.0,),
        "observing": (1.0,),
        "feedback_weights": (1.0, 1.0),
        "piece": (0.5, *septic_coefficients(1.0, node, node)),
        "yaw_piece": (0.5, 0.0, 0.0, 0.0, 0.0),
        "offboard": law.NO_OFFBOARD,
        "feedforward": NEUTRAL,
        "ff_accel_ned": (0.0, 0.0, 0.0),
        "ff_jerk_ned": (0.0, 0.0, 0.0),
        "parameters": PARAMETERS,
    }
    inputs.update(changes)
    return inputs


def test_blocks_have_the_stated_layout():
    assert set(law.SOURCES) <= set(DEFAULTS)
    assert len(PARAMETERS) == len(law.PARAMETERS)
    assert len({block.name for block in law.INPUTS}) == len(law.INPUTS)
    assert sorted(k for part in law.MEMORY.values() for k in range(part.start, part.stop)) == list(
        range(law.MEMORY_SIZE)
    )
    gains, limit = law.gains(PARAMETERS), law.integral_limit(PARAMETERS)
    assert gains.position == tuple(TABLE[f"POS_P_{axis}"] for axis in "NED")
    assert gains.rate_derivative == tuple(TABLE[f"RATE_D_{axis}"] for axis in "XYZ")
    assert limit == tuple(TABLE[f"RATE_ILIM_{axis}"] for axis in "XYZ")
    assert gains.filter_rate == pytest.approx(2 * math.pi * TABLE["RATE_FILT_HZ"])
    assert law.estimator_gains(PARAMETERS).bias == TABLE["EST_BIAS"]
    assert law.body(PARAMETERS).inertia[2] == TABLE["INERTIA_Z"]


def test_step_at_hover_holds_the_weight_with_four_equal_rotors():
    outputs = law.step(FLOAT, _hover_inputs())
    share = TABLE["MASS"] * GRAVITY / 4 / TABLE["THRUST_MAX"]
    assert outputs["motor_command"] == pytest.approx([math.sqrt(share)] * 4)
    assert outputs["collective_n"] == pytest.approx([TABLE["MASS"] * GRAVITY])
    assert outputs["saturated"] == [0.0]
    assert outputs["cos_tilt"] == [1.0]


def test_step_disarmed_gives_no_command_and_no_integral():
    memory = list(law.initial_memory((0.0, 0.0, -1.0)))
    memory[law.RATE_INTEGRAL] = [1.0, 2.0, 3.0]
    outputs = law.step(FLOAT, _hover_inputs(memory=memory, armed=(0.0,), gyro=(1.0, 2.0, 3.0)))
    assert outputs["motor_command"] == [0.0] * 4
    assert outputs["memory"][law.RATE_INTEGRAL] == [0.0] * 3
    assert outputs["memory"][law.LAST_COMMAND] == [0.0] * 4
    assert outputs["saturated"] == [0.0]


def test_step_with_a_lasting_rate_error_keeps_the_integral_within_its_limit():
    inputs = _hover_inputs(gyro=(-5.0, 5.0, 0.0))
    for _ in range(1000):
        inputs["memory"] = law.step(FLOAT, inputs)["memory"]
    integral = inputs["memory"][law.RATE_INTEGRAL]
    assert np.abs(integral[:2]) == pytest.approx(law.integral_limit(PARAMETERS)[:2])


def test_step_without_a_new_pose_ignores_the_pose():
    one, other = (
        law.step(FLOAT, _hover_inputs(mocap_p=p, mocap_q=q))
        for p, q in (((0.0,) * 3, (1.0, 0.0, 0.0, 0.0)), ((9.0, 9.0, 9.0), (0.5, 0.5, 0.5, 0.5)))
    )
    assert one == other
    with_pose = law.step(FLOAT, _hover_inputs(mocap_new=(1.0,), mocap_p=(0.1, 0.0, -1.0)))
    assert with_pose["memory"][law.EST_P] == pytest.approx([0.1 * TABLE["EST_POS"] * 0.01, 0.0, -1.0])


def test_step_bounds_the_gyro_bias():
    memory = list(law.initial_memory())
    memory[law.EST_BIAS] = [5.0, -5.0, 0.0]
    bias = law.step(FLOAT, _hover_inputs(memory=memory))["memory"][law.EST_BIAS]
    assert bias == [TABLE["EST_BIAS_MAX"], -TABLE["EST_BIAS_MAX"], 0.0]


def test_step_with_prediction_time_takes_poses_to_be_older():
    memory = list(law.initial_memory((0.0, 0.0, -1.0)))
    memory[law.EST_V] = [2.0, 0.0, 0.0]
    pose = {"memory": memory, "mocap_new": (1.0,), "mocap_p": (0.0, 0.0, -1.0)}
    block = list(NEUTRAL)
    block[PREDICTION_TIME] = 0.015
    predicted = law.step(FLOAT, _hover_inputs(**pose, mocap_age_s=(0.005,), feedforward=block))
    stated = law.step(FLOAT, _hover_inputs(**pose, mocap_age_s=(0.020,)))
    assert predicted["memory"][:10] == pytest.approx(stated["memory"][:10], abs=1e-15)


def test_step_with_gain_asks_the_rotors_for_that_much_less():
    block = list(NEUTRAL)
    block[GAIN] = 1.25
    outputs = law.step(FLOAT, _hover_inputs(feedforward=block))
    curve = (TABLE["THRUST_MAX"], TABLE["THRUST_C1"], TABLE["THRUST_C2"])
    thrust = sum(command_to_thrust(u, *curve) for u in outputs["motor_command"])
    assert 1.25 * thrust == pytest.approx(outputs["collective_n"][0]) == TABLE["MASS"] * GRAVITY


def test_step_sums_what_acted_over_the_interval():
    """The command of a tick counts in the next one; gyro and specific force count as sampled."""
    inputs = _hover_inputs(gyro=(0.5, -0.25, 0.125), specific_force=(1.0, 2.0, -9.0))
    commands = []
    for _ in range(5):
        outputs = law.step(FLOAT, inputs)
        inputs["memory"] = outputs["memory"]
        commands.append(outputs["motor_command"])
    memory = inputs["memory"]
    assert memory[law.MOTOR_SUM] == pytest.approx(65536 * np.sum(commands[:4], axis=0))
    assert memory[law.GYRO_SUM] == pytest.approx([5 * 4096 * g for g in (0.5, -0.25, 0.125)])
    assert memory[law.FORCE_SUM] == pytest.approx([5 * 1024 * f for f in (1.0, 2.0, -9.0)])
    assert memory[law.LAST_COMMAND] == commands[-1]


def test_step_in_a_turned_world_gives_the_same_commands(random_steps):
    """Yaw equivariance of estimator, reference, feed-forward and controller, saturated states included."""
    lanes = 10_000
    inputs = random_steps(7, lanes)
    rng = np.random.default_rng(8)
    angle = rng.uniform(-3, 3, lanes)
    c, s = np.cos(angle), np.sin(angle)
    half = (np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2))

    def turn(rows):
        x, y, z = rows
        return np.array([c * x - s * y, s * x + c * y, z])

    def turn_all(rows):
        return np.vstack([turn(rows[k : k + 3]) for k in range(0, len(rows), 3)])

    turned = {name: np.array(block) for name, block in inputs.items()}
    memory = turned["memory"]
    memory[0:6] = turn_all(memory[0:6])
    memory[law.OBSERVER] = turn(memory[law.OBSERVER])
    memory[law.EST_Q] = quat_multiply(half, tuple(memory[law.EST_Q]))
    turned["mocap_p"], turned["ff_accel_ned"] = turn(inputs["mocap_p"]), turn(inputs["ff_accel_ned"])
    turned["ff_jerk_ned"] = turn(inputs["ff_jerk_ned"])
    turned["mocap_q"] = np.array(quat_multiply(half, inputs["mocap_q"]))
    turned["piece"][1:] = turn_all(inputs["piece"][1:])
    turned["yaw_piece"][1] += angle
    turned["offboard"][6:10] = quat_multiply(half, inputs["offboard"][6:10])
    for vector in (BIAS, WIND):
        turned["feedforward"][vector] = turn(inputs["feedforward"][vector])

    one, other = (law.step(NUMPY, {k: list(v) for k, v in x.items()}) for x in (inputs, turned))
    for name in ("motor_command", "collective_n", "torque", "rate_cmd", "cos_tilt", "saturated"):
        scale = np.maximum(1.0, np.abs(np.array(one[name])).max(axis=0))
        assert (np.abs(np.array(one[name]) - np.array(other[name])) / scale).max() < 1e-9, name
    assert np.allclose(other["memory"][0:6], turn_all(np.array(one["memory"][0:6])), atol=1e-9)
    observed = np.array(one["memory"])[law.OBSERVER]
    assert np.allclose(np.array(other["memory"])[law.OBSERVER], turn(observed), atol=1e-9)
    assert (np.linalg.norm(observed, axis=0) > 0.999 * DISTURBANCE_MAX).mean() > 0.1  # bounds are in it
    assert np.allclose(other["memory"][10:19], one["memory"][10:19], atol=1e-9)
    assert np.allclose(quat_multiply(half, one["memory"][law.EST_Q]), other["memory"][law.EST_Q], atol=1e-12)


def test_parameter_vector_without_a_name_raises_key_error():
    with pytest.raises(KeyError, match="MASS"):
        law.parameter_vector({name: value for name, value in TABLE.items() if name != "MASS"})


class _Flight:
    """The law flying paper equation 1 with rotor lag, from 0.2 m off a 2 m circle, poses 12 ms late."""

    LAG_S, AGE, RADIUS, PACE = 0.033, 12, 2.0, 1.5

    def __init__(self, drag=0.0, feedforward=NEUTRAL, observer=0.0):
        self.drag, self.feedforward = drag, feedforward
        self.parameters = law.parameter_vector({**TABLE, "OBS_GAIN": observer})
        node = self.node(0.0)
        self.p, self.v = np.add(node[0:3], (0.2, -0.2, 0.1)), np.array(node[3:6])
        self.q, self.rate = (1.0, 0.0, 0.0, 0.0), np.zeros(3)
        self.thrust = np.full(4, TABLE["MASS"] * GRAVITY / 4)
        self.memory = law.initial_memory(tuple(self.p), self.q)
        self.poses = []

    def node(self, t):
        r, w = self.RADIUS, self.PACE
        c, s = math.cos(w * t), math.sin(w * t)
        p, v = (r * c, r * s, -1.0), (-r * w * s, r * w * c, 0.0)
        return (*p, *v, *(-w * w * x for x in (p[0], p[1], 0.0)), *(-w * w * x for x in v))

    def tick(self, k):
        """Position error after tick k of 1 ms."""
        t, body = k * 1e-3, law.body(PARAMETERS)
        R = quat_to_matrix(FLOAT, self.q)
        drag = -self.drag * np.array(mat_t_vec(R, tuple(self.v)))
        force = np.array([0.0, 0.0, -self.thrust.sum() / body.mass_kg]) + drag
        self.poses.append((tuple(self.p), self.q))
        start = k // 100 * 0.1
        late = self.poses[max(0, len(self.poses) - 1 - self.AGE)]
        outputs = law.step(FLOAT, {
            **_hover_inputs(memory=self.memory, gyro=self.rate, specific_force=force),
            "mocap_new": (float(k % 10 == 0),), "mocap_p": late[0], "mocap_q": late[1],
            "mocap_age_s": (self.AGE * 1e-3,),
            "piece": (t - start, *septic_coefficients(0.1, self.node(start), self.node(start + 0.1))),
            "offboard": law.NO_OFFBOARD, "feedforward": self.feedforward, "parameters": self.parameters,
        })  # fmt: skip
        self.memory = outputs["memory"]
        curve = (TABLE["THRUST_MAX"], TABLE["THRUST_C1"], TABLE["THRUST_C2"])
        asked = np.array([command_to_thrust(u, *curve) for u in outputs["motor_command"]])
        self.thrust = self.thrust + (asked - self.thrust) * (1e-3 / self.LAG_S)
        torque = (MATRIX @ self.thrust)[1:]
        J = np.array(body.inertia)
        self.rate = self.rate + 1e-3 * (torque - np.cross(self.rate, J * self.rate)) / J
        self.q = quat_normalize(FLOAT, quat_multiply(self.q, quat_exp(FLOAT, tuple(1e-3 * self.rate))))
        self.v = self.v + 1e-3 * np.add(mat_vec(R, force), (0.0, 0.0, GRAVITY))
        self.p = self.p + 1e-3 * self.v
        return math.dist(self.p, self.node(t + 1e-3)[0:3])

    def worst_of_last_second(self, seconds=3):
        errors = [self.tick(k) for k in range(1000 * seconds)]
        return max(errors[-1000:])


def test_closed_loop_on_the_nominal_vehicle_follows_a_circle():
    """3 m/s on a 2 m circle, 25 degrees of tilt, through rotor lag and late poses."""
    assert _Flight().worst_of_last_second() < 0.06


def test_closed_loop_with_drag_follows_better_with_its_feedforward():
    block = list(NEUTRAL)
    block[4:7] = [0.4, 0.4, 0.4]
    without, fed = _Flight(drag=0.4), _Flight(drag=0.4, feedforward=block)
    assert fed.worst_of_last_second() < 0.06 < 0.15 < without.worst_of_last_second()


def test_closed_loop_with_drag_follows_better_with_its_observer():
    """At 1.5 rad/s, with 5 rad/s of bandwidth, 0.3 of a drag is left; without a disturbance none is seen."""
    without, observed = _Flight(drag=0.4), _Flight(drag=0.4, observer=5.0)
    assert observed.worst_of_last_second() < 0.5 * without.worst_of_last_second()
    seen = np.array(observed.memory[law.OBSERVER])
    drag = -0.4 * observed.v
    assert math.dist(seen, drag) < 0.4 * np.linalg.norm(drag)
    still = _Flight(observer=5.0)
    still.worst_of_last_second()
    assert np.abs(still.memory[law.OBSERVER]).max() < 0.1


def test_closed_loop_observer_sees_only_what_the_feedforward_leaves():
    """Neural DO of paper section VI-D: of a drag of 0.4 1/s, 0.3 is fed forward; the observer gets 0.1."""
    block = list(NEUTRAL)
    block[4:7] = [0.3, 0.3, 0.3]
    both = _Flight(drag=0.4, feedforward=block, observer=5.0)
    fed, observed = _Flight(drag=0.4, feedforward=block), _Flight(drag=0.4, observer=5.0)
    worst = both.worst_of_last_second()
    assert worst < 0.8 * min(fed.worst_of_last_second(), observed.worst_of_last_second())
    seen = np.array(both.memory[law.OBSERVER])
    assert math.dist(seen, -0.1 * both.v) < 0.06 * np.linalg.norm(both.v)


def test_observer_takes_the_attitude_offset_for_misalignment_and_not_for_a_disturbance():
    roll, pitch = 0.02, -0.03
    q = quat_from_euler(FLOAT, roll, pitch, 0.0)  # what the poses show while thrust points straight up
    memory = list(law.initial_memory((0.0, 0.0, -1.0), q))
    memory[law.OBSERVER_THRUST] = [TABLE["MASS"] * GRAVITY]
    block = list(NEUTRAL)
    parameters = law.parameter_vector({**TABLE, "OBS_GAIN": 50.0})
    force = mat_t_vec(quat_to_matrix(FLOAT, q), (0.0, 0.0, -GRAVITY))  # leaves the estimated velocity at rest

    def observed():
        inputs = _hover_inputs(memory=memory, parameters=parameters, feedforward=block, specific_force=force)
        return law.step(FLOAT, inputs)["memory"][law.OBSERVER]

    assert math.hypot(*observed()[:2]) > 0.01
    block[ATTITUDE_OFFSET] = (roll, pitch)
    assert math.hypot(*observed()[:2]) < 0.001


def test_step_without_observer_gain_is_the_same_whether_it_observes_or_not(random_steps):
    """Bit for bit: all outputs, with the estimate at 0 as it is then."""
    inputs = random_steps(11, 2_000)
    inputs["parameters"][law.PARAMETERS.index("OBS_GAIN")] = 0.0
    inputs["memory"][law.OBSERVER] = 0.0
    inputs["observing"][:] = 1.0
    observing = law.step(NUMPY, {k: list(v) for k, v in inputs.items()})
    inputs["observing"][:] = 0.0
    inputs["memory"][law.OBSERVER_THRUST] = 0.0
    off = law.step(NUMPY, {k: list(v) for k, v in inputs.items()})
    for name, values in off.items():
        rows = len(values) if name != "memory" else law.OBSERVER_THRUST.start
        for one, other in zip(values[:rows], observing[name][:rows], strict=True):
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(np.array(off["memory"][law.OBSERVER]), 0.0)


def test_step_where_it_does_not_observe_keeps_and_uses_the_estimate_until_disarmed():
    memory = list(law.initial_memory((0.0, 0.0, -1.0)))
    memory[law.OBSERVER] = [0.0, 0.0, 0.5]
    parameters = law.parameter_vector({**TABLE, "OBS_GAIN": 5.0})
    kept = law.step(FLOAT, _hover_inputs(memory=memory, observing=(0.0,), parameters=parameters))
    assert kept["memory"][law.OBSERVER] == [0.0, 0.0, 0.5]
    assert kept["collective_n"] == pytest.approx([TABLE["MASS"] * (GRAVITY + 0.5)])
    disarmed = law.step(FLOAT, _hover_inputs(memory=memory, armed=(0.0,), parameters=parameters))
    assert disarmed["memory"][law.OBSERVER] == [0.0] * 3
    assert disarmed["memory"][law.OBSERVER_THRUST] == [0.0]


def test_closed_loop_reference_is_what_flatness_says(random_steps):
    """The outputs' reference block is the septic and cubic at that time, as the flatness map takes it."""
    flight = _Flight()
    piece = (0.03, *septic_coefficients(0.1, flight.node(0.0), flight.node(0.1)))
    outputs = law.step(FLOAT, _hover_inputs(piece=piece))
    expected = flight.node(0.03)
    assert outputs["reference"][:9] == pytest.approx(expected[:9], abs=1e-6)
    R, _ = flat_attitude(FLOAT, outputs["reference"][6:9], 0.0)
    assert R[8] < 1.0
