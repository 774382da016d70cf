"""Flights of a vehicle with drag, made with phi itself, as `States`: no log, no simulator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.parts import part
from trimtab.host.models.drive import flight_constants
from trimtab.host.models.phi import Phi
from trimtab.host.models.reference import flat_outputs
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.states import States
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Node, Reference

DRAG = part("linear-drag", 0.45, 0.35, 0.25)
SIGMA = np.repeat([3e-4, 8e-3, 2e-3, 1e-2], 3)


def curve(seed: int, vehicle_id: str, duration_s: float = 4.0) -> Reference:
    """A C3 reference of three sines an axis under a smooth window."""
    rng = np.random.default_rng(seed)
    h = 1e-3
    fine = np.arange(-0.2, duration_s + 0.2, h)
    s = np.clip(fine / duration_s, 0.0, 1.0)
    window = np.tanh(2.0 * 4.0**5 * (s * (1.0 - s)) ** 5) / np.tanh(2.0)

    def axis(size: float) -> np.ndarray:
        low, high = (0.8, 1.6, 2.4), (1.4, 2.3, 3.2)
        terms = zip((0.6, 0.5, 0.25), rng.uniform(low, high), rng.uniform(0.0, 6.3, 3), strict=True)
        return size * sum((a * np.sin(f * fine + phase) for a, f, phase in terms), np.zeros(fine.shape))

    levels = [np.stack([window * axis(1.5), window * axis(1.3), -1.5 - window * axis(0.4)], axis=1)]
    for _ in range(3):
        levels.append(np.gradient(levels[-1], h, axis=0))
    nodes = []
    for t_us in range(0, round(duration_s * 1e6) + 1, 100_000):
        row = np.concatenate([level[round(t_us * 1e-3) + 200] for level in levels])
        if t_us in (0, round(duration_s * 1e6)):
            row[3:] = 0.0
        nodes.append(Node(t_us, tuple(row)))
    return Reference(vehicle_id=vehicle_id, origin_ned=(0.0, 0.0, 0.0), nodes=tuple(nodes))


@pytest.fixture(scope="session")
def make_states() -> Callable[..., States]:
    vehicle = load_vehicle("research")
    phi = Phi(vehicle=vehicle, effects=(DRAG[0],))

    def make(seed: int, *, noise: float = 1.0, duration_s: float = 4.0, drag: bool = True) -> States:
        reference = curve(seed, vehicle.id, duration_s)
        steps = round(duration_s / 0.02)
        start = flat_outputs(reference, np.zeros(1))[:, 0]
        constants = flight_constants(mocap_age_s=0.012, mocap_interval_s=0.01)
        x = roll_out(
            phi,
            x0=phi.hover(start[:3].tolist(), 0.0)[:, None],
            drive=reference_drive(reference, half_steps(0.0, steps, 0.02)),
            flight=constants,
            theta=phi.theta([DRAG] if drag else []),
            step_s=0.02,
            rows=19,
        )[:, :, 0]
        rng = np.random.default_rng(1000 + seed)
        return States(
            flight_id=f"flight{seed:06d}",
            reference_id=reference.id,
            vehicle=vehicle,
            reference=reference,
            feedforward=None,
            parameters=None,
            step_s=0.02,
            t_s=0.02 * np.arange(steps + 1),
            x=x[:, :12] + noise * SIGMA * rng.standard_normal((steps + 1, 12)),
            sigma=SIGMA,
            thrust=x[:, 12:16],
            integral=x[:, 16:19],
            voltage_ratio=np.ones(steps + 1),
            constants=constants,
        )

    return make
