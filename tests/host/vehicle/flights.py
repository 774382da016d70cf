"""Simulated flights for the tests of `fit`, many seeds at once, written apart from the simulator and the law.

A rigid body under four lagging rotors follows tilts and a yaw rate. A slow disturbance pushes and turns it,
and the gyro is noisy.
"""

from __future__ import annotations

import numpy as np

from trimtab.host.vehicle import Vehicle
from trimtab.host.vehicle.motion import Tracks

STEP_S = 0.002
LOG_EVERY = 5
GRAVITY_M_S2 = 9.80665


def fly(vehicle: Vehicle, seeds: int, *, duration_s: float = 10.0, seed: int = 1) -> list[Tracks]:
    """Return one flight for each seed. Inertia and thrust deviate as the file's tolerances say."""
    rng = np.random.default_rng(seed)
    tolerance = vehicle.tolerance
    J = np.array(vehicle.inertia_kg_m2) * (
        1.0 + rng.normal(size=(seeds, 3)) * [tolerance("inertia", axis, 0.02) for axis in "xyz"]
    )
    gain = 1.0 + tolerance("thrust-gain", "gain", 0.01) * rng.normal(size=(seeds, 1))
    r = np.array([rotor.position_m for rotor in vehicle.rotors])
    spin = np.array([rotor.spin_sign for rotor in vehicle.rotors])
    B = np.stack([np.ones(4), -r[:, 1], r[:, 0], vehicle.torque_per_thrust_m * spin])
    mixer = np.linalg.inv(B)
    c1, c2 = vehicle.thrust_curve
    weight = vehicle.mass_kg * GRAVITY_M_S2
    phase = rng.uniform(0.0, 2.0 * np.pi, (seeds, 3))
    R = np.tile(np.eye(3), (seeds, 1, 1))
    w = np.zeros((seeds, 3))
    thrust = np.full((seeds, 4), weight / 4.0)
    push, turn = np.zeros((seeds, 3)), np.zeros((seeds, 3))
    keep, fall = np.exp(-STEP_S / 0.3), np.exp(-STEP_S / vehicle.motor_lag_s)
    rows = []
    for k in range(round(duration_s / STEP_S)):
        t = k * STEP_S
        push = keep * push + np.sqrt(1 - keep**2) * 0.1 * rng.normal(size=(seeds, 3))
        turn = keep * turn + np.sqrt(1 - keep**2) * 0.5 * rng.normal(size=(seeds, 3))
        gyro = w + 0.02 * rng.normal(size=(seeds, 3))
        lean = 0.3 * np.sign(np.sin(1.6 * t * np.array([1.0, 1.3]) + phase[:, :2]))
        tilt = np.stack([R[:, 2, 1], -R[:, 2, 0]], axis=1)
        goal = np.column_stack([6.0 * (lean - tilt), 0.6 * np.sign(np.sin(0.9 * t + phase[:, 2]))])
        torque = np.array(vehicle.inertia_kg_m2) * np.array([22.0, 22.0, 8.0]) * (goal - gyro)
        climb = weight * (1.0 + 0.1 * np.sin(1.1 * t + phase[:, :1])) / np.maximum(R[:, 2, 2:], 0.5)
        demand = np.clip(np.hstack([climb, torque]) @ mixer.T, 0.0, vehicle.thrust_max_n)
        share = demand / vehicle.thrust_max_n
        command = 2.0 * share / (c1 + np.sqrt(c1**2 + 4.0 * c2 * share) + 1e-12)
        thrust = gain * demand + (thrust - gain * demand) * fall
        applied = thrust @ B.T
        w = w + STEP_S * ((applied[:, 1:] - np.cross(w, J * w)) / J + turn)
        angle = STEP_S * w
        skew = np.zeros((seeds, 3, 3))
        for i, j, a, sign in ((0, 1, 2, -1), (0, 2, 1, 1), (1, 2, 0, -1)):
            skew[:, i, j], skew[:, j, i] = sign * angle[:, a], -sign * angle[:, a]
        R = R @ (np.eye(3) + skew + 0.5 * skew @ skew)
        force = push - np.array([0.0, 0.0, 1.0]) * applied[:, :1] / vehicle.mass_kg
        rows.append((command, gyro, force))
    command, gyro, force = (np.stack(each) for each in zip(*rows, strict=True))
    whole = len(command) // LOG_EVERY * LOG_EVERY

    def averaged(values: np.ndarray) -> np.ndarray:
        return values[:whole].reshape(-1, LOG_EVERY, *values.shape[1:]).mean(axis=1)

    interval_us = round(LOG_EVERY * STEP_S * 1e6)
    t_us = interval_us // 2 + interval_us * np.arange(whole // LOG_EVERY)
    logs = [averaged(values) for values in (command, gyro, force)]
    return [
        Tracks(
            input_us=t_us,
            motor_command=logs[0][:, s],
            rate_us=t_us,
            rate_frd=logs[1][:, s],
            force_us=t_us,
            specific_force_frd=logs[2][:, s],
        )
        for s in range(seeds)
    ]
