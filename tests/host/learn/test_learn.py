"""`trimtab learn` on flights of a vehicle in a world with drag: from logs to a model file."""

from __future__ import annotations

import dataclasses
import json
from contextlib import closing
from pathlib import Path

import pytest

from host.cli import main
from host.learn import Settings, learn
from host.link.flight import FlightOrder
from host.link.fly import fly_lockstep
from host.log import read_flight
from host.models.file import read_model
from host.models.model import Model
from host.models.states import TooLittleData
from host.vehicle import load_vehicle
from sitl.vehicle import SimulatedVehicle

WORLD = "[effects.linear-drag]\ndx = 0.8\ndy = 0.7\ndz = 0.3\n"


@pytest.fixture(scope="module")
def logs(tmp_path_factory, make_states) -> list[Path]:
    """Flights of three references, the first flown twice."""
    folder = tmp_path_factory.mktemp("flights")
    (folder / "world.toml").write_text('description = "drag"\ntolerances = false\n' + WORLD)
    vehicle = load_vehicle("research")
    paths = []
    for index, seed in enumerate((1, 1, 2, 3)):
        reference = make_states(seed, duration_s=6.0).reference
        start = reference.nodes_ned()[0].state
        simulated = SimulatedVehicle.create(
            vehicle, world=str(folder / "world.toml"), flight=index, start_ned=(start[0], start[1], 0.0)
        )
        path = folder / f"flight{index}.mcap"
        with closing(simulated):
            fly_lockstep(FlightOrder(vehicle=vehicle, reference=reference, log_path=path), simulated)
        paths.append(path)
    return paths


def test_learn_verb_drag_lowers_the_error_on_a_reference_held_out(logs, tmp_path, capsys):
    output = tmp_path / "out.model.toml"
    words = ["learn", *map(str, logs), "-o", str(output), "--epochs", "40", "--hidden", "16", "--json"]
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(answer) >= {"model", "train", "test", "epochs", "seconds"}
    test = answer["test"]
    assert not set(test["references"]) & set(answer["train"]["references"])
    assert test["position_rmse_m"] < 0.7 * test["nominal"]["position_rmse_m"]
    train = answer["train"]
    assert train["position_rmse_m"] < 0.6 * train["nominal"]["position_rmse_m"]
    model = read_model(output, vehicle_id=load_vehicle("research").id)
    assert model.id == answer["model_id"]
    assert model.network is not None
    assert model.network.layout.hidden == (16,)
    assert len(model.data) == len(answer["train"]["flights"])
    assert model.region is not None
    assert model.region.speed_max_m_s > 1.0
    assert str(tmp_path) not in output.read_text()


def test_learn_verb_writes_nothing_where_it_cannot_learn(logs, tmp_path, capsys):
    output = tmp_path / "out.model.toml"
    assert main(["learn", str(logs[0]), "-o", str(output)]) == 2
    assert "too few to learn from" in capsys.readouterr().err
    assert main(["learn", str(logs[0]), "-o", str(tmp_path / "out.toml")]) == 2
    assert main(["learn", "-o", str(output)]) == 2
    assert main(["learn", str(logs[0]), "--hidden", "64", "-o", str(output)]) == 2
    assert not list(tmp_path.iterdir())


def test_learn_same_seed_gives_the_same_model(logs):
    flights = [read_flight(path) for path in logs[:2]]
    settings = Settings(hidden=(8,), epochs=1)
    ids = {learn(flights, settings=settings, seed=3).model.id for _ in range(2)}
    assert len(ids) == 1
    assert learn(flights, settings=settings, seed=4).model.id not in ids


def test_learn_on_a_traced_model_keeps_its_effects_and_starts_from_them(logs):
    from host.effects import load_effects

    effects = load_effects()
    flights = [read_flight(path) for path in logs]
    base = Model(
        vehicle_id=flights[0].vehicle.id,
        vehicle_name="research",
        effects={"linear-drag": {"dx": 0.8, "dy": 0.7, "dz": 0.3}},
        adjustments={"inertia": {"x": 0.01}},
    )
    settings = Settings(hidden=(8,), epochs=2)
    found = learn(flights, base=base, effects=effects, settings=settings)
    plain = learn(flights, settings=settings)
    assert found.model.effects == base.effects
    assert found.train.nominal.position_rmse_m < 0.3 * plain.train.nominal.position_rmse_m


def test_learn_two_vehicles_or_a_shared_reference_are_refused(logs):
    flights = [read_flight(path) for path in logs]
    other = dataclasses.replace(flights[1], vehicle=load_vehicle("nano"))
    with pytest.raises(TooLittleData, match="learn from one vehicle at a time"):
        learn([flights[0], other])
    with pytest.raises(TooLittleData, match="share the reference"):
        learn(flights[:1] + flights[2:], hold_out=flights[1:2])
