"""A residual learned under the law on board predicts flights by a controller on the host (remark 1)."""

from __future__ import annotations

from contextlib import closing

import pytest

from tests.rate_controller import RateController
from tests.sessions.conftest import figure_eight
from trimtab.host.effects import load_effects
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, learn
from trimtab.host.learn.ahead import ahead
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.host_control import HostControl
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.model import Model
from trimtab.host.models.phi import Phi
from trimtab.host.models.states import flight_states
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.vehicle import SimulatedVehicle

pytestmark = pytest.mark.usefixtures("virtual_machine")

VEHICLE = load_vehicle("research")
DRAG = {"dx": 0.8, "dy": 0.7, "dz": 0.3}


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    """Two flights by the law on board and one by a controller on the host, each on its own reference."""
    folder = tmp_path_factory.mktemp("flights")
    world = folder / "world.toml"
    effect = "\n".join(f"{key} = {value}" for key, value in DRAG.items())
    world.write_text(f'description = "drag"\ntolerances = false\n[effects.linear-drag]\n{effect}\n')
    made = []
    for index, (duration_s, by_host) in enumerate(((7.0, False), (8.0, False), (9.0, True))):
        reference = figure_eight(VEHICLE, duration_s=duration_s, size_m=0.8)
        control = HostControl(controller=RateController(VEHICLE), name="outer-loop", settings_id="0" * 12)
        order = FlightRequest(
            vehicle=VEHICLE,
            reference=reference,
            log_path=folder / f"{index}.mcap",
            control=control if by_host else None,
        )
        with closing(SimulatedVehicle.create(VEHICLE, world=str(world), flight=index)) as simulated:
            made.append(read_flight(fly_lockstep(order, simulated).log))
    return made


def test_drag_learned_under_the_law_predicts_flights_by_a_controller_on_the_host(
    flights: list[Flight],
) -> None:
    learned = learn(
        flights[:2],
        hold_out=flights[2:],
        effects=load_effects(),
        settings=CondensedSettings(layout=None),
        forms=DEFAULT_FORMS,
    )
    assert learned.selected.what == "effects"
    assert learned.test is not None
    assert learned.test.drive == "inputs"
    assert learned.train.drive == "reference"
    assert learned.test.flights == (flights[2].id,)
    assert learned.test.ratio < 0.5


def test_prediction_from_motor_commands_knows_the_true_drag(flights: list[Flight]) -> None:
    library = load_effects()
    drag = Model(vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name, effects={"linear-drag": DRAG})
    for flight in flights:
        states = flight_states([flight])
        errors = []
        for model in (None, drag):
            parts = [] if model is None else model.parts(library)
            phi = Phi(vehicle=VEHICLE, effects=tuple(effect for effect, _ in parts))
            errors.append(ahead(phi, phi.theta(parts), states, [flight]).position_rmse_m)
        without, with_drag = errors
        assert without > 0.03
        assert with_drag < 0.4 * without


def test_flight_by_a_controller_on_the_host_is_not_learned_from(flights: list[Flight]) -> None:
    with pytest.raises(TooLittleData, match=r"2\.mcap: flown by a controller on the host"):
        learn(flights)


def test_flights_of_both_kinds_are_not_held_out_together(flights: list[Flight]) -> None:
    with pytest.raises(TooLittleData, match="of different kinds"):
        learn(flights[:1], hold_out=flights[1:])
