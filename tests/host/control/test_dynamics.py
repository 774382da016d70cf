"""The prediction model against the vehicle that it stands for."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.host.control.examples import DRAG, EFFECTS, NETWORK, VEHICLE, drag_model
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.base.errors import UsageError
from trimtab.host.control.dynamics import ControlModel, rate_lag_s

MODEL = ControlModel.of(VEHICLE, None, drag_model(NETWORK), EFFECTS)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rate_lag_is_the_mean_delay_of_the_loop_behind_its_motors(axis: int) -> None:
    # A step of the command through gains, rate filter and motors, without integral: the area between command
    # and body rate is the mean delay of the response, whatever its shape.
    gains, dt_s = VEHICLE.gains, 1e-5
    p, d = gains.rate_p[axis], gains.rate_d[axis]
    corner = 2.0 * np.pi * gains.rate_filter_hz
    rate = filtered = accel = area = 0.0
    for _ in range(200_000):
        command = p * (1.0 - rate) - d * corner * (rate - filtered)
        area += dt_s * (1.0 - rate)
        rate, filtered, accel = (
            rate + dt_s * accel,
            filtered + dt_s * corner * (rate - filtered),
            accel + dt_s * (command - accel) / VEHICLE.motor_lag_s,
        )
    assert area == pytest.approx(rate_lag_s(VEHICLE)[axis], rel=0.01)


def test_residual_is_the_difference_from_the_nominal_vehicle() -> None:
    x, u, p, d = ca.SX.sym("x", 13), ca.SX.sym("u", 4), ca.SX.sym("p", len(MODEL.parameters)), ca.SX(3, 1)
    nominal = ControlModel.of(VEHICLE)
    slope = ca.Function("f", [x, u, p], [MODEL.derivative(x, u, p, d)])
    plain = ca.Function("g", [x, u], [nominal.derivative(x, u, ca.SX(3, 1), d)])
    residual = ca.Function("r", [x, p], [MODEL.residual(x, p)])
    at = np.array([0.1, 0.2, -1.0, 2.0, -1.0, 0.5, 0.2, -0.3, 0.8, 0.4, 0.3, -0.2, 9.0])
    inputs, values = np.array([0.5, -0.2, 0.1, 8.0]), MODEL.parameters
    values[:3] = (0.3, -0.1, 0.2)
    change = np.array(slope(at, inputs, values) - plain(at, inputs)).ravel()
    np.testing.assert_allclose(change[3:6], np.array(residual(at, values)).ravel(), atol=1e-12)
    np.testing.assert_allclose(np.delete(change, [3, 4, 5]), 0.0, atol=1e-12)
    assert np.linalg.norm(change[3:6] - values[:3]) == pytest.approx(
        np.linalg.norm(np.array(DRAG) * _frd(at)), rel=1e-9
    )


def _frd(x: np.ndarray) -> np.ndarray:
    """Velocity (3,) of a state in the body frame."""
    return Rotation.from_euler("ZYX", x[8:5:-1]).inv().apply(x[3:6])


def test_input_bounds_are_what_the_firmware_executes() -> None:
    low, high = MODEL.input_bounds()
    np.testing.assert_allclose(high, [6.0, 6.0, 3.0, 4.0 * 8.5])
    np.testing.assert_allclose(low, [-6.0, -6.0, -3.0, 0.2 * 0.752 * GRAVITY])


def test_vehicle_without_rate_gain_needs_a_stated_lag() -> None:
    gains = {**VEHICLE.gains.model_dump(), "rate_p": (30.0, 0.0, 14.0)}
    vehicle = VEHICLE.replace(gains=gains)
    with pytest.raises(UsageError, match="rate_lag_s"):
        ControlModel.of(vehicle)
    assert ControlModel.of(vehicle, (0.03, 0.03, 0.07)).rate_lag_s == (0.03, 0.03, 0.07)
