"""Samples on a lattice: gaps stay gaps, peaks stay, attitudes turn the shorter way."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.host.show.lattice import (
    FINEST_US,
    SAMPLES_MAX,
    attitudes,
    encoded,
    euler_deg,
    lattice,
    peaks,
    quaternions,
    sampled,
    step_for,
)


def test_lattice_holds_multiples_of_the_step_within_the_span() -> None:
    assert lattice(-25_000, 31_000, 10_000).tolist() == [-20_000, -10_000, 0, 10_000, 20_000, 30_000]
    assert lattice(5_000, 6_000, 10_000).tolist() == [10_000]  # at least one


def test_step_grows_where_samples_would_be_too_many() -> None:
    assert step_for(30_000_000) == FINEST_US
    total_us = 500_000_000
    assert total_us / step_for(total_us) <= SAMPLES_MAX


def test_gap_of_samples_is_no_line() -> None:
    t_us = np.array([0, 100_000, 500_000, 600_000])
    rows = sampled(np.array([-50_000, 50_000, 100_000, 300_000, 550_000, 700_000]), t_us, np.arange(4.0))
    assert np.isnan(rows[:, 0]).tolist() == [True, False, False, True, False, True]
    assert rows[[1, 4], 0].tolist() == [0.5, 2.5]


def test_peak_between_two_samples_is_kept() -> None:
    t_us = np.arange(0, 100_001, 1_000)
    values = np.zeros(len(t_us))
    values[53] = 7.0
    at_us = lattice(0, 100_000, 20_000)
    assert sampled(at_us, t_us, values).max() == 0.0
    assert peaks(at_us, t_us, values).max() == 7.0


def test_attitude_between_a_quaternion_and_its_negative_is_the_same() -> None:
    q = np.array([[1.0, 0.0, 0.0, 0.0], [-np.cos(0.1), -np.sin(0.1), 0.0, 0.0]])
    (row,) = attitudes(np.array([50_000]), np.array([0, 100_000]), q)
    assert row == pytest.approx([np.cos(0.05), np.sin(0.05), 0.0, 0.0])


def test_angles_are_those_of_scipy_and_turn_back() -> None:
    angles = np.random.default_rng(1).uniform(-1.4, 1.4, (50, 3))
    q = quaternions(angles)
    turned = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    assert Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix() == pytest.approx(turned)
    assert euler_deg(q) == pytest.approx(np.degrees(angles))


def test_encoded_is_little_endian_float32_by_row() -> None:
    values = np.array([[1.5, np.nan], [-2.0, 0.25]])
    back = np.frombuffer(base64.b64decode(encoded(values)), dtype="<f4").reshape(2, 2)
    assert np.array_equal(back, values.astype(np.float32), equal_nan=True)
