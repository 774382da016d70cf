"""Tracking errors measured alike, and what is said of those that grew."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trimtab.host.apps.demo import report
from trimtab.host.apps.demo.compare import Comparison, Tracked, latency_of, tracked, what_got_worse
from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.demo.plans import Planned, plan_first
from trimtab.host.effects import load_effects
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.tracking import reference_at, tracking_error
from trimtab.host.models.model import Model, Values
from trimtab.host.route import Route
from trimtab.host.vehicle import Vehicle

LATENCY_S = 0.05
NOTHING: Any = {"no_new_plan": "nothing was traced", "no_applied": "nothing was traced"}


@pytest.fixture(scope="module")
def planned(vehicle: Vehicle) -> Planned:
    route = Route(name="hop", waypoints_m=((0.0, 0.0, -1.0), (2.0, 0.0, -1.2)), total_time_s=3.0)
    return plan_first(route, vehicle)


@pytest.fixture(scope="module")
def flight(airfield: Airfield, planned: Planned, tmp_path_factory: pytest.TempPathFactory) -> Flight:
    log = tmp_path_factory.mktemp("hop") / "hop.mcap"
    airfield.fly(planned.plan.reference, 1, log)
    return read_flight(log)


def seen_late(flight: Flight) -> Flight:
    """The flight as a camera would log it that shows a vehicle exactly on its reference, but late."""
    assert flight.mocap is not None
    assert flight.tracking is not None
    assert flight.reference is not None
    true_us = flight.mocap.t_us - round(1e6 * LATENCY_S) - flight.tracking[0]
    p = reference_at(flight.reference, true_us)[:, :3]
    return dataclasses.replace(flight, mocap=dataclasses.replace(flight.mocap, p=p))


def made(planned: Planned, label: str, scale_m: float, *, clipped: float = 0.0) -> Tracked:
    """A flight with errors of a given size on every axis."""
    return Tracked(
        label=label,
        log="x.mcap",
        planned=planned,
        p_ned=np.zeros((5, 3)),
        error_m=np.full((5, 3), scale_m),
        stamped_rmse_m=scale_m,
        predicted_rmse_m=None,
        clipped_share=clipped,
        battery_v=None,
    )


def no_prediction() -> Any:
    """A trace that held nothing out."""
    return SimpleNamespace(before=(), after=())


def test_tracked_without_latency_is_the_error_that_fly_tells(flight: Flight, planned: Planned) -> None:
    expected = tracking_error(flight)
    assert expected is not None
    found = tracked("x", flight, planned, latency_s=0.0)
    assert found.rmse_m == pytest.approx(expected.rmse_m, rel=1e-12)
    assert found.max_m == pytest.approx(expected.max_m, rel=1e-12)
    assert found.stamped_rmse_m == pytest.approx(expected.rmse_m, rel=1e-12)


def test_tracked_with_the_latency_of_the_poses_sees_where_the_vehicle_was(
    flight: Flight, planned: Planned
) -> None:
    late = seen_late(flight)
    found = tracked("x", late, planned, latency_s=LATENCY_S)
    assert found.max_m < 1e-9
    # As stamped it is behind by the way of the latency: RMSE of the speed times 0.05 s.
    v = np.linalg.norm(reference_at(planned.plan.reference, np.arange(0, 3_000_000, 1000))[:, 3:6], axis=1)
    assert found.stamped_rmse_m == pytest.approx(LATENCY_S * np.sqrt((v**2).mean()), rel=0.02)


def test_latency_of_a_trace_is_that_of_the_effect_it_names() -> None:
    def trace(effects: Values, adjustments: Values) -> Any:
        model = Model(vehicle_id="v", vehicle_name="n", effects=effects, adjustments=adjustments)
        return SimpleNamespace(model=model, space=SimpleNamespace(effects=load_effects()))

    late, other = {"mocap-latency": {"latency_s": 0.012}}, {"wind": {"wx": 1.0, "wy": 0.0}}
    assert latency_of(trace(effects={**other, **late}, adjustments={})) == 0.012
    assert latency_of(trace(effects=other, adjustments=late)) == 0.0


def test_comparison_pools_the_first_flights_and_tells_their_spread(planned: Planned) -> None:
    first = (made(planned, "a", 0.03), made(planned, "b", 0.04))
    comparison = Comparison(first=first, latency_s=0.0, **NOTHING)
    assert comparison.first_rmse_m == pytest.approx(np.sqrt(3.0 * (0.03**2 + 0.04**2) / 2.0))
    assert comparison.spread_m == pytest.approx(np.sqrt(3.0) * 0.01)
    answer = comparison.to_json()
    assert answer["tracking_rmse_new_plan_m"] is None
    assert answer["tracking_rmse_applied_m"] is None


def test_what_got_worse_names_every_figure_beyond_all_first_flights(planned: Planned) -> None:
    comparison = Comparison(
        first=(made(planned, "first flight 1", 0.03), made(planned, "first flight 2", 0.05)),
        new_plan=made(planned, "new plan", 0.06, clipped=0.01),
        applied=made(planned, "applied", 0.04),
        latency_s=0.0,
    )
    (line,) = what_got_worse(comparison, no_prediction(), {})
    for text in ("new plan: ", "tracking RMSE 86.6 to 103.9 mm", "RMSE down", "limits 0.00 to 1.00 %"):
        assert text in line


def test_what_got_worse_tells_predictions_by_flight_and_axis(planned: Planned) -> None:
    before, after = np.full((4, 3), 0.02), np.full((4, 3), 0.001)
    after[:, 2] = 0.03
    trace: Any = SimpleNamespace(
        before=[SimpleNamespace(p_error_ned=before, flight="aa")],
        after=[SimpleNamespace(p_error_ned=after, flight="aa")],
    )
    comparison = Comparison(first=(made(planned, "first", 0.05),), latency_s=0.0, **NOTHING)
    assert what_got_worse(comparison, trace, {"aa": "check 3"}) == [
        "Prediction of held-out flight check 3: down 20.0 to 30.0 mm."
    ]


def test_report_of_a_demo_without_a_second_plan_says_why(planned: Planned, vehicle: Vehicle) -> None:
    comparison = Comparison(first=(made(planned, "first flight 1", 0.03),), latency_s=0.0, **NOTHING)
    flown, worse = report.sections(comparison, no_prediction(), vehicle, {})["sections"]
    assert "No new plan was flown: nothing was traced." in flown["text"][0]
    assert len(flown["table"][0]) == 2
    assert "No measured error got worse" in worse["text"][0]
    assert report.summary(comparison.to_json()) == [
        "tracking error on route hop: 52.0 mm with the first plan",
        "  no new plan: nothing was traced",
        "  effects not applied: nothing was traced",
    ]


def test_report_of_a_demo_without_a_new_plan_says_what_flew_with_the_effects(
    planned: Planned, vehicle: Vehicle
) -> None:
    comparison = Comparison(
        first=(made(planned, "first flight 1", 0.04),),
        latency_s=0.0,
        applied=made(planned, "first plan, effects applied", 0.01),
        no_new_plan="thrust-gain: not a drag",
    )
    flown, _ = report.sections(comparison, no_prediction(), vehicle, {})["sections"]
    for text in ("not a drag.", "(first plan, effects applied)"):
        assert text in flown["text"][0]
    assert report.summary(comparison.to_json())[1:] == [
        "  no new plan: thrust-gain: not a drag",
        "  first plan, effects applied: 17.3 mm (0.25 of it)",
    ]


def test_comparison_with_neither_a_flight_nor_a_reason_is_refused(planned: Planned) -> None:
    with pytest.raises(ValueError, match="or the reason why"):
        Comparison(first=(made(planned, "a", 0.03),), latency_s=0.0, no_new_plan="x")


def test_comparison_with_a_prediction_that_diverged_has_null_in_json(planned: Planned) -> None:
    lost = dataclasses.replace(made(planned, "new plan", 0.05), predicted_rmse_m=np.inf)
    answer = Comparison(
        first=(made(planned, "a", 0.03),), latency_s=0.0, new_plan=lost, no_applied="x"
    ).to_json()
    assert answer["comparison"]["flights"][1]["predicted_rmse_m"] is None
