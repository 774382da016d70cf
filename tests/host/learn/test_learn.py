"""`trimtab learn` on flights of a vehicle in a world with drag: from logs to a model file."""

from __future__ import annotations

import dataclasses
import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.cli import main
from trimtab.host.effects import load_effects
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, Judged, Learned, Settings, learn
from trimtab.host.learn.candidates import Trial
from trimtab.host.learn.evaluate import Errors
from trimtab.host.learn.train import Trained
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.file import read_model, write_model
from trimtab.host.models.model import Assessment, Covariance, Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Reference
from trimtab.sitl.vehicle import SimulatedVehicle

pytestmark = pytest.mark.usefixtures("virtual_machine")

MADE = Path(__file__).parents[2] / "data"
WORLD = "[effects.linear-drag]\ndx = 0.8\ndy = 0.7\ndz = 0.3\n"


@pytest.fixture(scope="module")
def logs(tmp_path_factory, make_states) -> list[Path]:
    """Flights of three references, the first flown twice."""
    folder = tmp_path_factory.mktemp("flights")
    (folder / "world.toml").write_text('description = "drag"\ntolerances = false\n' + WORLD)
    references = [make_states(seed, duration_s=6.0).reference for seed in (1, 1, 2, 3)]
    return [flight.path for flight in fly(folder / "world.toml", references, folder)]


def fly(world: Path, references: list[Reference], folder: Path) -> list[Flight]:
    """The references flown in a world, logged in a folder."""
    vehicle = load_vehicle("research")
    flights = []
    for index, reference in enumerate(references):
        start = reference.nodes_ned()[0].state
        simulated = SimulatedVehicle.create(
            vehicle, world=str(world), flight=index, start_ned=(start[0], start[1], 0.0)
        )
        path = folder / f"flight{index}.mcap"
        with closing(simulated):
            fly_lockstep(FlightRequest(vehicle=vehicle, reference=reference, log_path=path), simulated)
        flights.append(read_flight(path))
    return flights


@pytest.mark.full  # beside test_condensed.py, which finds late poses without the flights
def test_learn_finds_late_poses_beside_drag(make_states, tmp_path):
    """Poses that are late on board and in the log: an effect, learned with the loop that they are late in."""
    world = tmp_path / "world.toml"
    late = "[effects.mocap-latency]\nlatency_s = 0.02\n"
    world.write_text('description = "late"\ntolerances = false\n' + WORLD + late)
    flights = fly(world, [make_states(seed, duration_s=6.0).reference for seed in (1, 2, 3)], tmp_path)
    settings = CondensedSettings(layout=None)
    learned = learn(
        flights, effects=load_effects(), settings=settings, forms=("linear-drag", "mocap-latency")
    )
    assert learned.model.effects["mocap-latency"]["latency_s"] == pytest.approx(0.02, abs=0.003)
    assert learned.model.effects["linear-drag"]["dx"] == pytest.approx(0.8, rel=0.1)
    assert learned.test is not None
    assert learned.test.ratio < 0.2


def test_learn_verb_drag_lowers_the_error_on_a_reference_held_out(logs, tmp_path, capsys):
    output = tmp_path / "out.model.toml"
    words = ["learn", *map(str, logs), "-o", str(output), "--epochs", "40", "--hidden", "16", "--json"]
    assert main([*words, "--as-asked"]) == 0
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


