"""Models of a world: learned once, read by every later piece."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from trimtab.host.apps.paper.controllers import models
from trimtab.host.apps.paper.controllers.models import learn_models, learned_site
from trimtab.host.apps.paper.controllers.table import CONTROLLERS, REGRESSORS
from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.models.model import Model
from trimtab.host.vehicle import load_vehicle

DATA = Path(__file__).parents[4] / "data"
VEHICLE = load_vehicle("research")
NAMES = {name for c in CONTROLLERS for r in REGRESSORS if (name := c.model(r)) is not None}


def test_site_learns_once_and_later_reads_the_same_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    drag = {"linear-drag": {"dx": 0.5, "dy": 0.4, "dz": 0.1}}
    made = Model(vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name, effects=drag)
    learned: list[int] = []

    def learn_made_up(*of: Any) -> tuple[dict[str, Model], str]:
        learned.append(of[-1])
        return dict.fromkeys(NAMES, made), "effects"

    monkeypatch.setattr(models, "training_flights", lambda *of, **options: [])
    monkeypatch.setattr(models, "learn_models", learn_made_up)
    sites = [learned_site(tmp_path / "w", VEHICLE, 5, "paper-drag", "world-00") for _ in range(2)]
    assert len(learned) == 1
    assert [site.selected for site in sites] == ["effects", "effects"]
    assert all(
        {name: m.id for name, m in site.models.items()} == dict.fromkeys(NAMES, made.id) for site in sites
    )
    assert sites[0].field == sites[1].field


def test_site_cut_while_learning_learns_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def stop(*of: Any, **options: Any) -> list[Any]:
        raise KeyboardInterrupt

    monkeypatch.setattr(models, "training_flights", stop)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            learned_site(tmp_path / "w", VEHICLE, 5, "paper-drag", "world-00")


def test_places_have_worlds_of_their_own():
    seeds = {
        models.airfield(VEHICLE, 5, "paper-drag", place).world_seed for place in ("world-00", "world-01")
    }
    assert len(seeds) == 2


@pytest.mark.full  # learns five models
def test_learned_models_are_those_that_the_controllers_use():
    found, selected = learn_models([read_flight(DATA / "a1.mcap")], load_effects(), 3)
    assert set(found) == NAMES
    assert selected in ("nothing", "effects", "effects and network")
    frames = {name: m.network.layout.frame for name, m in found.items() if m.network is not None}
    assert frames.pop("ours", "body") == "body"
    assert frames == {"paper": "world", "paper-labels": "world", "ours-labels": "body"}
    assert set(found["closed-form"].effects) == {"linear-drag", "com-offset"}
    assert found["paper"].effects == {}
