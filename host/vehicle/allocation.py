"""Inverse of a vehicle's allocation matrix: rotor thrusts from collective thrust and torque."""

from __future__ import annotations

import numpy as np

from trimtab.firmware_model.law.allocation import allocation_matrix, invert4
from trimtab.host.vehicle.model import Vehicle


def allocation_inverse(vehicle: Vehicle) -> np.ndarray:
    """Return the (4, 4) matrix from collective thrust (N) and torque (N m, FRD) to rotor thrusts (N)."""
    rotors = vehicle.rotors
    matrix = allocation_matrix(
        [rotor.position_m for rotor in rotors],
        [rotor.spin_sign for rotor in rotors],
        vehicle.torque_per_thrust_m,
    )
    return np.array(invert4(matrix)).reshape(4, 4)
