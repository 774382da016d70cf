"""Every kind of effect in flight: at twice its typical size the vehicle arms, flies and lands.

And it flies otherwise than without, with the same seeds and no turbulence. The full run has its typical
size too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.blobs import Reference
from trimtab.sitl.kinds import KINDS
from trimtab.sitl.vehicle import SimulatedVehicle

WHOLE_FLIGHT = [0, 1, 2, 3, 4, 5, 6, 1]
FARTHEST_M = 1.5
LEAST_M = 2e-4
CALM = (
    'description = "x"\ntolerances = false\n[turbulence]\nforce_m_s2 = 0.0\ntorque_rad_s2 = 0.0\n'
    "[radio]\nloss = 0.0\n"
)
DRAG = "[effects.linear-drag]\ndx = 0.4\ndy = 0.35\ndz = 0.2\n"


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("research")


Flown = Callable[[str], tuple[list[int], np.ndarray]]


@pytest.fixture(scope="module")
def flown(vehicle: Vehicle, session_tools: Any, tmp_path_factory: pytest.TempPathFactory) -> Flown:
    """States and true path in the world of a TOML text, for a figure eight of 1.2 m in six seconds."""
    figure_eight, put_on_board, fly = session_tools
    reference: Reference = figure_eight(vehicle, size_m=1.2, omega=1.6)
    path = tmp_path_factory.mktemp("worlds") / "world.toml"

    def run(text: str) -> tuple[list[int], np.ndarray]:
        path.write_text(CALM + text)
        simulated = SimulatedVehicle.create(vehicle, world=str(path), world_seed=5)
        put_on_board(simulated, reference)
        session = fly(simulated, until_s=25.0)
        return session.states, np.array(session.tracked_ned)

    return run


@pytest.fixture(scope="module")
def nominal(flown: Flown) -> np.ndarray:
    return flown("")[1]


@pytest.mark.parametrize("size", [pytest.param(1.0, marks=pytest.mark.full), 2.0])
@pytest.mark.parametrize("name", KINDS)
def test_vehicle_with_one_kind_of_effect_flies_the_whole_flight(
    name: str, size: float, flown: Flown, nominal: np.ndarray
) -> None:
    drawn = f'[draw]\ncount = [1, 1]\nkinds = ["{name}"]\nsize = [{size}, {size}]\n'
    states, path = flown((DRAG if name == "wind" else "") + drawn)
    assert states == WHOLE_FLIGHT
    assert np.abs(path[:, :2]).max() < FARTHEST_M
    assert path[:, 2].max() < -0.5
    count = min(len(path), len(nominal))
    off = np.linalg.norm(path[:count] - nominal[:count], axis=1)
    assert np.sqrt(np.mean(off**2)) > LEAST_M
