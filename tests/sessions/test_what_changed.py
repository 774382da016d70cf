"""What changed between two sets of simulated flights, by name and size, and that nothing did."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from trimtab.host.apps.bench.session_parts import figure_eight
from trimtab.host.effects import load_effects
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.tracks import RecordedImu, RecordedInputs
from trimtab.host.trace.decision.findings import Verdict
from trimtab.host.trace.result import Trace
from trimtab.host.trace.run import run
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.vehicle import SimulatedVehicle

VEHICLE = load_vehicle("research")
EFFECTS = load_effects()
BUILD = 'description = "One build, with a drag that both sets have in common"\ntolerances = true\n'
DRAG = {"linear-drag": {"dx": 0.3, "dy": 0.3, "dz": 0.1}}


def flown(folder: Path, first: int, effects: dict[str, dict[str, float]]) -> list[Flight]:
    """Return two flights of one build with these effects; first: index of the first flight."""
    world, flights = folder / f"world{first}.toml", []
    tables = [
        f"\n[effects.{name}]\n" + "".join(f"{key} = {value}\n" for key, value in values.items())
        for name, values in effects.items()
    ]
    world.write_text(BUILD + "".join(tables))
    for index, omega in ((first, 1.35), (first + 1, 1.0)):
        path = folder / f"flight{index}.mcap"
        simulated = SimulatedVehicle.create(VEHICLE, world=str(world), world_seed=5, flight=index)
        reference = figure_eight(VEHICLE, omega=omega)
        fly_lockstep(FlightRequest(vehicle=VEHICLE, reference=reference, log_path=path), simulated)
        flights.append(read_flight(path))
    return flights


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    return flown(tmp_path_factory.mktemp("before"), 0, DRAG)


def traced(before: list[Flight], after: list[Flight], *names: str) -> Trace:
    """Return what changed, of these effects and the drag."""
    effects = {name: EFFECTS[name] for name in ("linear-drag", *names)}
    return run(after, [], effects, baseline=before, jobs=1)


def of_motor_level(flight: Flight) -> Flight:
    """Return a log as other vehicles write it: motor commands and an IMU, of a vehicle not known exactly."""
    control = flight.control
    assert control is not None
    return replace(
        flight,
        control=None,
        recorded_inputs=RecordedInputs(t_us=control.t0_us, level="motor", motor=control.motor_mean),
        recorded_imu=RecordedImu(
            t_us=control.t0_us, gyro=control.gyro_mean, specific_force=control.force_mean
        ),
        metadata={**flight.metadata, "unknown": "thrust-curve torque"},
    )


def named(result: Trace, name: str, key: str, expected: float, within: float) -> None:
    """Check that the answer is this effect alone, of the right size, and that 2.5 sigma hold that size."""
    assert result.verdict is Verdict.TRACED
    assert [effect.name for effect in result.effects] == [name]
    value = result.effects[0].parameters[key]
    assert value.value == pytest.approx(expected, abs=min(within, 2.5 * value.sd))


def test_nothing_changed_although_the_model_lacks_a_drag(before: list[Flight], tmp_path: Path) -> None:
    result = traced(before, flown(tmp_path, 2, DRAG), "mass", "rotor-loss", "com-offset", "torque-bias")
    assert result.verdict is Verdict.NOTHING_MISSING
    assert result.baseline is not None
    drag = result.baseline.common["linear-drag"]
    assert abs(drag["dx"].value - 0.3) < 0.02  # the plant's drag grows with rotor speed, the model's less
    assert not result.model.effects


def test_a_drag_that_is_gone_is_named(before: list[Flight], tmp_path: Path) -> None:
    result = traced(before, flown(tmp_path, 2, {}), "mass", "thrust-gain")
    named(result, "linear-drag", "dx", -0.3, within=0.05)
    assert result.model.effects["linear-drag"]["dx"] == pytest.approx(0.0, abs=0.02)


def test_a_heavier_vehicle_is_named(before: list[Flight], tmp_path: Path) -> None:
    heavier = flown(tmp_path, 2, {**DRAG, "mass": {"factor": 1.3}})
    result = traced(before, heavier, "mass", "thrust-gain", "com-offset", "inertia")
    named(result, "mass", "factor", 1.3, within=0.12)


def test_a_displaced_centre_of_mass_is_named(before: list[Flight], tmp_path: Path) -> None:
    displaced = flown(tmp_path, 2, {**DRAG, "com-offset": {"x": 0.006, "y": 0.0}})
    named(
        traced(before, displaced, "com-offset", "rotor-loss", "torque-bias"),
        "com-offset",
        "x",
        0.006,
        within=0.001,
    )


@pytest.mark.parametrize("level", ["control", "motor"])
def test_a_weaker_rotor_is_named(before: list[Flight], tmp_path: Path, level: str) -> None:
    """Also in logs that leave thrust curve and torque unknown: both sets have them in common."""
    weaker = {"loss_1": 0.0, "loss_2": 0.0, "loss_3": 0.12, "loss_4": 0.0}
    after = flown(tmp_path, 2, {**DRAG, "rotor-loss": weaker})
    if level == "motor":
        before, after = ([of_motor_level(flight) for flight in flights] for flights in (before, after))
    result = traced(before, after, "rotor-loss", "com-offset", "torque-bias")
    named(result, "rotor-loss", "loss_3", 0.12, within=0.04)
    assert result.baseline is not None
    assert ("thrust-curve" in result.baseline.common) == (level == "motor")
