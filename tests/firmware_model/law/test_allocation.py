"""Allocation: exact while nothing saturates, and what is given up first where something does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from trimtab.firmware_model.law.allocation import (
    allocate,
    allocation_matrix,
    allocation_table,
    command_to_thrust,
    invert4,
    thrust_to_command,
)
from trimtab.firmware_model.law.ops import FLOAT

LOW, HIGH = 0.05, 8.5
SPINS = (1, 1, -1, -1)
RESEARCH = ((0.088, 0.088), (-0.088, -0.088), (0.088, -0.088), (-0.088, 0.088))
LOPSIDED = ((0.10, 0.09), (-0.08, -0.09), (0.11, -0.08), (-0.07, 0.085))
MATRIX = allocation_matrix(RESEARCH, SPINS, 0.022)
INVERSE = invert4(MATRIX)

demand = st.tuples(st.floats(-10.0, 50.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.8, 0.8))


def _allocate(wanted, inverse=INVERSE):
    thrust, flag = allocate(FLOAT, allocation_table(inverse), wanted[0], wanted[1:], LOW, HIGH)
    return np.array(thrust), flag


def _achieved(thrust, matrix=MATRIX):
    return np.array(matrix).reshape(4, 4) @ thrust


def test_allocation_matrix_follows_the_stated_signs():
    """More thrust front right: rolls left (tau_x < 0), pitches up (tau_y > 0); ccw rotors yaw right."""
    T, tau_x, tau_y, tau_z = _achieved(np.array([1.0, 0.0, 0.0, 0.0]))
    assert (T, tau_x, tau_y, tau_z) == pytest.approx((1.0, -0.088, 0.088, 0.022))


@pytest.mark.parametrize("positions", [RESEARCH, LOPSIDED])
def test_invert4_agrees_with_numpy(positions):
    matrix = allocation_matrix(positions, SPINS, 0.022)
    assert np.allclose(np.reshape(invert4(matrix), (4, 4)), np.linalg.inv(np.reshape(matrix, (4, 4))))


def test_invert4_of_rotors_in_a_row_raises_value_error():
    row = ((0.1, 0.0), (-0.1, 0.0), (0.2, 0.0), (-0.2, 0.0))
    with pytest.raises(ValueError, match="singular"):
        invert4(allocation_matrix(row, SPINS, 0.022))


@pytest.mark.parametrize(
    ("positions", "reach"),
    [(RESEARCH, (LOW + 1e-6, HIGH - 1e-6)), (LOPSIDED, (2.0, 6.0))],  # lopsided: not up to the last corner
)
@given(share=st.tuples(*(st.floats(0.0, 1.0),) * 4))
def test_allocate_of_a_feasible_demand_is_exact(positions, reach, share):
    thrust = reach[0] + np.array(share) * (reach[1] - reach[0])
    matrix = allocation_matrix(positions, SPINS, 0.022)
    found, flag = _allocate(_achieved(thrust, matrix), invert4(matrix))
    assert found == pytest.approx(thrust, abs=1e-9)
    assert flag == 0.0


@pytest.mark.parametrize("positions", [RESEARCH, LOPSIDED])
@given(wanted=demand)
def test_allocate_of_any_demand_stays_within_the_rotors_range(positions, wanted):
    inverse = invert4(allocation_matrix(positions, SPINS, 0.022))
    thrust, flag = _allocate(wanted, inverse)
    assert ((thrust >= LOW) & (thrust <= HIGH)).all()
    achieved = np.reshape(allocation_matrix(positions, SPINS, 0.022), (4, 4)) @ thrust
    if flag == 0.0:
        assert np.allclose(achieved, wanted, atol=1e-6)
    else:
        assert not np.allclose(achieved, wanted, rtol=1e-12, atol=1e-12)


@settings(max_examples=60)
@given(demand)
def test_allocate_gives_up_yaw_then_collective_then_roll_and_pitch(wanted):
    """Against linear programs: roll and pitch as whole as can be, then collective near, then yaw."""
    thrust, _ = _allocate(wanted)
    inverse = np.reshape(INVERSE, (4, 4))
    tilt, yaw = inverse[:, 1:3] @ wanted[1:3], inverse[:, 3] * wanted[3]

    def best(objective, fixed):
        """Least objective over (tilt share, collective, yaw share, distance), each within its bounds."""
        rows = np.column_stack([tilt, inverse[:, 0], yaw, np.zeros(4)])
        distance = np.array([[0.0, 1.0, 0.0, -1.0], [0.0, -1.0, 0.0, -1.0]])
        bounds = [(0.0, 1.0), (None, None), (0.0, 1.0), (0.0, None)]
        for k, value in fixed.items():
            bounds[k] = (value - 1e-9, value + 1e-9)
        found = linprog(
            objective,
            A_ub=np.vstack([rows, -rows, distance]),
            b_ub=np.concatenate([np.full(4, HIGH), np.full(4, -LOW), [wanted[0], -wanted[0]]]),
            bounds=bounds,
        )
        assert found.status == 0
        return found.x

    share = best([-1, 0, 0, 0], {2: 0.0})[0]  # of roll and pitch, without the help of any yaw
    collective = best([0, 0, 0, 1], {0: share})[1]
    part = best([0, 0, -1, 0], {0: share, 1: collective})[2]
    expected = (collective, share * wanted[1], share * wanted[2], part * wanted[3])
    assert _achieved(thrust) == pytest.approx(expected, abs=1e-5)


def test_allocate_with_little_thrust_keeps_roll_by_adding_thrust():
    thrust, flag = _allocate((0.0, 0.5, 0.0, 0.0))
    assert _achieved(thrust)[1] == pytest.approx(0.5)
    assert thrust.min() == pytest.approx(LOW)
    assert flag == 1.0


@pytest.mark.parametrize("curve", [(0.0, 1.0), (1.0, 0.0), (0.2, 0.8), (0.47, 0.53)])
@given(command=st.floats(0.0, 1.0))
def test_thrust_to_command_undoes_command_to_thrust(curve, command):
    thrust = command_to_thrust(command, HIGH, *curve)
    assert thrust_to_command(FLOAT, thrust, HIGH, *curve) == pytest.approx(command, abs=1e-7)


@pytest.mark.parametrize(("thrust", "command"), [(-1.0, 0.0), (0.0, 0.0), (HIGH, 1.0), (2 * HIGH, 1.0)])
def test_thrust_to_command_beyond_the_range_is_clipped(thrust, command):
    assert thrust_to_command(FLOAT, thrust, HIGH, 0.0, 1.0) == command
