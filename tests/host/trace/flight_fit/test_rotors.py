"""Measured rotor speeds as data: what slows a rotor shows in them, what takes its thrust does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from trimtab.host.apps.bench.session_parts import figure_eight
from trimtab.host.effects import load_effects
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.log import Flight, read_flight
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.flight_fit.fit import fit_closed_loop
from trimtab.host.trace.flight_fit.loop import ClosedLoop, closed_loop, order_of
from trimtab.host.trace.flight_fit.rotors import RotorSpeeds
from trimtab.host.trace.parameters import space
from trimtab.host.trace.run import run
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research").replace(sensors={"rotor_speed": True})
SPACE = space(VEHICLE, load_effects())
NEUTRAL = np.zeros(len(SPACE.columns))
Fly = Callable[[str], Flight]


@pytest.fixture(scope="module")
def fly(tmp_path_factory: pytest.TempPathFactory) -> Fly:
    flights: dict[str, Flight] = {}

    def one(effects: str) -> Flight:
        if effects not in flights:
            folder = tmp_path_factory.mktemp("flight")
            world, log = folder / "world.toml", folder / "flight.mcap"
            world.write_text(f'description = "One flight"\ntolerances = false\n{effects}', encoding="utf-8")
            simulated = vehicle_class().create(VEHICLE, world=str(world), world_seed=3)
            reference = figure_eight(VEHICLE)
            fly_lockstep(FlightRequest(vehicle=VEHICLE, reference=reference, log_path=log), simulated)
            flights[effects] = read_flight(log)
        return flights[effects]

    return one


UNEVEN_LAG = "[effects.uneven-lag]\nratio = 1.6\n"
WEAK = "[effects.rotor-loss]\nloss_1 = 0.0\nloss_2 = 0.15\nloss_3 = 0.0\nloss_4 = 0.0\n"


def speeds_of(*flights: Flight) -> RotorSpeeds:
    return RotorSpeeds([FlightData.of(flight) for flight in flights], VEHICLE, SPACE)


def estimate(flight: Flight, name: str) -> tuple[float, float]:
    """Value and sd of the first parameter of an effect from rotor speeds alone, after three steps."""
    speeds, at, covariance = speeds_of(flight), NEUTRAL, np.eye(len(NEUTRAL))
    for _ in range(4):
        gram = speeds.grams(at)[0]
        covariance = np.linalg.inv(gram[1:, 1:] + np.eye(len(at)))
        at = SPACE.clipped(at + covariance @ (gram[0, 1:] - at))
    i = SPACE.owners[name][0]
    return float(SPACE.values(at)[i]), float(np.sqrt(covariance[i, i]) * SPACE.scale[i])


def test_uneven_lag_is_read_from_the_speeds_alone(fly: Fly) -> None:
    value, sd = estimate(fly(UNEVEN_LAG), "uneven-lag")
    assert abs(value - 1.6) < 0.2
    assert sd < 0.22


@pytest.mark.parametrize("effects", ["", WEAK])
def test_a_lost_thrust_does_not_show_in_the_speeds(fly: Fly, effects: str) -> None:
    value, sd = estimate(fly(effects), "uneven-lag")
    assert abs(value - 1.0) < 0.1
    speeds = speeds_of(fly(effects))
    gram = speeds.grams(NEUTRAL)[0]
    assert gram[0, 0] > 0.0
    for i in SPACE.owners["rotor-loss"]:
        assert not gram[1 + i].any()
    assert sd < 0.1


def test_grams_of_another_point_follow_from_the_linearisation(fly: Fly) -> None:
    """Moved by less than a relinearisation needs, residual and squares agree with roll-outs there."""
    columns = [i for name in ("motor-lag", "uneven-lag") for i in SPACE.owners[name]]
    near = NEUTRAL.copy()
    near[columns] = 0.02
    moved, fresh = speeds_of(fly("")), speeds_of(fly(""))
    start = moved.grams(NEUTRAL)
    fresh._whitening = moved._whitening
    rolled = fresh.grams(near)
    np.testing.assert_allclose(moved.grams(near)[0, 0], rolled[0, 0], rtol=0.02, atol=0.01 * start[0, 0, 0])
    squares = moved.squares(np.column_stack([NEUTRAL, near]))
    np.testing.assert_allclose(squares, [start[0, 0, 0], moved.grams(near)[0, 0, 0]], rtol=0.01)


def test_age_of_the_speeds_at_their_stamps_is_no_delay_of_the_motors(fly: Fly) -> None:
    flight = fly("")
    assert flight.rotors is not None
    late = replace(flight, rotors=replace(flight.rotors, t_us=flight.rotors.t_us + 8_000))
    (value, sd), (same, _) = (estimate(each, "actuation-delay") for each in (late, flight))
    assert abs(value - same) < 0.004
    assert sd > 0.001


def test_speeds_without_an_effect_that_acts_on_them_are_not_used(fly: Fly) -> None:
    effects = {name: effect for name, effect in load_effects().items() if not effect.acts_on_rotor_speed}
    flight = FlightData.of(fly(""))
    assert not RotorSpeeds([flight], VEHICLE, space(VEHICLE, effects)).present


def test_flights_without_speeds_have_none_and_beside_others_a_gram_of_zeros(fly: Fly) -> None:
    flight = fly("")
    bare = replace(flight, rotors=None)
    assert not speeds_of(bare).present
    both = speeds_of(bare, flight).grams(NEUTRAL)
    assert not both[0].any()
    assert both[1].any()
    loops: list[ClosedLoop] = [
        closed_loop([FlightData.of(each)], VEHICLE, SPACE, NEUTRAL) for each in (bare, flight)
    ]
    assert loops[0].speeds is None
    order = order_of(loops[0])
    fits = [fit_closed_loop(loop, (), NEUTRAL, order) for loop in loops]
    lag = SPACE.owners["uneven-lag"][0]
    without, with_speeds = (np.sqrt(fit.covariance[lag, lag]) for fit in fits)
    assert with_speeds < without


def test_one_flight_tells_sag_from_a_weak_propeller_only_with_rotor_speeds(fly: Fly) -> None:
    flight = fly("[effects.battery-sag]\nexponent = 1.5\n")
    result = run([flight], [], load_effects())
    assert [effect.name for effect in result.effects] == ["battery-sag"]
    (sag,) = result.effects
    assert abs(sag.parameters["exponent"].value - 1.5) < 2.0 * sag.parameters["exponent"].sd
    without = run([replace(flight, rotors=None)], [], load_effects())
    (first, *_) = without.effects
    assert first.name != "battery-sag" or first.aliases
