"""Rotor speeds from the motor controllers to the log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.apps.bench.session_parts import figure_eight
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.log import read_flight
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.sitl.vehicle import SimulatedVehicle

VEHICLE = load_vehicle("research")
MEASURED = VEHICLE.replace(sensors={"rotor_speed": True})


def flown(vehicle: Vehicle, folder: Path, world: str = "empty") -> Any:
    path = folder / "flight.mcap"
    simulated = SimulatedVehicle.create(vehicle, world=world, world_seed=3)
    reference = figure_eight(vehicle)
    fly_lockstep(FlightRequest(vehicle=vehicle, reference=reference, log_path=path), simulated)
    return read_flight(path)


def test_log_holds_the_rotor_speeds_that_the_commands_drive(tmp_path: Path) -> None:
    flight = flown(MEASURED, tmp_path)
    rotors, control = flight.rotors, flight.control
    start, end = flight.tracking
    inside = (rotors.t_us > start) & (rotors.t_us < end)
    assert np.diff(rotors.t_us[inside]).mean() == pytest.approx(10_000, rel=0.05)
    # First-order lag of the thrust that the commands ask for, by hand; the thrust curve is u^2.
    thrust, lagged = control.motor_mean[0] ** 2, []
    keep = np.exp(-(control.t1_us - control.t0_us) * 1e-6 / MEASURED.motor_lag_s)
    for command, share in zip(control.motor_mean, keep, strict=True):
        thrust = command**2 + (thrust - command**2) * share
        lagged.append(thrust)
    for measured, expected in zip(rotors.speed.T, np.sqrt(lagged).T, strict=True):
        expected = np.interp(rotors.t_us[inside], control.t1_us, expected)
        assert np.std(measured[inside] - expected) < 0.01 * np.mean(expected)


def test_log_of_a_vehicle_without_the_sensor_has_no_channel(tmp_path: Path) -> None:
    flight = flown(VEHICLE, tmp_path)
    assert flight.rotors is None
    assert "/fc/rotors" not in flight.contents.topics


def test_lost_messages_leave_gaps_in_the_rotor_speeds(tmp_path: Path) -> None:
    flight = flown(MEASURED, tmp_path, "lossy-link")
    steps = np.diff(flight.rotors.t_us)
    assert (steps > 0).all()
    assert (steps > 15_000).sum() > 50


def test_sensor_is_part_of_the_vehicle_and_no_sensor_is_not() -> None:
    assert MEASURED.id != VEHICLE.id
    assert "sensors" not in VEHICLE.to_toml()
    assert "[sensors]\nrotor_speed = true" in MEASURED.to_toml()
