"""Angular momentum of the rotors: what they gain while they spin up, the body loses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.host.effects.test_effects import EFFECTS, VEHICLE, level
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.models.airframe import RATE
from trimtab.host.models.dynamics import derivative
from trimtab.host.models.phi import Phi
from trimtab.host.vehicle import load_vehicle

H = 4.0
HOVER_N = VEHICLE.mass_kg * GRAVITY / 4.0
SPINS = np.array([1.0 if rotor.spin == "ccw" else -1.0 for rotor in VEHICLE.rotors])


def rotor_momentum(thrust: np.ndarray) -> float:
    """Return the angular momentum of all rotors about z FRD; that of a ccw rotor points up."""
    return float(-H * VEHICLE.inertia_kg_m2[0] * (SPINS * np.sqrt(thrust / HOVER_N)).sum())


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_body_and_rotors_keep_their_angular_momentum_while_rotors_spin_up(share: float):
    x = level(thrust=HOVER_N)
    command = (HOVER_N * (1.0 + 0.1 * SPINS)).tolist()
    spinning = np.array(derivative(FLOAT, VEHICLE, [(EFFECTS["gyroscopic"], (H, share))], x, command))
    nominal = np.array(derivative(FLOAT, VEHICLE, [], x, command))
    dt = 1e-6
    thrust = np.array(x[12:])
    gained = (rotor_momentum(thrust + dt * nominal[12:]) - rotor_momentum(thrust)) / dt
    assert gained < -1e-3
    body = VEHICLE.inertia_kg_m2[2] * (spinning - nominal)[RATE][2]
    assert body == pytest.approx(-share * gained, rel=1e-5)
    np.testing.assert_array_equal(spinning[:11], nominal[:11])


def test_stopped_rotor_spins_up_at_a_finite_rate():
    x = level(thrust=0.0)
    rates = derivative(FLOAT, VEHICLE, [(EFFECTS["gyroscopic"], (H, 1.0))], x, (HOVER_N, 0.0, 0.0, 0.0))
    assert np.isfinite(rates).all()


def test_closed_loop_model_turns_as_the_open_loop_one_does():
    vehicle = load_vehicle("research")
    phi = Phi(vehicle=vehicle, effects=(EFFECTS["gyroscopic"],), drive="inputs")
    x = level(thrust=HOVER_N)
    command = (HOVER_N * (1.0 + 0.1 * SPINS)).tolist()
    expected = derivative(FLOAT, vehicle, [(EFFECTS["gyroscopic"], (H, 1.0))], x, command)
    drive = [*command, 1.0, 0.0]
    fast = replace(phi, hold_s=0.0)
    np.testing.assert_allclose(fast.derivative(FLOAT, x, drive, (), (H, 1.0)), expected, rtol=1e-12)
    assert phi.derivative(FLOAT, x, drive, (), (H, 0.0))[11] < 0.5 * expected[11]
