"""What `trimtab bench` traces: the second time of a few flights, then many logs."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.apps.bench import tracing
from trimtab.host.log import read_flight
from trimtab.host.vehicle import Vehicle, load_vehicle

VEHICLE = load_vehicle("research")


def test_times_are_of_the_second_trace_and_per_log_of_many(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([(90.0, 80.0), (2.0, 1.0), (50.0, 30.0)])
    sizes: list[int] = []

    def flown(vehicle: Vehicle, seed: int, folder: Path, flights: range) -> list[Path]:
        assert (vehicle, seed) == (VEHICLE, 5)
        return [folder / f"{flight}.mcap" for flight in flights]

    def traced(logs: list[Path]) -> tuple[float, float]:
        assert len(set(logs)) == len(logs)
        sizes.append(len(logs))
        return next(times)

    monkeypatch.setattr(tracing, "flown", flown)
    monkeypatch.setattr(tracing, "traced", traced)
    heard: list[str] = []
    found = tracing.measure(VEHICLE, 5, heard.append)
    assert sizes == [8, 8, 100]
    assert found == {"cpu_s": 2.0, "wall_s": 1.0, "logs_100_per_log": 0.3}
    assert len(heard) == tracing.Size().steps
    times = iter([(9.0, 9.0), (2.0, 1.0)])
    assert tracing.measure(VEHICLE, 5, size=tracing.QUICK)["logs_100_per_log"] is None


def test_flights_are_flown_to_their_end(tmp_path: Path) -> None:
    (log,) = tracing.flown(VEHICLE, 3, tmp_path, range(1, 2))
    assert read_flight(log).tracking_whole