def test_learn_verb_effects_beside_the_network_are_in_the_model(logs, tmp_path, capsys):
    output = tmp_path / "out.model.toml"
    assert main(["learn", *map(str, logs), "-o", str(output), "--hidden", "8", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["test"]["position_rmse_m"] < 0.4 * answer["test"]["nominal"]["position_rmse_m"]
    model = read_model(output, vehicle_id=load_vehicle("research").id)
    assert model.effects == answer["effects"]
    assert set(model.sources) == {"linear-drag", "com-offset"}
    words = ["learn", *map(str, logs), "-o", str(output), "--force", "--no-network", "--json"]
    assert main(words) == 0
    alone = json.loads(capsys.readouterr().out.splitlines()[-1])["effects"]["linear-drag"]
    np.testing.assert_allclose([alone["dx"], alone["dy"]], [0.8, 0.7], rtol=0.1)
    assert read_model(output, vehicle_id=load_vehicle("research").id).network is None


def test_learn_verb_on_a_traced_model_keeps_its_delay_and_learns_what_it_leaves(logs, tmp_path, capsys):
    """Every trace adjusts the delay of commands, for which RK4 needs shorter steps than the grid's."""
    vehicle, traced, output = load_vehicle("research"), tmp_path / "t.model.toml", tmp_path / "out.model.toml"
    adjustments = {"actuation-delay": {"delay_s": 2e-4}, "linear-drag": {"dx": 0.01, "dy": 0.01, "dz": 0.0}}
    names = ("actuation-delay.delay_s", "linear-drag.dx")
    base = Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        adjustments=adjustments,
        covariance=Covariance(names=names, matrix=((1e-8, 0.0), (0.0, 1e-4))),
        assessment=Assessment(verdict="traced"),
    )
    write_model(base, traced)
    words = ["learn", *map(str, logs), "--model", str(traced), "-o", str(output), "--hidden", "8", "--json"]
    assert main(words) == 0
    test = json.loads(capsys.readouterr().out.splitlines()[-1])["test"]
    assert test["position_rmse_m"] < 0.4 * test["base"]["position_rmse_m"]
    model = read_model(output, vehicle_id=vehicle.id)
    assert (model.adjustments, model.network is None) == (adjustments, False)
    assert main([*words, "--force", "--no-network", "--effects", "linear-drag"]) == 0
    model = read_model(output, vehicle_id=vehicle.id)
    np.testing.assert_allclose(model.effects["linear-drag"]["dx"], 0.8, rtol=0.1)
    assert set(model.adjustments) == {"actuation-delay"}
    assert model.covariance is not None
    assert model.covariance.names == names[:1]


def test_learn_verb_networks_in_the_bodys_frame_are_kept_as_such(logs, tmp_path, capsys):
    output = tmp_path / "out.model.toml"
    words = [
        "learn",
        *map(str, logs),
        "-o",
        str(output),
        "--hidden",
        "8",
        "--frame",
        "body",
        "--effects",
        "none",
    ]
    assert main([*words, "--json"]) == 0
    test = json.loads(capsys.readouterr().out.splitlines()[-1])["test"]
    assert test["position_rmse_m"] < 0.4 * test["nominal"]["position_rmse_m"]
    network = read_model(output, vehicle_id=load_vehicle("research").id).network
    assert network is not None
    assert network.layout == Layout(hidden=(8,), frame="body")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--effects", "lnear-drag"], "--effects lnear-drag: no such effect; available are"),
        (["--no-network", "--effects", "none"], "nothing to learn; leave out --no-network"),
        (["--method", "paper", "--frame", "body"], "learns only a network in the world frame"),
    ],
)
def test_learn_verb_refuses_what_does_not_go_together(logs, tmp_path, capsys, words, told):
    assert main(["learn", str(logs[0]), "-o", str(tmp_path / "x.model.toml"), *words]) == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_learn_same_seed_gives_the_same_model(logs):
    flights = [read_flight(path) for path in logs[:2]]
    settings = Settings(hidden=(8,), epochs=1)
    ids = {learn(flights, settings=settings, seed=3).model.id for _ in range(2)}
    assert len(ids) == 1
    assert learn(flights, settings=settings, seed=4).model.id not in ids


def test_learn_on_a_traced_model_keeps_its_effects_and_starts_from_them(logs):
    from trimtab.host.effects import load_effects

    effects = load_effects()
    flights = [read_flight(path) for path in logs]
    base = Model(
        vehicle_id=flights[0].vehicle.id,
        vehicle_name="research",
        effects={"linear-drag": {"dx": 0.8, "dy": 0.7, "dz": 0.3}},
        adjustments={"inertia": {"x": 1.01}},
    )
    settings = Settings(hidden=(8,), epochs=2)
    found = learn(flights, base=base, effects=effects, settings=settings)
    plain = learn(flights, settings=settings)
    assert found.model.effects == base.effects
    assert found.train.base.position_rmse_m < 0.3 * plain.train.base.position_rmse_m
    assert found.train.nominal == plain.train.nominal == plain.train.base
    answer = found.train.to_json()
    assert answer["base"]["position_rmse_m"] < 0.3 * answer["nominal"]["position_rmse_m"]
    assert found.train.ratio == found.train.learned.position_rmse_m / found.train.base.position_rmse_m


def test_learn_on_a_model_with_latency_judges_the_nominal_vehicle_without_it(logs):
    from trimtab.host.effects import load_effects

    effects = load_effects()
    flights = [read_flight(path) for path in logs[:2]]
    base = Model(
        vehicle_id=flights[0].vehicle.id,
        vehicle_name="research",
        effects={"mocap-latency": {"latency_s": 0.02}},
    )
    settings = Settings(hidden=(8,), epochs=1)
    found = learn(flights, base=base, effects=effects, settings=settings)
    assert found.train.nominal == learn(flights, settings=settings).train.nominal
    assert found.train.base != found.train.nominal


