"""What is missing does not depend on the law that flew: worlds traced with the observer off and on."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.effects import load_effects
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.log import Flight, read_flight
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.prediction import predict_flights, rmse
from trimtab.host.trace.run import run
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference

WORLDS = {
    "thrust-gain": "[effects.thrust-gain]\ngain = 0.92\n",
    "quadratic-drag": "[effects.quadratic-drag]\nc = 0.05\n",
}
LEARNING = ((7.0, 1.1), (7.0, 1.1), (8.0, 1.5), (6.0, 0.7))
HELD_OUT = (7.5, 1.2)
"""Durations (s) and sizes (m) of figures of eight; one is flown twice."""


@pytest.fixture
def flights(
    vehicle: Vehicle,
    figure_eight: Callable[..., Reference],
    simulate: Callable[..., Any],
    world_file: Callable[[str], str],
    tmp_path: Path,
) -> Callable[[str, float], list[Flight]]:
    """The flights to learn from and the one held out, by world and gain of the observer."""

    def fly(text: str, gain: float) -> list[Flight]:
        world, logs = world_file(text), []
        for index, (duration_s, size_m) in enumerate((*LEARNING, HELD_OUT)):
            log = tmp_path / f"{gain:g}-{index}.mcap"
            order = FlightRequest(
                vehicle=vehicle,
                reference=figure_eight(vehicle, duration_s=duration_s, size_m=size_m),
                log_path=log,
                parameters={"OBS_GAIN": gain} if gain else {},
            )
            with closing(simulate(world=world, world_seed=11, flight=index)) as simulated:
                fly_lockstep(order, simulated)
            logs.append(read_flight(log))
        return logs

    return fly


@pytest.mark.long
@pytest.mark.full
@pytest.mark.parametrize("name", WORLDS)
def test_trace_with_the_observer_off_and_on_names_the_same_within_2_sigma(
    name: str, flights: Callable[[str, float], list[Flight]]
) -> None:
    """And what was learned from either predicts the held-out flight of both."""
    effects = load_effects()
    off, on = flights(WORLDS[name], 0.0), flights(WORLDS[name], 5.0)
    traces = [run(learning[:-1], [other[-1]], effects) for learning, other in ((off, on), (on, off))]
    first, second = (trace.effects[0] for trace in traces)
    for trace in traces:
        assert trace.effects[0].name == name
        for other in trace.effects[1:]:  # one that is named at the edge says nothing
            neutral = {p.key: p.neutral for p in effects[other.name].parameters}
            assert all(abs(v.value - neutral[key]) < 2.0 * v.sd for key, v in other.parameters.items()), other
        assert trace.before_score is not None
        assert trace.after_score is not None
        assert trace.after_score["position_rmse_m"] < trace.before_score["position_rmse_m"]
    for key, one in first.parameters.items():
        other = second.parameters[key]
        assert abs(one.value - other.value) < 2.0 * (one.sd**2 + other.sd**2) ** 0.5, (key, one, other)
    for held in (off[-1], on[-1]):
        errors = [
            rmse(predict_flights([FlightData.of(held)], trace.model, effects))["position_rmse_m"]
            for trace in traces
        ]
        assert max(errors) < 1.5 * min(errors)
