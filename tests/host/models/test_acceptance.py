"""phi predicts whole flights through firmware, radio and sensors (the design asks for 3 mm RMSE)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from tests.parts import part
from trimtab.host.learn.evaluate import predict, whole_flights
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.summary import FlightResult
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.drive import FlightConstants
from trimtab.host.models.phi import Phi
from trimtab.host.models.reference import flat_outputs
from trimtab.host.models.states import flight_states
from trimtab.sitl.vehicle import SimulatedVehicle

DRAGGED = """description = "Linear drag, nothing else"
tolerances = false

[turbulence]
force_m_s2 = 0.0
torque_rad_s2 = 0.0

[effects.linear-drag]
dx = 0.4
dy = 0.4
dz = 0.4
"""
EXACT = """description = "Nothing but the vehicle, and sensors without error"
tolerances = false

[turbulence]
force_m_s2 = 0.0
torque_rad_s2 = 0.0

[mocap]
position_noise_m = 0.0
attitude_noise_deg = 0.0

[imu]
gyro_noise_rad_s = 0.0
gyro_bias_rad_s = 0.0
accelerometer_noise_m_s2 = 0.0
accelerometer_bias_m_s2 = 0.0
voltage_noise_v = 0.0
"""
DRAG = part("linear-drag", 0.4, 0.4, 0.4)


@pytest.fixture(scope="module")
def fly(tmp_path_factory, vehicle, make_reference) -> Callable[..., tuple[FlightResult, Flight]]:
    """A flight of the vehicle as its file says; sensor noise and biases, radio with loss."""

    def run(duration_s: float, index: int, world: str = "quiet", observer: float = 0.0) -> Any:
        reference = make_reference(duration_s=duration_s, turning=index == 1)
        start = reference.nodes_ned()[0].state
        path = tmp_path_factory.mktemp("flight") / "quiet.mcap"
        yaw = reference.yaw_nodes()[0].yaw
        simulated = SimulatedVehicle.create(
            vehicle, world=world, flight=index, start_ned=(start[0], start[1], 0.0), start_yaw=yaw
        )
        parameters = {"OBS_GAIN": observer} if observer else {}
        order = FlightRequest(vehicle=vehicle, reference=reference, log_path=path, parameters=parameters)
        with closing(simulated):
            result = fly_lockstep(order, simulated)
        return result, read_flight(path)

    return run


@pytest.fixture(scope="module", params=[(5.0, 0), (7.0, 1)], ids=["5s", "7s"])
def flight(request, fly) -> Flight:
    """In still air, without the observer."""
    return fly(*request.param)[1]


def test_phi_whole_flight_in_an_empty_world_is_predicted_within_3_mm(flight):
    (states,) = flight_states([flight])
    phi = Phi(vehicle=flight.vehicle, parameters=flight.firmware_parameters)
    errors = whole_flights(phi, np.zeros(0), [states])
    assert errors.position_rmse_m < 3e-3
    assert errors.velocity_rmse_m_s < 0.03
    attitude = predict(phi, np.zeros(0), states)[:, 6:9] - states.x[:, 6:9]
    assert np.sqrt((attitude**2).mean()) < 0.01


def test_poses_and_body_rate_of_a_log_are_dated_within_a_quarter_of_a_tick(fly, tmp_path):
    """By how much they lag what phi predicts: neither the clocks' comparison nor the ticks' sums may."""
    world = tmp_path / "exact.toml"
    world.write_text(EXACT, encoding="utf-8")
    _, flight = fly(5.0, 0, str(world))
    (states,) = flight_states([flight])
    predicted = predict(
        Phi(vehicle=flight.vehicle, parameters=flight.firmware_parameters), np.zeros(0), states
    )
    error = states.x - predicted
    v, turning = predicted[:, 3:6], np.gradient(predicted[:, 9:12], states.step_s, axis=0)
    assert -(error[:, 0:3] * v).sum() / (v**2).sum() == pytest.approx(0.0, abs=0.25e-3)
    late_s = -(error[:, 9:12] * turning).sum() / (turning**2).sum()
    assert late_s == pytest.approx(0.0, abs=0.25e-3)


@pytest.mark.parametrize(("duration_s", "index"), [(5.0, 0), (7.0, 1)])
def test_phi_whole_flight_with_the_observer_on_is_predicted_within_3_mm(fly, duration_s, index):
    _, flight = fly(duration_s, index, observer=5.0)
    assert flight.observer is not None
    assert len(flight.observer) == pytest.approx(100 * flight.duration_s, rel=0.1)
    (states,) = flight_states([flight])
    phi = Phi(vehicle=flight.vehicle, parameters=flight.firmware_parameters)
    assert phi.observes
    assert states.observer is not None
    np.testing.assert_array_equal(states.initial(phi)[phi.observer][:3], states.observer[0])
    errors = whole_flights(phi, np.zeros(0), [states])
    assert errors.position_rmse_m < 3e-3
    assert errors.velocity_rmse_m_s < 0.03


def test_observer_halves_the_tracking_error_under_drag_and_phi_predicts_both_flights(fly, tmp_path):
    """Drag of 0.4/s; bandwidth 5 rad/s: sums of slow sines at 1.3 to 2.7 rad/s."""
    world = tmp_path / "dragged.toml"
    world.write_text(DRAGGED, encoding="utf-8")
    tracked = []
    for observer in (0.0, 5.0):
        result, flight = fly(7.0, 1, str(world), observer)
        tracked.append(result.tracking_rmse_m)
        assert flight.firmware_parameters["OBS_GAIN"] == observer
        (states,) = flight_states([flight])
        phi = Phi(vehicle=flight.vehicle, effects=(DRAG[0],), parameters=flight.firmware_parameters)
        errors = whole_flights(phi, phi.theta([DRAG]), [states])
        assert errors.position_rmse_m < 3e-3
        without = whole_flights(phi, phi.theta_neutral, [states])
        assert without.position_rmse_m > 3.0 * errors.position_rmse_m
    assert tracked[1] < 0.6 * tracked[0]
    assert states.observer is not None
    drag = -0.4 * states.x[:, 3:6]
    seen = np.sqrt(np.square(states.observer - drag).mean())
    assert seen < 0.5 * np.sqrt(np.square(drag).mean())


def test_flight_states_follow_the_reference_and_hover_thrust(flight):
    (states,) = flight_states([flight])
    reference = flat_outputs(states.reference, states.t_s)
    assert np.abs(states.x[:, :3] - reference[:3].T).max() < 0.06
    assert np.sqrt(np.square(states.x[:, 3:6] - reference[3:6].T).mean()) < 0.05
    np.testing.assert_allclose(states.x[:, 8], reference[12], atol=0.1)
    assert states.thrust[:20].sum(axis=1).mean() == pytest.approx(0.752 * 9.81, rel=0.03)
    assert 0.005 < FlightConstants(*states.constants).mocap_age_s < 0.04
    np.testing.assert_array_equal(states.voltage_ratio.round(2), np.ones(len(states.t_s)))


def test_flight_states_poses_taken_as_older_move_along_the_flight(flight):
    (late,), (plain,) = flight_states([flight], latency_s=0.02), flight_states([flight])
    moved = (late.x - plain.x)[:, :3]
    np.testing.assert_allclose(moved, 0.02 * plain.x[:, 3:6], atol=3e-3)


def test_flight_states_without_a_reference_say_what_is_missing(flight):
    import dataclasses

    with pytest.raises(TooLittleData, match=r"quiet\.mcap: no reference; use a flight tracked") as error:
        flight_states([dataclasses.replace(flight, reference=None)])
    assert error.value.exit_code == 2
