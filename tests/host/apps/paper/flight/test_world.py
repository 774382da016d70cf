"""Learning, prediction, controllers, and the pretzel on logs in the test data and in one flight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.narrowing import not_none
from tests.rate_controller import RateController
from tests.sessions.conftest import figure_eight
from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.flight import models, pretzel
from trimtab.host.apps.paper.flight.controllers import (
    BASELINE,
    MPC,
    MPC_L1,
    MPC_NEURAL,
    NEURAL,
    NEURAL_OBSERVER,
    OBSERVER,
    Controller,
    on_board,
    on_host,
)
from trimtab.host.apps.paper.flight.world import TEST_FLIGHTS, WORLD, split
from trimtab.host.base.errors import FlightFailed
from trimtab.host.effects import load_effects
from trimtab.host.learn import CondensedSettings, learn
from trimtab.host.learn.evaluate import model_errors
from trimtab.host.link.host_control import HostControl
from trimtab.host.log import read_flight
from trimtab.host.log.tracking import tracking_error
from trimtab.host.models.correction import correction
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.region import Region
from trimtab.host.plan import ResidualModel
from trimtab.host.vehicle import load_vehicle

pytestmark = pytest.mark.usefixtures("virtual_machine")

DATA = Path(__file__).parents[4] / "data"
VEHICLE = load_vehicle("research")
EFFECTS = load_effects()
REGION = Region(speed_max_m_s=4.0, tilt_max_deg=45.0, thrust_min_n=3.0, thrust_max_n=12.0)


def model(*, network: bool = True) -> Model:
    layout = Layout(hidden=(4,))
    xi = 0.1 * np.random.default_rng(0).standard_normal(layout.size)
    return Model(
        vehicle_id=VEHICLE.id,
        vehicle_name=VEHICLE.name,
        effects={"linear-drag": {"dx": 0.4, "dy": 0.4, "dz": 0.1}} if not network else {},
        network=Network(layout=layout, xi=xi) if network else None,
        region=REGION,
    )


def test_learn_as_paper_predicts_better_and_leaves_unweighted_axes_alone():
    flights = [read_flight(DATA / "a1.mcap")]
    learned = models.learn_as_paper(flights, 1, epochs=60)
    assert not_none(learned.network).layout.hidden == (32, 32, 32)
    assert learned.effects == {}
    nominal, hybrid = (
        models.predict(flights, each, EFFECTS, horizons=[models.SEGMENTS])[models.SEGMENTS]
        for each in (None, learned)
    )
    assert hybrid.position_rmse_m < 0.97 * nominal.position_rmse_m
    assert models.PAPER_WEIGHT.tolist() == [1, 1, 0, 0.1, 0.1, 0, 0.1, 0.1, 0, 0, 0, 0]


def test_predict_whole_flights_are_those_of_the_library_and_segments_err_less():
    flights = [read_flight(DATA / "a1.mcap")]
    found = models.predict(flights, None, EFFECTS, horizons=(models.FLIGHTS, models.SEGMENTS))
    assert list(found) == [models.FLIGHTS, models.SEGMENTS]
    assert found[models.FLIGHTS] == model_errors(flights, None, EFFECTS)
    assert 0.0 < found[models.SEGMENTS].position_rmse_m < found[models.FLIGHTS].position_rmse_m


def test_predict_ahead_is_that_of_learn_for_flights_held_out(tmp_path):
    field = Airfield(vehicle=VEHICLE, world=WORLD, world_seed=9100, session={"seed": "0"})
    steered = HostControl(controller=RateController(VEHICLE), name="outer-loop", settings_id="0" * 12)
    for name, duration_s, control in (("on-board", 9.0, None), ("on-host", 6.0, steered)):
        reference = figure_eight(VEHICLE, duration_s=duration_s, size_m=0.8)
        field.fly(reference, 1, tmp_path / f"{name}.mcap", control=control)
    used, *flights = (read_flight(tmp_path / f"{name}.mcap") for name in ("on-board", "on-host"))
    found = models.predict(flights, None, EFFECTS, horizons=[models.AHEAD])
    learned = learn(
        [used],
        hold_out=flights,
        effects=EFFECTS,
        settings=CondensedSettings(layout=None),
        forms=("linear-drag",),
    )
    assert found == {models.AHEAD: not_none(learned.test).nominal}


def test_with_torque_gives_all_models_that_of_ours_and_nothing_else():
    torque = {"com-offset": {"x": 0.001, "y": -0.002}}
    ours = replace(model(network=False), effects={**model(network=False).effects, **torque})
    given = {"nominal": None, models.PAPER: model(), models.OURS: ours}
    found = models.with_torque(given, VEHICLE)
    assert found[models.OURS] is ours
    assert (not_none(found["nominal"]).effects, not_none(found["nominal"]).network) == (torque, None)
    paper = not_none(found[models.PAPER])
    assert (paper.effects, paper.network) == (torque, not_none(given[models.PAPER]).network)
    assert models.with_torque({**given, models.OURS: model()}, VEHICLE)["nominal"] is None


def test_split_draws_three_known_flights_for_the_test():
    drawn: Any = [SimpleNamespace(name=f"p{k}", out_of_distribution=False) for k in range(16)]
    drawn += [SimpleNamespace(name=f"o{k}", out_of_distribution=True) for k in range(3)]
    flown: Any = {c.name: c.name for c in drawn if c.name not in ("p3", "o1")}
    sets: Any = split(drawn, flown, np.random.default_rng(4))
    assert (len(sets["train"]), len(sets["test"])) == (15 - TEST_FLIGHTS, TEST_FLIGHTS)
    assert sets["ood"] == ["o0", "o2"]
    assert sorted(sets["train"] + sets["test"]) == sorted(n for n in flown if n.startswith("p"))


def test_split_without_a_flight_out_of_distribution_is_refused():
    drawn: Any = [SimpleNamespace(name=f"p{k}", out_of_distribution=k == 4) for k in range(5)]
    flown: Any = {c.name: c.name for c in drawn[:4]}
    with pytest.raises(FlightFailed, match="ood"):
        split(drawn, flown, np.random.default_rng(4))


def test_on_board_with_a_feedforward_are_the_four_of_the_paper():
    blob = not_none(correction(model(), VEHICLE, EFFECTS).feedforward)
    by_name = {law.name: law for law in on_board(VEHICLE, blob)}
    assert list(by_name) == [BASELINE, OBSERVER, NEURAL, NEURAL_OBSERVER]
    assert by_name[NEURAL].feedforward is by_name[NEURAL_OBSERVER].feedforward is blob
    assert by_name[OBSERVER].feedforward is None
    observed = {name for name, law in by_name.items() if law.parameters.get("OBS_GAIN", 0.0) > 0.0}
    assert observed == {OBSERVER, NEURAL_OBSERVER}
    assert [law.name for law in on_board(VEHICLE)] == [BASELINE, OBSERVER]


def test_on_host_are_the_shipped_mpc_and_one_has_the_model():
    learned = model()
    laws = on_host(VEHICLE, learned, EFFECTS)
    assert [law.name for law in laws] == [MPC, MPC_L1, MPC_NEURAL]
    assert [not_none(law.control).name for law in laws] == [MPC, MPC_L1, MPC_NEURAL]
    assert [not_none(law.control).model_id for law in laws] == [None, None, learned.id]
    assert all(law.feedforward is None and not law.parameters for law in laws)


def test_pretzel_plans_share_time_and_ends_and_have_the_papers_steps():
    plans = pretzel.plans(VEHICLE, ResidualModel.of(model(network=False), EFFECTS))
    assert [p.duration_s for p in plans.values()] == pytest.approx([0.03 * pretzel.NODES] * 2)
    residual = plans[pretzel.MIN_RESIDUAL]
    assert residual.intervals == pretzel.NODES
    assert residual.lambda_r == pytest.approx(pretzel.LAMBDA_R)
    ends = [np.array(plan.reference.nodes_ned()[-1].state[:3]) for plan in plans.values()]
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-3)
    assert all(min(plan.margins.values()) >= 0.0 for plan in plans.values())


def test_fly_pretzel_flies_every_combination_and_keeps_a_pose_each_tenth_of_a_second(tmp_path):
    field = Airfield(vehicle=VEHICLE, world=WORLD, world_seed=9100, session={"seed": "0"})
    laws = on_board(VEHICLE)
    known = ResidualModel.of(model(network=False), EFFECTS)
    found = pretzel.fly_pretzel(field, known, laws, tmp_path, flights=[101])
    assert [(f["kind"], f["controller"]) for f in found["flights"]] == [
        (kind, law.name) for kind in pretzel.KINDS for law in laws
    ]
    first = found["flights"][0]
    error = not_none(tracking_error(read_flight(tmp_path / "pretzel-min-snap-baseline-101.mcap")))
    assert (first["error_mean_m"], first["error_max_m"]) == pytest.approx((error.mean_m, error.max_m))
    assert len(first["errors_m"]) == len(first["path_ned_m"]) == 84
    constant_m = np.linalg.norm(first["constant_ned_m"])
    assert first["error_mean_m"] <= constant_m + first["varying_mean_m"]
    assert found["flights"][1]["varying_mean_m"] < first["varying_mean_m"]
    assert np.linalg.norm(found["flights"][1]["constant_ned_m"]) < 0.2 * constant_m  # the observer takes it
    legs_m, path_m = (found["plans"]["min-snap"][key] for key in ("legs_length_m", "path_length_m"))
    assert 0.8 * path_m < legs_m < path_m
    assert found["flights"][1]["error_mean_m"] < 0.6 * first["error_mean_m"]  # by the observer


def test_fly_pretzel_flight_that_fails_is_a_row_with_the_reason(tmp_path):
    def fails(*of: Any, **how: Any) -> None:
        raise FlightFailed("tilted")

    field: Any = SimpleNamespace(vehicle=VEHICLE, fly=fails)
    known = ResidualModel.of(model(network=False), EFFECTS)
    found = pretzel.fly_pretzel(field, known, [Controller(name=BASELINE)], tmp_path, flights=[101])
    rows = [{"kind": k, "controller": BASELINE, "flight": 101, "failed": "tilted"} for k in pretzel.KINDS]
    assert found["flights"] == rows


def test_fly_pretzel_with_nothing_learned_says_why_there_is_no_plan(tmp_path):
    field: Any = SimpleNamespace(vehicle=VEHICLE)
    found = pretzel.fly_pretzel(field, ResidualModel(), on_board(VEHICLE), tmp_path, flights=[101])
    assert (found["plans"], found["flights"]) == ({}, [])
    assert found["failed"] is not None
