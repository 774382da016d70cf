"""The network on the unexplained residual: it is judged on held-out flights, added to the traced model."""

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
from trimtab.host.trace.residual.network import train_network

DATA = Path(__file__).parents[3] / "data"


def test_network_on_the_residual_predicts_and_names_no_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SETTINGS", {"hidden": (4,), "epochs": 12, "patience": 12})
    flights = [read_flight(DATA / f"{name}.mcap") for name in ("a1", "a2")]
    held_out = [read_flight(DATA / "b1.mcap")]
    vehicle = flights[0].vehicle
    data, _ = segments_of([FlightData.of(each) for each in flights], rate_driven=False)
    description = describe(np.zeros((len(data.flight), data.bins, 6)), data, ("a", "a"), vehicle)
    model = Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name)
    messages: list[str] = []
    outcome = train_network(flights, held_out, model, load_effects(), description, messages.append)
    assert outcome is not None
    assert outcome.model is not None
    assert outcome.model.network is not None
    assert not outcome.model.effects
    assert 0.0 < outcome.before.position_rmse_m < 1.0
    assert outcome.after != outcome.before
    assert "names no cause" in words.network(outcome)
    assert outcome.to_json("x.model.toml")["model"] == "x.model.toml"
    assert messages[-1] == "network: epoch 12 of at most 12"
    monkeypatch.setattr(module, "SETTINGS", {"hidden": (1,), "epochs": 1, "rate": 1e-12})
    outcome = train_network(flights, held_out, model, load_effects(), description)
    assert outcome is not None
    assert outcome.model is None
    assert "it is not kept" in words.network(outcome)
    assert train_network(flights, [], model, load_effects(), description) is None
    short = [replace(flight, estimate=None) for flight in flights]
    assert train_network(short, held_out, model, load_effects(), description) is None
