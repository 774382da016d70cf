"""phi predicts whole flights through firmware, radio and sensors (the design asks for 3 mm RMSE)."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from host.learn.evaluate import predict, whole_flights
from host.link.flight import FlightOrder
from host.link.fly import fly_lockstep
from host.log import Flight, read_flight
from host.models.phi import Phi
from host.models.reference import flat_outputs
from host.models.states import TooLittleData, flight_states
from sitl.vehicle import SimulatedVehicle


@pytest.fixture(scope="module", params=[(5.0, 0), (7.0, 1)], ids=["5s", "7s"])
def flight(request, tmp_path_factory, vehicle, make_reference) -> Flight:
    """A flight in still air of the vehicle as its file says; sensor noise and biases, radio with loss."""
    duration_s, index = request.param
    reference = make_reference(duration_s=duration_s, turning=index == 1)
    start = reference.nodes_ned()[0].state
    path = tmp_path_factory.mktemp("flight") / "quiet.mcap"
    yaw = reference.yaw_nodes()[0].yaw
    simulated = SimulatedVehicle.create(
        vehicle, world="quiet", flight=index, start_ned=(start[0], start[1], 0.0), start_yaw=yaw
    )
    with closing(simulated):
        fly_lockstep(FlightOrder(vehicle=vehicle, reference=reference, log_path=path), simulated)
    return read_flight(path)


def test_phi_whole_flight_in_an_empty_world_is_predicted_within_3_mm(flight):
    states = flight_states(flight)
    phi = Phi(vehicle=flight.vehicle, parameters=flight.firmware_parameters)
    errors = whole_flights(phi, np.zeros(0), [states])
    assert errors.position_rmse_m < 3e-3
    assert errors.velocity_rmse_m_s < 0.03
    attitude = predict(phi, np.zeros(0), states)[:, 6:9] - states.x[:, 6:9]
    assert np.sqrt((attitude**2).mean()) < 0.01


def test_flight_states_follow_the_reference_and_hover_thrust(flight):
    states = flight_states(flight)
    reference = flat_outputs(states.reference, states.t_s)
    assert np.abs(states.x[:, :3] - reference[:3].T).max() < 0.06
    assert np.sqrt(np.square(states.x[:, 3:6] - reference[3:6].T).mean()) < 0.05
    np.testing.assert_allclose(states.x[:, 8], reference[12], atol=0.1)
    assert states.thrust[:20].sum(axis=1).mean() == pytest.approx(0.752 * 9.81, rel=0.03)
    assert 0.005 < states.constants[4] < 0.04
    np.testing.assert_array_equal(states.voltage_ratio.round(2), np.ones(len(states.t_s)))


def test_flight_states_poses_taken_as_older_move_along_the_flight(flight):
    late, plain = flight_states(flight, latency_s=0.02), flight_states(flight)
    moved = (late.x - plain.x)[:, :3]
    np.testing.assert_allclose(moved, 0.02 * plain.x[:, 3:6], atol=3e-3)


def test_flight_states_without_a_reference_say_what_is_missing(flight):
    import dataclasses

    with pytest.raises(TooLittleData, match=r"quiet\.mcap: no reference; use a flight tracked") as error:
        flight_states(dataclasses.replace(flight, reference=None))
    assert error.value.exit_code == 2
