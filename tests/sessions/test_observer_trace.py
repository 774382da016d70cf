"""What is missing does not depend on the law that flew: a world traced with the observer off and on."""

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

WORLD = "[effects.thrust-gain]\ngain = 0.92\n[effects.quadratic-drag]\nc = 0.05\n"
NAMES = {"thrust-gain", "quadratic-drag"}
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
) -> Callable[[float], list[Flight]]:
    """The flights to learn from and the one held out, by gain of the observer."""

    def fly(gain: float) -> list[Flight]:
        world, logs = world_file(WORLD), []
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
def test_trace_with_the_observer_off_and_on_names_the_same_within_2_sigma(
    flights: Callable[[float], list[Flight]],
) -> None:
    """And what was learned from either predicts the held-out flight of both."""
    effects = load_effects()
    off, on = flights(0.0), flights(5.0)
    traces = [run(learning[:-1], [other[-1]], effects) for learning, other in ((off, on), (on, off))]
    for trace in traces:
        assert {effect.name for effect in trace.effects[: len(NAMES)]} == NAMES
        for other in trace.effects[len(NAMES) :]:  # one that is named at the edge says nothing
            neutral = {p.key: p.neutral for p in effects[other.name].parameters}
            assert all(abs(v.value - neutral[key]) < 2.0 * v.sd for key, v in other.parameters.items()), other
        assert trace.before_score is not None
        assert trace.after_score is not None
        assert trace.after_score["position_rmse_m"] < trace.before_score["position_rmse_m"]
    first, second = ({effect.name: effect.parameters for effect in trace.effects} for trace in traces)
    for name in NAMES:
        for key, one in first[name].items():
            other = second[name][key]
            assert abs(one.value - other.value) < 2.0 * (one.sd**2 + other.sd**2) ** 0.5, (key, one, other)
    for held in (off[-1], on[-1]):
        errors = [
            rmse(predict_flights([FlightData.of(held)], trace.model, effects))["position_rmse_m"]
            for trace in traces
        ]
        assert max(errors) < 1.5 * min(errors)
