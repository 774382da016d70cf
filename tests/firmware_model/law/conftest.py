"""Shared by the tests of the law: one function evaluated on floats, CasADi symbols and numpy lanes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from trimtab.firmware_model.law import feedforward
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.reference import cubic_coefficients, septic_coefficients
from trimtab.host.codegen.ops import CASADI, NUMPY
from trimtab.protocol.parameters import DEFAULTS


def _flatten(values):
    flat = []
    for value in values if isinstance(values, tuple | list) else (values,):
        flat.extend(_flatten(value) if isinstance(value, tuple | list) else (value,))
    return flat


def _evaluate_three_ways(fn, columns):
    """Results (outputs, lanes) of fn(ops, *blocks) on floats, CasADi, numpy; a block is (size, lanes)."""
    lanes = columns[0].shape[1]
    symbols = [ca.SX.sym(f"x{k}", column.shape[0]) for k, column in enumerate(columns)]
    expressions = _flatten(fn(CASADI, *([s[i] for i in range(s.shape[0])] for s in symbols)))
    function = ca.Function("f", symbols, [ca.vertcat(*expressions)])
    symbolic = np.array(function(*columns))
    by_lane = [column.T.tolist() for column in columns]
    floats = np.array([_flatten(fn(FLOAT, *(block[k] for block in by_lane))) for k in range(lanes)]).T
    numpy_lanes = np.array([np.broadcast_to(x, lanes) for x in _flatten(fn(NUMPY, *map(list, columns)))])
    return floats, symbolic, numpy_lanes


def _blocks(result):
    """Rows of each vector in a result of vectors and scalars, or all rows of one vector."""
    if not any(isinstance(part, tuple | list) for part in result):
        return [slice(0, len(result))]
    ends = np.cumsum([len(_flatten(part)) for part in result])
    return [slice(int(end) - len(_flatten(part)), int(end)) for part, end in zip(result, ends, strict=True)]


def _assert_alike(fn, columns, tolerance=1e-12):
    floats, symbolic, lanes = _evaluate_three_ways(fn, columns)
    assert np.isfinite(floats).all()
    for block in _blocks(fn(FLOAT, *(column[:, 0].tolist() for column in columns))):
        scale = np.maximum(1.0, np.abs(floats[block]).max(axis=0))
        assert (np.abs(symbolic[block] - floats[block]) / scale).max() <= tolerance, block
        assert (np.abs(lanes[block] - floats[block]) / scale).max() <= tolerance, block


@pytest.fixture
def assert_alike():
    """assert_alike(fn, columns): floats, CasADi and numpy give the same, vector by vector, lane by lane."""
    return _assert_alike


def _unit(rng, size, lanes):
    x = rng.normal(size=(size, lanes))
    return x / np.linalg.norm(x, axis=0)


_REGIONS = ((2.0, 15.0), (0.3, 2.0), (0.0, 8.0), (12.0, 40.0))
"""Ranges of the bounds of the region; many random states are beyond them."""


def _random_steps(seed, lanes):
    """Inputs of the step by block name, arrays (size, lanes): half near a reference, half anywhere."""
    rng = np.random.default_rng(seed)
    wild = np.where(np.arange(lanes) % 2, 1.0, 0.02)

    def normal(size, sigma):
        return rng.normal(size=(size, lanes)) * sigma * wild

    p0, dt = rng.uniform(-5, 5, (3, lanes)), rng.uniform(0.05, 0.5, (1, lanes))
    upright = np.vstack([np.ones((1, lanes)), normal(3, 2.0)])
    q = upright / np.linalg.norm(upright, axis=0)
    memory = np.zeros((law.MEMORY_SIZE, lanes))
    memory[law.EST_P] = p0 + normal(3, 2.0)
    memory[law.EST_V] = normal(3, 5.0)
    memory[law.EST_Q] = q
    memory[law.EST_BIAS] = normal(3, 0.1)
    memory[law.RATE_FILTERED] = normal(3, 5.0)
    memory[law.RATE_INTEGRAL] = normal(3, 4.0)
    memory[law.MOTOR_SUM] = rng.uniform(0, 1e6, (4, lanes))
    memory[law.GYRO_SUM] = normal(3, 1e5)
    memory[law.FORCE_SUM] = normal(3, 1e5)
    memory[law.LAST_COMMAND] = rng.uniform(0, 1, (4, lanes))
    nodes = [
        np.vstack([p0 + normal(3, 1.0), normal(3, 5.0), normal(3, 8.0), normal(3, 30.0)]) for _ in range(2)
    ]
    mocap_q = q + normal(4, 0.2)
    block = np.tile(np.array(feedforward.NEUTRAL)[:, None], lanes)
    block[1:12] += rng.uniform(-0.3, 0.5, (11, lanes))
    block[feedforward.GAIN] = rng.uniform(0.8, 1.2, lanes)
    block[feedforward.PREDICTION_TIME] = rng.uniform(0, 0.02, lanes)
    block[feedforward.WIND] = normal(3, 2.0)
    block[feedforward.REGION] = np.vstack([rng.uniform(low, high, lanes) for low, high in _REGIONS])
    table = law.parameter_vector(DEFAULTS)
    parameters = np.tile(np.array(table)[:, None], lanes) * rng.uniform(0.9, 1.1, (1, lanes))
    allocation = slice(law.PARAMETERS.index("ALLOCATION_0"), None)
    parameters[allocation] = np.array(table)[allocation, None]
    memory[law.OBSERVER], memory[law.OBSERVER_THRUST] = normal(3, 3.0), rng.uniform(0, 20, (1, lanes))
    parameters[law.PARAMETERS.index("OBS_GAIN")] = rng.uniform(0, 10, lanes)
    return {
        "memory": memory,
        "gyro": normal(3, 8.0),
        "specific_force": np.array([[0.0], [0.0], [-9.81]]) + normal(3, 10.0),
        "mocap_new": rng.integers(0, 2, (1, lanes)).astype(float),
        "mocap_p": p0 + normal(3, 1.0),
        "mocap_q": mocap_q / np.linalg.norm(mocap_q, axis=0),
        "mocap_age_s": rng.uniform(0, 0.06, (1, lanes)),
        "mocap_interval_s": rng.uniform(0.001, 0.2, (1, lanes)),
        "armed": (rng.uniform(size=(1, lanes)) > 0.1).astype(float),
        "observing": (rng.uniform(size=(1, lanes)) > 0.3).astype(float),
        "feedback_weights": rng.uniform(0, 1, (2, lanes)),
        "piece": np.vstack(
            [dt * rng.uniform(0, 1, (1, lanes)), *septic_coefficients(dt[0], *map(tuple, nodes))]
        ),
        "yaw_piece": np.vstack(
            [dt * rng.uniform(0, 1, (1, lanes)), *cubic_coefficients(dt[0], *normal(4, 2.0))]
        ),
        "offboard": np.vstack(
            [
                (rng.uniform(size=(1, lanes)) > 0.7).astype(float),
                rng.uniform(2.0, 20.0, (1, lanes)),
                normal(3, 3.0),
                rng.integers(0, 2, (1, lanes)).astype(float),
                _unit(rng, 4, lanes),
            ]
        ),
        "feedforward": block,
        "ff_accel_ned": normal(3, 2.0),
        "ff_jerk_ned": normal(3, 5.0),
        "parameters": parameters,
    }


@pytest.fixture
def random_steps():
    """random_steps(seed, lanes): inputs of `step` by block, arrays (size, lanes); many of them saturate."""
    return _random_steps


@pytest.fixture
def unit():
    """unit(rng, size, lanes): random unit vectors, array (size, lanes)."""
    return _unit
