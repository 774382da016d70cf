"""The L1-adaptive estimate on signals whose disturbance is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from trimtab.host.control.adaptation import Adaptation

STEP_S = 0.025
DISTURBANCE = np.array([0.7, -0.4, 0.2])


def _after(steps: int, *, predictor: float = 5.0, bandwidth: float = 8.0) -> list[np.ndarray]:
    """Estimates of a constant disturbance under a model acceleration that varies."""
    v = np.array([1.0, 2.0, -0.5])
    state, estimates = Adaptation.at(v, predictor, bandwidth), []
    for k in range(steps):
        gained = STEP_S * np.array([math.sin(k), math.cos(2 * k), 0.3])
        later = v + gained + STEP_S * DISTURBANCE
        state = state.after(STEP_S, gained, v, later)
        estimates.append(state.w_ned)
        v = later
    return estimates


@pytest.mark.parametrize("predictor", [0.5, 5.0, 40.0])
def test_constant_disturbance_is_estimated_without_error(predictor: float) -> None:
    np.testing.assert_allclose(_after(400, predictor=predictor)[-1], DISTURBANCE, rtol=1e-9)


def test_estimate_rises_as_the_low_pass_filter() -> None:
    # The adaptation sees a new disturbance after one step; from there the filter alone delays it.
    estimates = _after(40, bandwidth=4.0)
    expected = [1.0 - math.exp(-4.0 * STEP_S * (k + 1)) for k in range(40)]
    np.testing.assert_allclose([w[0] / DISTURBANCE[0] for w in estimates], expected, atol=0.02)


def test_without_disturbance_the_estimate_stays_zero() -> None:
    state = Adaptation.at(np.zeros(3), 5.0, 8.0)
    v = np.zeros(3)
    for _ in range(10):
        gained = np.array([0.1, 0.0, -0.2])
        state = state.after(STEP_S, gained, v, v + gained)
        v = v + gained
    np.testing.assert_allclose(state.w_ned, 0.0, atol=1e-13)
