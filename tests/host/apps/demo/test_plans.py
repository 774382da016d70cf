"""The demo's plans: more time where a first plan fails, none where the second does."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from trimtab.host.apps.demo import plans
from trimtab.host.apps.demo.plans import Planned, fastest, plan_again, plan_first
from trimtab.host.base.errors import Refused
from trimtab.host.plan import Plan, PlanRefused, Weights
from trimtab.host.route import Route
from trimtab.host.vehicle import Vehicle

ROUTE = Route(name="hop", waypoints_m=((0.0, 0.0, -1.0), (2.0, 0.0, -1.2)), total_time_s=2.0)


def planner(monkeypatch: pytest.MonkeyPatch, refusals: int) -> list[dict[str, Any]]:
    """Puts a planner in place that refuses so often; what it was asked for is in the list."""
    asked: list[dict[str, Any]] = []

    def plan(route: Route, vehicle: Vehicle, **asked_for: Any) -> Any:
        asked.append(asked_for)
        if len(asked) <= refusals:
            raise PlanRefused(f"node 3 tilts too far ({len(asked)})")
        return SimpleNamespace(mean_speed_m_s=1.0)

    monkeypatch.setattr(plans, "plan", plan)
    return asked


def test_first_plan_that_is_refused_gets_more_time(vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = planner(monkeypatch, refusals=2)
    planned = plan_first(ROUTE, vehicle)
    assert [call["total_time_s"] for call in asked] == [2.0, 2.3, 2.64]
    assert planned.time_s == 2.64
    assert planned.route is ROUTE


def test_first_plan_that_stays_refused_ends_with_its_last_reason(
    vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    planner(monkeypatch, refusals=99)
    with pytest.raises(PlanRefused, match="node 3 tilts too far \\(4\\)") as caught:
        plan_first(ROUTE, vehicle)
    assert caught.value.exit_code == 1


FIRST = Planned(name="hop", route=ROUTE, time_s=2.3, plan=cast(Plan, SimpleNamespace()))
MODEL: Any = object()


def test_second_plan_gets_the_first_ones_time_and_no_more(
    vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = planner(monkeypatch, refusals=0)
    again = plan_again(FIRST, vehicle, MODEL, {}, lambda plan: 0.1).planned
    assert (again.name, again.time_s, again.route) == ("hop-again", 2.3, ROUTE)
    weights = [call.pop("settings").weights.control / Weights().control for call in asked]
    assert weights == pytest.approx([1.0, 4.0, 16.0])
    assert asked == 3 * [{"kind": "min-residual", "model": MODEL, "effects": {}, "total_time_s": 2.3}]


def test_second_plan_is_the_one_predicted_to_fly_best(
    vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    planner(monkeypatch, refusals=1)
    predictions = iter([0.03, 0.02])
    choice = plan_again(FIRST, vehicle, MODEL, {}, lambda plan: next(predictions))
    assert choice.predicted_rmse_m == 0.02
    assert choice.plans == 2


def test_second_plan_that_no_effort_makes_possible_is_refused(
    vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    planner(monkeypatch, refusals=3)
    with pytest.raises(Refused, match="hop planned again with the traced model: node 3") as caught:
        plan_again(FIRST, vehicle, MODEL, {}, lambda plan: 0.1)
    assert caught.value.exit_code == 1


@pytest.fixture
def at() -> Callable[[str, float], Planned]:
    """A plan with this mean speed."""

    def make(name: str, speed_m_s: float) -> Planned:
        plan: Any = SimpleNamespace(mean_speed_m_s=speed_m_s)
        return Planned(name=name, route=ROUTE, time_s=2.0, plan=plan)

    return make


def test_fastest_is_the_plan_of_the_greatest_mean_speed(at: Callable[[str, float], Planned]) -> None:
    assert fastest([at("a", 1.0), at("b", 3.0), at("c", 3.0), at("d", 2.0)]).name == "b"
