"""Supervised learning on labels of the residual acceleration, from logs to a model."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.narrowing import not_none
from trimtab.host.learn import CondensedSettings, learn_supervised
from trimtab.host.learn.supervised import residual_labels
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.log.prepare import prepare
from trimtab.host.models.network import Layout
from trimtab.host.models.states import states_of
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.vehicle import SimulatedVehicle

pytestmark = pytest.mark.usefixtures("virtual_machine")

DRAG = np.array([0.8, 0.7, 0.3])
SETTINGS = CondensedSettings(layout=Layout(hidden=(8,), frame="body"), iterations=150)


@pytest.fixture(scope="module")
def flights(tmp_path_factory, make_states) -> list[Flight]:
    """Two flights in a world with drag."""
    folder = tmp_path_factory.mktemp("flights")
    world = folder / "world.toml"
    world.write_text(
        'description = "drag"\ntolerances = false\n[effects.linear-drag]\ndx = 0.8\ndy = 0.7\ndz = 0.3\n'
    )
    vehicle, logs = load_vehicle("research"), []
    for index, seed in enumerate((1, 2)):
        reference = make_states(seed, duration_s=12.0).reference
        north, east, *_ = reference.nodes_ned()[0].state
        simulated = SimulatedVehicle.create(
            vehicle, world=str(world), flight=index, start_ned=(north, east, 0.0)
        )
        path: Path = folder / f"flight{index}.mcap"
        with closing(simulated):
            fly_lockstep(FlightRequest(vehicle=vehicle, reference=reference, log_path=path), simulated)
        logs.append(read_flight(path))
    return logs


def _body_drag(x: np.ndarray) -> np.ndarray:
    """The world's drag (n, 3), NED, at states."""
    turn = Rotation.from_euler("ZYX", x[:, 8:5:-1])
    return turn.apply(-DRAG * turn.inv().apply(x[:, 3:6]))


def test_labels_of_a_log_are_the_drag_of_its_world(flights: list[Flight]) -> None:
    for prepared in prepare(flights):
        states = states_of(prepared)
        error = residual_labels(states, prepared.a) - _body_drag(states.x)
        # Measured: 0.01 and 0.2 m/s^2; the drag is 0.5 along x.
        assert np.abs(error.mean(0)).max() < 0.03
        assert error.std(0).max() < 0.3


def test_network_learns_the_drag_from_labels(flights: list[Flight]) -> None:
    model = learn_supervised(flights[:1], settings=SETTINGS, seed=1)
    x = states_of(prepare(flights[1:])[0]).x
    learned = not_none(model.network).acceleration_ned(x[:, 3:6].T, x[:, 6:9].T).T
    true = _body_drag(x)
    # Measured: 0.13 of the drag, and less than half the noise of the labels.
    assert np.sqrt(((learned - true) ** 2).sum(1).mean()) < 0.2 * np.sqrt((true**2).sum(1).mean())
    assert model.data == (flights[0].id,)
    assert not_none(model.region).speed_max_m_s > 1.0


def test_same_seed_gives_the_same_model(flights: list[Flight]) -> None:
    first, again = (learn_supervised(flights[:1], settings=SETTINGS, seed=3) for _ in range(2))
    other = learn_supervised(flights[:1], settings=SETTINGS, seed=4)
    assert first.id == again.id != other.id


def test_given_accelerations_take_the_place_of_the_smoothed_ones(flights: list[Flight]) -> None:
    (prepared,) = prepare(flights[:1])
    same = learn_supervised(flights[:1], settings=SETTINGS, accelerations=[prepared.a], seed=3)
    assert same.id == learn_supervised(flights[:1], settings=SETTINGS, seed=3).id
    lift = np.array([0.0, 0.0, -2.0])
    lifted = learn_supervised(flights[:1], settings=SETTINGS, accelerations=[prepared.a + lift], seed=3)
    x = states_of(prepared).x
    learned = not_none(lifted.network).acceleration_ned(x[:, 3:6].T, x[:, 6:9].T).T
    error = learned - _body_drag(x) - lift
    # Measured: 0.25 m/s^2 with noise, of 2.
    assert np.sqrt((error**2).sum(1).mean()) < 0.4


@pytest.mark.parametrize("wrong", [lambda a: [], lambda a: [a, a], lambda a: [a[1:]], lambda a: [a[:, :2]]])
def test_accelerations_of_a_wrong_shape_are_refused(flights: list[Flight], wrong: Callable[..., Any]) -> None:
    (prepared,) = prepare(flights[:1])
    with pytest.raises(ValueError, match="shapes"):
        learn_supervised(flights[:1], settings=SETTINGS, accelerations=wrong(prepared.a))


def test_layout_is_needed(flights: list[Flight]) -> None:
    with pytest.raises(ValueError, match="layout"):
        learn_supervised(flights, settings=CondensedSettings(layout=None))


def test_flights_of_several_vehicles_are_refused(flights: list[Flight]) -> None:
    other = replace(flights[1], vehicle=load_vehicle("nano"))
    with pytest.raises(TooLittleData):
        learn_supervised([flights[0], other])
