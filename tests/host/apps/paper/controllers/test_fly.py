"""Plans and flights of the study: what a row holds, and what becomes of plans and models that fail."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.controllers.fly import Course, TimedController, fly_controller, pilot
from trimtab.host.apps.paper.controllers.models import Site
from trimtab.host.apps.paper.controllers.pieces import PAPER_DURATION_S, WORLDS, paper_course, timed
from trimtab.host.apps.paper.controllers.table import CONTROLLERS, MIN_SNAP
from trimtab.host.base.errors import UsageError
from trimtab.host.control.interface import ControlStep, RateCommand, SolveStatus, StateEstimate
from trimtab.host.effects import load_effects
from trimtab.host.models.model import Model
from trimtab.host.plan import Settings, plan
from trimtab.host.route import Route
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Reference

VEHICLE = load_vehicle("research")
HOP = Route(name="hop", waypoints_m=((0.0, 0.0, -1.0), (1.0, 0.0, -1.2)), total_time_s=2.0)
COURSE = Course(route=HOP, flight=7, settings=Settings())
BY_NAME = {each.name: each for each in CONTROLLERS}
DRAG = Model(
    vehicle_id=VEHICLE.id,
    vehicle_name=VEHICLE.name,
    effects={"linear-drag": {"dx": 0.5, "dy": 0.5, "dz": 0.1}},
)
EMPTY = Model(vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name)


@pytest.fixture
def site() -> Site:
    """A site whose models hold a drag, and one that holds nothing."""
    field = Airfield(vehicle=VEHICLE, world="paper-drag", world_seed=3, session={})
    models = dict.fromkeys(("ours", "ours-labels", "closed-form", "paper-labels"), DRAG) | {"paper": EMPTY}
    return Site(field=field, models=models, effects=load_effects(), selected="effects")


class Echo:
    """A controller that sends what it is asked at."""

    period_us = 25_000

    def __init__(self) -> None:
        """Begin with no reference."""
        self.begun: list[Reference] = []

    def begin(self, reference: Reference) -> None:
        """Remember the reference."""
        self.begun.append(reference)

    def step(self, estimate: StateEstimate, sent: Sequence[RateCommand], act_us: int) -> ControlStep:
        """Return a command at `act_us`."""
        command = RateCommand(act_us, estimate.rate_frd, float(len(sent)))
        return ControlStep(command=command, status=SolveStatus.SOLVED, iterations=1)


def test_timed_controller_passes_everything_on_and_forgets_times_of_the_flight_before():
    inner = Echo()
    controller = TimedController(inner)
    reference = plan(HOP, VEHICLE).reference
    zero = (0.0, 0.0, 0.0)
    estimate = StateEstimate(0, zero, zero, (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3))
    assert controller.period_us == 25_000
    controller.begin(reference)
    controller.step(estimate, [], 10_000)
    controller.begin(reference)
    found = controller.step(estimate, [], 35_000)
    assert found.command == RateCommand(35_000, (0.1, 0.2, 0.3), 0.0)
    assert inner.begun == [reference, reference]
    assert len(controller.steps_ms) == 1
    assert controller.times()["step_ms_p99"] >= 0.0


@pytest.mark.parametrize("name", ["dfbc-traced-do", "mpc-traced"])
def test_row_of_a_flight_has_its_error_and_no_log_remains(site: Site, tmp_path: Path, name: str):
    plans = {MIN_SNAP: plan(HOP, VEHICLE)}
    (row,) = fly_controller(site, COURSE, BY_NAME[name], "ours", plans, tmp_path)
    assert (row["controller"], row["regressor"], row["trajectory"]) == (name, "ours", MIN_SNAP)
    assert row["failed"] is None
    assert 0.0 < row["error_mean_m"] < row["error_max_m"] < 0.1
    assert ("step_ms_p50" in row) == name.startswith("mpc")
    assert list(tmp_path.iterdir()) == []


def test_pilot_is_what_the_controller_file_says(site: Site):
    plain, observer = (pilot(BY_NAME[name], "ours", site) for name in ("dfbc", "dfbc-do"))
    assert set(observer.flown_by.parameters) == {"OBS_GAIN", *plain.flown_by.parameters}
    assert observer.feedforward is None
    both = pilot(BY_NAME["dfbc-neural-do"], "ours", site)
    assert both.flown_by.parameters == observer.flown_by.parameters
    assert both.feedforward is not None
    assert both.feedforward.model_id == DRAG.id
    assert "OBS_GAIN" not in plain.flown_by.parameters


def test_model_without_anything_to_feed_forward_is_a_failure_of_its_controllers(site: Site, tmp_path: Path):
    with pytest.raises(UsageError):
        pilot(BY_NAME["dfbc-neural"], "paper", site)
    rows = fly_controller(
        site, COURSE, BY_NAME["dfbc-neural"], "paper", {MIN_SNAP: plan(HOP, VEHICLE)}, tmp_path
    )
    assert [row["failed"].startswith("controller: ") for row in rows] == [True]


def test_plan_that_is_refused_is_a_failure_of_its_row(site: Site, tmp_path: Path):
    impossible = Course(route=timed(HOP, 0.1), flight=7, settings=Settings())
    plans = impossible.plans(VEHICLE, DRAG, (MIN_SNAP,))
    (row,) = fly_controller(site, impossible, BY_NAME["dfbc"], "ours", plans, tmp_path)
    assert row["failed"].startswith("plan: ")
    assert "error_mean_m" not in row


def test_paper_course_is_flown_by_min_snap_in_ten_seconds():
    route = paper_course(VEHICLE, 3, 0)
    assert plan(route, VEHICLE).duration_s == pytest.approx(PAPER_DURATION_S)
    assert paper_course(VEHICLE, 3, 0) == route
    assert paper_course(VEHICLE, 3, 1).waypoints_m != route.waypoints_m


@pytest.mark.parametrize("world", WORLDS.values())
def test_world_of_the_study_exists(world: str):
    Airfield(vehicle=VEHICLE, world=world, world_seed=0, session={}).check()
