"""One source, three number types: floats, CasADi and numpy lanes agree to 1e-12 of the result's scale."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.firmware_model.law import (
    allocation,
    dfbc,
    estimator,
    feedforward,
    flatness,
    reference,
    rotations,
)
from trimtab.firmware_model.law import step as law
from trimtab.protocol.parameters import DEFAULTS

LANES = 10_000
PARAMETERS = law.parameter_vector(DEFAULTS)
NETWORK = (8, 8)
REGION = (6.0, 1.2, 7.0, 12.0)


def _attitude(ops, rpy):
    return rotations.euler_to_matrix(ops, rpy)


def _predict(ops, p, v, q, bias, gyro, force):
    est, rate, a, R = estimator.predict(ops, estimator.Estimate(p, v, q, bias), gyro, force, 0.001)
    return [*est, list(rate), list(a), list(R)]


def _correct(ops, p, v, q, bias, rate, a, p_meas, q_meas, times):
    gains = law.estimator_gains(PARAMETERS)
    est = estimator.Estimate(p, v, q, bias)
    return list(estimator.correct(ops, est, rate, a, p_meas, q_meas, times[0], times[1], gains))


def _control(ops, p, v, rpy, rate, filtered, integral, flat, yaw, ff):
    ref = dfbc.FlatState(flat[0:3], flat[3:6], flat[6:9], flat[9:12], yaw[0], yaw[1])
    return dfbc.control(
        ops, law.gains(PARAMETERS), law.body(PARAMETERS), p, v, _attitude(ops, rpy), rate, filtered, integral,
        ref, ff[0:3], (1.0, 0.5), ff[3:6], ff[6:8],
    )  # fmt: skip


# name: (function of ops and blocks, sizes of the blocks, half-width of each; "q": unit quaternions)
PIECES = {
    "quat_to_matrix": (rotations.quat_to_matrix, ("q",)),
    "quat_multiply": (lambda ops, q, r: rotations.quat_multiply(q, r), ("q", "q")),
    "quat_normalize": (rotations.quat_normalize, ((4, 3.0),)),
    "quat_exp": (rotations.quat_exp, ((3, 4.0),)),
    "quat_exp_small": (rotations.quat_exp, ((3, 1e-4),)),
    "quat_from_euler": (lambda ops, e: rotations.quat_from_euler(ops, *e), ((3, 7.0),)),
    "matrix_to_euler": (lambda ops, e: rotations.matrix_to_euler(ops, _attitude(ops, e)), ((3, 1.5),)),
    "euler_rates": (rotations.euler_rates, ((3, 1.4), (3, 10.0))),
    "attitude_error": (
        lambda ops, a, b: rotations.attitude_error(_attitude(ops, a), _attitude(ops, b)),
        ((3, 3.0), (3, 3.0)),
    ),
    "septic": (
        lambda ops, s, a, b: reference.septic(0.1, 0.05 + 0.05 * s[0], a, b),
        ((1, 1.0), (12, 5.0), (12, 5.0)),
    ),
    "hermite_yaw": (
        lambda ops, s, y: reference.hermite_yaw(0.1, 0.05 + 0.05 * s[0], *y),
        ((1, 1.0), (4, 5.0)),
    ),
    "flat_attitude": (lambda ops, a, y: flatness.flat_attitude(ops, a, y[0]), ((3, 8.0), (1, 7.0))),
    "flat_rates": (
        lambda ops, a, j, y: flatness.flat_rates(ops, a, j, *y),
        ((3, 8.0), (3, 50.0), (2, 5.0)),
    ),
    "flat_full": (
        lambda ops, a, j, s, y: flatness.flat_full(ops, a, j, s, y[0], y[1], law.body(PARAMETERS), y[2]),
        ((3, 8.0), (3, 50.0), (3, 300.0), (3, 5.0)),
    ),
    "predict": (_predict, ((3, 5.0), (3, 9.0), "q", (3, 0.1), (3, 9.0), (3, 30.0))),
    "correct": (
        _correct,
        ((3, 5.0), (3, 9.0), "q", (3, 0.1), (3, 9.0), (3, 30.0), (3, 5.0), "q", (2, 0.06)),
    ),
    "control": (
        _control,
        ((3, 3.0), (3, 6.0), (3, 1.2), (3, 9.0), (3, 9.0), (3, 8.0), (12, 6.0), (2, 4.0), (8, 0.5)),
    ),
    "motors": (
        lambda ops, T, tau: law.motors(ops, PARAMETERS, 15.0 + T[0], tau, 1.1)[:2],
        ((1, 30.0), (3, 2.0)),
    ),
    "command_to_thrust": (lambda ops, u: [allocation.command_to_thrust(u[0], 8.5, 0.2, 0.8)], ((1, 1.0),)),
    "feedforward": (
        lambda ops, b, v, e: feedforward.specific_force_ned(ops, b, v, _attitude(ops, e)),
        ((feedforward.FF_SIZE, 0.5), (3, 9.0), (3, 3.0)),
    ),
    "feedforward_rate": (
        lambda ops, b, v, a, w, e: feedforward.specific_force_rate_ned(ops, b, v, a, w, _attitude(ops, e)),
        ((feedforward.FF_SIZE, 0.5), (3, 9.0), (3, 9.0), (3, 6.0), (3, 3.0)),
    ),
    "fade_weight": (
        lambda ops, v, e, t: [feedforward.fade_weight(ops, REGION, v, _attitude(ops, e), 9.8 + t[0])],
        ((3, 9.0), (3, 3.0), (1, 5.0)),
    ),
    "network": (
        lambda ops, w, v, e: feedforward.network(ops, w, NETWORK, v, e),
        ((feedforward.weight_count(NETWORK), 1.0), (3, 9.0), (3, 1.0)),
    ),
}


@pytest.mark.parametrize("name", PIECES)
def test_piece_on_random_values_agrees_in_every_number_type(name, assert_alike, unit):
    fn, blocks = PIECES[name]
    rng = np.random.default_rng(sum(name.encode()))
    columns = [
        unit(rng, 4, LANES) if block == "q" else rng.uniform(-block[1], block[1], (block[0], LANES))
        for block in blocks
    ]
    assert_alike(fn, columns)


def test_step_on_random_states_agrees_in_every_number_type(assert_alike, random_steps):
    inputs = random_steps(1, LANES)
    names = [block.name for block in law.INPUTS]

    def fn(ops, *blocks):
        outputs = law.step(ops, dict(zip(names, blocks, strict=True)))
        assert [(block.name, block.size) for block in law.OUTPUTS] == [
            (k, len(v)) for k, v in outputs.items()
        ]
        # The memory's parts are each of their own scale.
        memory = [list(outputs["memory"][part]) for part in law.MEMORY.values()]
        return memory + [list(outputs[block.name]) for block in law.OUTPUTS[1:]]

    assert_alike(fn, [inputs[name] for name in names])


def test_step_on_random_states_saturates_often(random_steps):
    from trimtab.host.codegen.ops import NUMPY

    inputs = random_steps(1, 2_000)
    outputs = law.step(NUMPY, {name: list(block) for name, block in inputs.items()})
    saturated = np.asarray(outputs["saturated"][0])
    assert 0.2 < saturated.mean() < 0.8
    assert np.min(outputs["motor_command"]) == 0.0
    assert np.max(outputs["motor_command"]) == 1.0
