"""The residual of the nominal model from means over intervals."""

from __future__ import annotations

import math

import pytest

from trimtab.host.log.residual import NominalResidual
from trimtab.host.vehicle import Vehicle

HOVER = 0.4


def hover_force(vehicle: Vehicle, command: float) -> float:
    """Specific force along z of four rotors at this command, with the curve [0, 1] of the vehicle file."""
    assert vehicle.thrust_curve == (0.0, 1.0)
    return -4.0 * vehicle.thrust_max_n * command**2 / vehicle.mass_kg


def test_residual_of_the_nominal_vehicle_is_zero(vehicle: Vehicle) -> None:
    residual = NominalResidual(vehicle)
    force = (0.0, 0.0, hover_force(vehicle, HOVER))
    for interval_us in (10_000, 20_000, 10_000):
        assert residual.push(interval_us, [HOVER] * 4, force) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_residual_is_what_the_rotors_do_not_explain(vehicle: Vehicle) -> None:
    force = (-0.3, 0.2, hover_force(vehicle, HOVER) - 0.5)
    found = NominalResidual(vehicle).push(10_000, [HOVER] * 4, force)
    assert found == pytest.approx((-0.3, 0.2, -0.5))


@pytest.mark.parametrize("interval_us", [10_000, 50_000, 1_000_000])
def test_residual_after_a_step_follows_the_motor_lag(vehicle: Vehicle, interval_us: int) -> None:
    # A separate computation: the lag integrated in steps of 10 us.
    residual = NominalResidual(vehicle)
    residual.push(10_000, [HOVER] * 4, (0.0, 0.0, 0.0))
    thrust, steps = hover_force(vehicle, HOVER), interval_us // 10
    target = hover_force(vehicle, 0.5)
    means = []
    for _ in range(2):
        total = 0.0
        for _ in range(steps):
            total += thrust
            thrust += (target - thrust) * 1e-5 / vehicle.motor_lag_s
        means.append(total / steps)
    for mean in means:
        found = residual.push(interval_us, [0.5] * 4, (0.0, 0.0, mean))
        assert math.hypot(*found) == pytest.approx(0.0, abs=3e-3)
