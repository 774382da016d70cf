"""The trade between residual and jerk: dearer thrusts, calmer plans; a plan that fails is a row."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.parts import part
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.base.errors import UsageError
from trimtab.host.plan import PlanRefused, PlanUnsolved, ResidualModel, Settings, Weights, plan
from trimtab.host.plan.flown import Flown
from trimtab.host.plan.pareto import COLUMNS, Point, pareto, tabulate
from trimtab.host.plan.table import evaluate, from_reference
from trimtab.host.route import Route
from trimtab.host.shooting.problem import SolveStatus
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
DRAG = ResidualModel(parts=(part("linear-drag", 0.5, 0.4, 0.1),))
ROUTE = Route(
    name="short",
    waypoints_m=((-1.6, -0.9, -1.2), (1.7, 1.2, -1.6), (0.0, 2.4, -2.0), (-2.0, 0.0, -1.4)),
    total_time_s=4.6,
)


@pytest.fixture(scope="module")
def points() -> list[Point]:
    return pareto(ROUTE, VEHICLE, DRAG, factors=(10.0, 1.0, 0.1))


def test_pareto_has_the_other_kinds_first_and_then_the_factors_in_order(points: list[Point]) -> None:
    assert [point.label for point in points] == [
        "min-snap",
        "min-control",
        "min-residual x 0.1",
        "min-residual x 1",
        "min-residual x 10",
    ]
    assert all(point.status in ("solved", "acceptable") and point.reason is None for point in points)


def test_pareto_with_dearer_thrusts_is_calmer_and_leaves_more_residual(points: list[Point]) -> None:
    jerk = [point.jerk_rms_m_s3 or 0.0 for point in points[2:]]
    residual = [point.residual_rms_m_s2 or 0.0 for point in points[2:]]
    # The lightest weights let the path ripple; what keeps the limits then is no calmer path of less residual.
    assert jerk[1] > jerk[2]
    assert residual[1] < residual[2]
    assert residual[-1] < (points[0].residual_rms_m_s2 or 0.0)


def test_pareto_point_of_factor_one_is_the_plan_by_default(points: list[Point]) -> None:
    made, point = plan(ROUTE, VEHICLE, kind="min-residual", model=DRAG), points[3]
    assert point.plan is not None
    assert point.plan.reference == made.reference
    assert point.path_length_m == made.path_length_m
    table = from_reference(made.reference)
    jerk = evaluate(table, np.linspace(0.0, float(table.times_us[-1]), 3001))[3]
    assert point.jerk_rms_m_s3 == pytest.approx(np.sqrt((jerk**2).sum(axis=0).mean()), rel=2e-3)
    assert point.tilt_max_deg == pytest.approx(60.0 - made.margins["tilt_deg"], abs=0.2)
    most = VEHICLE.limits.thrust_headroom[1] - made.margins["thrust_high"]
    assert point.thrust_share_max == pytest.approx(most, abs=5e-3)


def test_pareto_tells_the_papers_lambda_r_of_the_plans_that_minimise_a_residual(points: list[Point]) -> None:
    least, middle, most = (point.lambda_r for point in points[2:])
    assert points[0].lambda_r is points[1].lambda_r is None
    assert least is not None
    assert (middle, most) == (pytest.approx(10.0 * least), pytest.approx(100.0 * least))
    hover_n = VEHICLE.mass_kg * GRAVITY / 4.0
    paper = Settings(weights=Weights(control=0.1 * hover_n**2), relative_weights=False)
    assert pareto(ROUTE, VEHICLE, DRAG, factors=(1.0,), settings=paper)[-1].lambda_r == pytest.approx(0.1)


def test_pareto_table_has_the_columns_of_flights_only_where_there_are_some(points: list[Point]) -> None:
    planned, _ = tabulate(points)
    assert set(COLUMNS) - set(planned) == {"flown", "clipped"}
    flown = Flown(log=Path("x.mcap"), error_mean_m=0.0517, clipped_share=0.002)
    units, rows = tabulate([points[0], replace(points[2], flown=flown)])
    assert tuple(units) == tuple(COLUMNS)
    told = [dict(zip(units, row, strict=True)) for row in rows]
    assert [(row["flown"], row["clipped"]) for row in told] == [("-", "-"), ("51.7", "0.20")]


def test_pareto_point_whose_flight_failed_tells_why(points: list[Point]) -> None:
    point = replace(points[2], flown=Flown(log=Path("x.mcap"), failure="too far"))
    assert point.why_not == "too far"
    assert point.to_json()["flight_failed"] == "too far"
    assert point.to_json()["error_mean_m"] is None
    assert points[2].why_not is None


def test_pareto_scales_thrusts_and_their_rates_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Weights] = []

    def refuse(*_: Any, settings: Settings, **__: Any) -> None:
        asked.append(settings.weights)
        raise PlanRefused("no way")

    monkeypatch.setattr("trimtab.host.plan.pareto.plan", refuse)
    base = Settings(weights=Weights(control=0.2, thrust_rate=0.1, yaw=50.0, time=3.0))
    pareto(ROUTE, VEHICLE, DRAG, factors=(2.0,), settings=base)
    assert asked == [base.weights] * 2 + [Weights(control=0.4, thrust_rate=0.2, yaw=50.0, time=3.0)]


def test_pareto_tells_of_plans_that_fail_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def give_up(*_: Any, kind: str, **__: Any) -> None:
        if kind == "min-snap":
            raise PlanRefused("too fast")
        raise PlanUnsolved("no luck", SolveStatus.ITERATIONS)

    monkeypatch.setattr("trimtab.host.plan.pareto.plan", give_up)
    seen: list[Point] = []
    found = pareto(ROUTE, VEHICLE, DRAG, factors=(1.0,), kind="min-residual*", on_point=seen.append)
    assert seen == found
    assert [(point.kind, point.status, point.reason) for point in found] == [
        ("min-snap", "refused", "too fast"),
        ("min-control*", "unsolved", "no luck"),
        ("min-residual*", "unsolved", "no luck"),
    ]
    assert found[0].residual_rms_m_s2 is found[0].path_length_m is found[0].jerk_rms_m_s3 is None
    assert found[0].cells()[:-1] == ("-",) * (len(COLUMNS) - 1)
    assert found[0].to_json()["reason"] == "too fast"


def test_pareto_of_a_route_too_fast_for_min_snap_has_the_others() -> None:
    tight = ROUTE.model_copy(update={"total_time_s": 3.0})
    with pytest.raises(PlanRefused):
        plan(tight, VEHICLE)
    found = pareto(tight, VEHICLE, DRAG, factors=(1.0,))
    assert (found[0].status, found[0].plan) == ("refused", None)
    assert "node" in (found[0].reason or "")
    assert found[-1].plan is not None


@pytest.mark.parametrize("kind", ["min-snap", "min-control*", "min-mistakes"])
def test_pareto_of_another_kind_is_refused(kind: str) -> None:
    with pytest.raises(UsageError, match="min-residual"):
        pareto(ROUTE, VEHICLE, DRAG, kind=kind)


def test_pareto_without_a_residual_to_minimise_is_refused() -> None:
    with pytest.raises(UsageError, match="no residual to minimise"):
        pareto(ROUTE, VEHICLE, ResidualModel())


@pytest.mark.parametrize("factors", [(), (0.0,), (1.0, float("nan"))])
def test_pareto_with_factors_that_are_none_is_refused(factors: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="factors"):
        pareto(ROUTE, VEHICLE, DRAG, factors=factors)
