"""The inverse of a vehicle's allocation matrix."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.models.dynamics import rotor_torque
from trimtab.host.vehicle import load_vehicle
from trimtab.host.vehicle.allocation import allocation_inverse


@pytest.mark.parametrize("name", ["nano", "research"])
def test_rotor_thrusts_of_the_inverse_give_the_thrust_and_torque_of_the_rigid_body_model(name: str) -> None:
    vehicle = load_vehicle(name)
    wanted = np.array([vehicle.mass_kg * 9.8, 2e-3, -1e-3, 5e-4])
    thrust = allocation_inverse(vehicle) @ wanted
    np.testing.assert_allclose([thrust.sum(), *rotor_torque(vehicle, list(thrust))], wanted, atol=1e-12)
