"""The network on what is left: judged on held-out flights, over the model that is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.models.model import Model
from trimtab.host.trace import words
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.residual import network as module
from trimtab.host.trace.residual.description import describe
from trimtab.host.trace.residual.network import unexplained

DATA = Path(__file__).parents[2] / "data"


def test_a_network_takes_what_is_left_and_names_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SETTINGS", {"hidden": (4,), "epochs": 12, "patience": 12})
    flights = [read_flight(DATA / f"{name}.mcap") for name in ("a1", "a2")]
    held_out = [read_flight(DATA / "b1.mcap")]
    vehicle = flights[0].vehicle
    data, _ = segments_of([FlightData.of(each) for each in flights], rate_driven=False)
    told = describe(np.zeros((len(data.flight), data.bins, 6)), data, ("a", "a"), vehicle)
    model = Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name)
    said: list[str] = []
    found = unexplained(flights, held_out, model, load_effects(), told, said.append)
    assert found is not None
    assert found.model is not None
    assert found.model.network is not None
    assert not found.model.effects
    assert 0.0 < found.before.position_rmse_m < 1.0
    assert found.after != found.before
    assert "names no cause" in words.network(found)
    assert found.to_json("x.model.toml")["model"] == "x.model.toml"
    assert said[-1] == "network on what is left, 12 of at most 12 epochs"
    monkeypatch.setattr(module, "SETTINGS", {"hidden": (1,), "epochs": 1, "rate": 1e-12})
    found = unexplained(flights, held_out, model, load_effects(), told)
    assert found is not None
    assert found.model is None
    assert "it is not kept" in words.network(found)
    assert unexplained(flights, [], model, load_effects(), told) is None
    short = [replace(flight, estimate=None) for flight in flights]
    assert unexplained(short, held_out, model, load_effects(), told) is None