def test_learn_two_vehicles_or_a_shared_reference_are_refused(logs):
    flights = [read_flight(path) for path in logs]
    other = dataclasses.replace(flights[1], vehicle=load_vehicle("nano"))
    with pytest.raises(TooLittleData, match="learn from one vehicle at a time"):
        learn([flights[0], other])
    with pytest.raises(TooLittleData, match="share the reference"):
        learn(flights[:1] + flights[2:], hold_out=flights[1:2])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--hidden", "64"], "--hidden 64: give 1 to 3 widths of 1 to 32 each"),
        (["--hidden", "0"], "--hidden 0: give"),
        (["--hidden", "8", "8", "8", "8"], "--hidden 8 8 8 8: give"),
        (["--epochs", "0"], "--epochs 0: give 1 or more"),
        (["--seed", "-1"], "--seed -1: give 0 or more"),
        (["--model", "{folder}/nope.toml"], "nope.toml: cannot be read (No such file or directory); give a"),
    ],
)
def test_learn_verb_with_an_impossible_option_names_it(logs, tmp_path, capsys, words, said):
    output = tmp_path / "out.model.toml"
    words = [word.format(folder=tmp_path) for word in words]
    assert main(["learn", str(logs[0]), *words, "-o", str(output)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert not list(tmp_path.iterdir())


def judged(base_m: float, learned_m: float) -> Judged:
    nominal, base, learned = (
        Errors(position_rmse_m=value, velocity_rmse_m_s=0.1) for value in (1.0, base_m, learned_m)
    )
    return Judged(flights=("a",), references=("b",), nominal=nominal, base=base, learned=learned, outside=0.0)


@pytest.mark.parametrize(
    ("train", "test", "improved"),
    [
        ((0.02, 0.01), None, True),
        ((0.02, 0.02), None, False),
        ((0.02, 0.01), (0.010, 0.012), False),
        ((0.02, 0.03), (0.010, 0.009), False),
        ((0.02, 0.01), (0.010, 0.009), True),
        ((0.02, 0.01), (0.010, float("inf")), False),
    ],
)
def test_model_that_predicts_some_flights_no_better_has_not_improved(train, test, improved):
    losses = np.zeros(2)
    network = Network(layout=Layout(hidden=(1,)), xi=np.zeros(Layout(hidden=(1,)).size))
    kept = Trial(what="network", train=judged(*train).learned, test=None)
    learned = Learned(
        model=Model(vehicle_id="0" * 12, vehicle_name="v", network=network),
        train=judged(*train),
        test=None if test is None else judged(*test),
        trials=(kept,),
        selected=kept,
        trained=Trained(network=network, epochs=1, best_epoch=0, train_loss=losses, validation_loss=losses),
        segments=8,
    )
    assert learned.improved is improved


@pytest.mark.parametrize("seed", ["0", "1"])
@pytest.mark.parametrize("as_asked", [False, True])
def test_learn_verb_writes_no_model_that_is_no_better_unless_asked_to(tmp_path, capsys, seed, as_asked):
    # One epoch of a single neuron: from the first of these seeds it finds nothing.
    better = seed == "1"
    output = tmp_path / "out.model.toml"
    words = ["--hold-out", str(MADE / "b1.mcap"), "-o", str(output), "--epochs", "1", "--hidden", "1"]
    words += ["--method", "paper", "--no-any-heading", "--seed", seed, "--json", *["--as-asked"] * as_asked]
    assert main(["learn", str(MADE / "a1.mcap"), *words]) == (0 if better or as_asked else 1)
    told = capsys.readouterr()
    answer = json.loads(told.out.splitlines()[-1])
    assert answer["improved"] is better
    assert [each["what"] for each in answer["candidates"]] == ["nothing", "network"]
    assert answer["kept"] == ("network" if better or as_asked else "nothing")
    assert output.is_file() is (better or as_asked)
    assert (answer["model"] is None) is (answer["model_id"] is None) is not output.is_file()
    assert ("42.1 mm (held out) off with nothing learned" in answer["notes"][0]) is not better
    assert (f"{output}: not written" in told.err) is not output.is_file()


@pytest.mark.full  # beside the effects that the command line learns above, com-offset among them
def test_learn_a_standing_torque_is_no_acceleration(make_states, tmp_path):
    """The law's integral stands against it at every segment's start: the default learns what it is."""
    world = tmp_path / "world.toml"
    world.write_text(
        'description = "torque"\ntolerances = false\n[effects.com-offset]\nx = 0.006\ny = -0.004\n'
    )
    flights = fly(world, [make_states(seed, duration_s=6.0).reference for seed in (1, 2, 3)], tmp_path)
    settings = CondensedSettings(layout=Layout(hidden=(8,)))
    learned = learn(flights, effects=load_effects(), settings=settings, forms=DEFAULT_FORMS)
    assert learned.model.effects["com-offset"]["x"] == pytest.approx(0.006, rel=0.1)
    assert learned.model.effects["com-offset"]["y"] == pytest.approx(-0.004, rel=0.1)
    assert learned.train.ratio < 0.4
    network = learn(flights, effects=load_effects(), settings=settings)
    assert network.trials[-1].train.position_rmse_m > 2.0 * learned.train.learned.position_rmse_m
