"""How well models predict shipped flights: the measure is the tracer's, and a divergence counts."""

from __future__ import annotations

import datetime
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.host.trace.test_prediction import flight as swinging
from trimtab.host.base.errors import UsageError
from trimtab.host.base.output import json_text
from trimtab.host.compare.prediction import FlightPrediction, Prediction, Score, predict
from trimtab.host.compare.prediction_words import lines, notes
from trimtab.host.effects import load_effects
from trimtab.host.learn.evaluate import model_errors
from trimtab.host.log import Flight, Mocap, read_flight, write_imported
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.trace.run import run
from trimtab.host.vehicle import load_vehicle

DATA = Path(__file__).parents[2] / "data"
VEHICLE = load_vehicle("research")
TRUTH = json.loads((DATA / "truth.json").read_text())["effects"]
WRONG = {"linear-drag": {"dx": -0.6, "dy": -0.5, "dz": -0.2}}
DIVERGING = {"linear-drag": {"dx": -40.0, "dy": -35.0, "dz": -20.0}}


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    return [read_flight(DATA / f"{name}.mcap") for name in ("a1", "a2", "b1", "b2", "c1")]


def model(effects: dict[str, dict[str, float]], **more) -> Model:
    return Model(vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name, effects=effects, **more)


def test_errors_on_held_out_flights_are_those_of_the_trace(flights: list[Flight]) -> None:
    held_out = [flights[0], flights[4]]
    traced = run([flights[2], flights[3]], held_out, load_effects())
    assert traced.after_score is not None
    assert traced.before_score is not None
    found = predict(traced.model, held_out)
    assert found.drive == traced.drive == "reference"
    assert found.horizon_s is None
    for score, expected in (
        (found.together, traced.after_score),
        (found.nominal_together, traced.before_score),
    ):
        assert score.position_rmse_m == expected["position_rmse_m"]
        assert score.velocity_rmse_m_s == expected["velocity_rmse_m_s"]
    assert found.together.position_rmse_m < 0.5 * found.nominal_together.position_rmse_m


def test_errors_of_imports_are_those_of_the_trace(tmp_path: Path) -> None:
    used, held_out = swinging(tmp_path / "a.mcap"), swinging(tmp_path / "b.mcap", every_us=13_000)
    traced = run([used], [held_out], load_effects())
    assert traced.after_score is not None
    found = predict(traced.model, [held_out])
    assert found.drive == "inputs"
    assert found.horizon_s == traced.horizon_s == 0.6
    assert found.together.position_rmse_m == pytest.approx(traced.after_score["position_rmse_m"], rel=1e-9)


def test_true_effects_predict_better_than_the_nominal_model_on_every_flight(flights: list[Flight]) -> None:
    found = predict(model(TRUTH), flights)
    difference = found.difference
    assert difference is not None
    assert difference.high is not None
    assert difference.mean is not None
    assert difference.count == found.better == 5
    assert difference.high < -0.02
    pairs = [f.model.position_rmse_m - f.nominal.position_rmse_m for f in found.flights]
    assert difference.mean == pytest.approx(np.mean(pairs))
    assert found.median_m == np.median([f.model.position_rmse_m for f in found.flights])
    assert all(f.model.position_max_m >= f.model.position_rmse_m for f in found.flights)
    assert found.diverged == ()


def test_wrong_model_is_worse_than_the_nominal_one_with_an_interval_above_zero(flights: list[Flight]) -> None:
    found = predict(model(WRONG), flights)
    assert found.difference is not None
    assert found.difference.low is not None
    assert found.difference.low > 0.02
    assert found.better == 0
    assert "better than the nominal model on 0 of 5" in lines(found, "m")


def test_diverging_model_counts_on_every_flight_by_name(flights: list[Flight]) -> None:
    found = predict(model(DIVERGING), flights[:2])
    assert found.diverged == tuple(str(flight.path) for flight in flights[:2])
    assert found.difference is not None
    assert (found.difference.count, found.difference.mean, found.difference.median) == (2, None, None)
    assert found.median_m is None
    assert found.nominal_median_m is not None
    told = json.loads(json_text(found.to_dict()))
    assert told["model"]["position_rmse_m"] is None
    assert [row["diverged"] for row in told["flights"]] == [True, True]
    text = "\n".join(lines(found, "m"))
    assert text.count("diverges, nominal model") == 4  # each flight, the RMSE and the median
    assert "diverges on 2 of 2" in text


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_diverging_predictions_from_inputs_count_and_leave_the_others(tmp_path: Path) -> None:
    moving = swinging(tmp_path / "moving.mcap")
    t_us = np.arange(0, 16_000_000, 10_000)
    still_p, level = np.tile([0.0, 0.0, -1.5], (len(t_us), 1)), np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1))
    write_imported(
        tmp_path / "still.mcap",
        vehicle=VEHICLE,
        mocap=Mocap(t_us=t_us, t_arrival_us=t_us, p=still_p, q=level),
    )
    still = read_flight(tmp_path / "still.mcap")
    # A push that grows with the square of the speed: at rest it is nothing.
    found = predict(model({"quadratic-drag": {"c": -50.0}}), [moving, still])
    assert found.diverged == (str(moving.path),)
    assert found.flights[1].model.position_rmse_m < 0.01
    alone = predict(model({}), [moving])
    assert not alone.diverged


def flight_of(
    model_m: float, nominal_m: float = 0.1, *, days: float | None = None, log: str = "x.mcap"
) -> FlightPrediction:
    scores = [
        Score(position_rmse_m=error, velocity_rmse_m_s=error, position_max_m=error)
        for error in (model_m, nominal_m)
    ]
    date = None
    if days is not None:
        date = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC) + datetime.timedelta(days=days)
    return FlightPrediction(
        log=log, id="0" * 12, reference=None, date=date, used=False, model=scores[0], nominal=scores[1]
    )


def prediction(*flights: FlightPrediction) -> Prediction:
    together = flights[0].model
    return Prediction(
        model_id="1" * 12,
        vehicle="research",
        drive="reference",
        horizon_s=None,
        flights=flights,
        together=together,
        nominal_together=together,
    )


def test_one_divergence_among_good_flights_leaves_the_median_and_is_named() -> None:
    found = prediction(flight_of(0.01), flight_of(math.inf, log="far.mcap"), flight_of(0.02))
    assert found.median_m == 0.02
    assert found.difference is not None
    assert found.difference.median == pytest.approx(-0.08)
    assert found.difference.mean is None
    assert found.diverged == ("far.mcap",)
    assert found.better == 2
    assert any("median -80.0 mm; no mean and no interval" in line for line in lines(found, "m"))


def test_flight_on_which_both_diverge_is_no_difference() -> None:
    assert flight_of(math.inf, math.inf).difference_m == 0.0
    assert flight_of(0.01, math.inf).difference_m == -math.inf
    assert prediction(flight_of(0.01, math.inf)).to_dict()["flights"][0]["difference_m"] is None


def test_drift_is_the_slope_a_month_over_dates() -> None:
    month = 365.25 / 12
    found = prediction(*(flight_of(0.01 + 0.002 * k, days=month * k) for k in range(4))).drift
    assert found is not None
    assert found.slope_m_month == pytest.approx(0.002)
    assert (found.low_m_month, found.high_m_month) == pytest.approx((0.002, 0.002))
    assert (found.flights, found.days) == (4, pytest.approx(3 * month))
    text = lines(prediction(*(flight_of(0.01 + 0.002 * k, days=month * k) for k in range(4))), "m")
    assert text[-1].startswith(
        "drift: +2.0 mm a month, 95 % interval +2.0 to +2.0 mm (4 flights over 91 days)"
    )


@pytest.mark.parametrize(
    "flights",
    [
        [flight_of(0.01, days=0.0), flight_of(0.02, days=40.0), flight_of(0.02)],
        [flight_of(0.01, days=0.1 * k) for k in range(8)],
        [flight_of(0.01, days=0.0), flight_of(0.01, days=20.0), flight_of(math.inf, days=40.0)],
    ],
)
def test_no_drift_with_too_few_dates_within_a_day_or_with_a_divergence(
    flights: list[FlightPrediction],
) -> None:
    assert prediction(*flights).drift is None


def test_flights_are_in_the_order_of_their_dates(tmp_path: Path) -> None:
    late, early, undated = (
        dated(swinging(tmp_path / f"{name}.mcap", every_us=every), epoch_us)
        for name, every, epoch_us in (
            ("late", 10_000, "1750000000000000"),
            ("early", 11_000, "1700000000000000"),
            ("undated", 12_000, "5000000"),  # since the start of a clock
        )
    )
    found = predict(None, [undated, late, early])
    assert [Path(row.log).stem for row in found.flights] == ["early", "late", "undated"]
    assert found.to_dict()["flights"][0]["date"] == "2023-11-14T22:13:20Z"
    assert found.flights[2].date is None
    assert "  2023-11-14  " in lines(found, "nominal")[1]


def dated(flight: Flight, epoch_us: str) -> Flight:
    return replace(flight, metadata={**flight.metadata, "epoch_us": epoch_us})


def test_nominal_model_has_no_difference(flights: list[Flight]) -> None:
    found = predict(None, flights[:1])
    told = found.to_dict()
    assert (told["model_id"], told["difference"], told["better"]) == (None, None, None)
    assert told["model"] == told["nominal"]
    assert not any("nominal model" in line for line in lines(found, "nominal"))


def test_flight_behind_the_model_is_marked(flights: list[Flight]) -> None:
    found = predict(model(TRUTH, data=(flights[1].id,)), flights[:2])
    assert [row.used for row in found.flights] == [False, True]
    assert "made from 1 of these flights" in notes(found)[0]
    assert notes(predict(model(TRUTH), flights[:2])) == []


def test_network_acts_and_agrees_with_the_learners_measure(flights: list[Flight]) -> None:
    layout = Layout(hidden=(4,))
    silent = model(TRUTH, network=Network(layout=layout, xi=np.zeros(layout.size)))
    without = predict(model(TRUTH), flights[:2])
    assert predict(silent, flights[:2]).together.position_rmse_m == pytest.approx(
        without.together.position_rmse_m, rel=1e-6
    )
    xi = np.zeros(layout.size)
    xi[-11::5] = (0.5, -0.4, 0.1)  # biases of the outputs: a constant acceleration
    pushed = model(TRUTH, network=Network(layout=layout, xi=xi))
    found = predict(pushed, flights[:2]).together.position_rmse_m
    learners = model_errors(flights[:2], pushed, load_effects()).position_rmse_m
    assert found > 2.0 * without.together.position_rmse_m
    assert found == pytest.approx(learners, rel=0.05)


def test_network_on_a_flight_without_the_law_is_refused(tmp_path: Path) -> None:
    layout = Layout(hidden=(4,))
    network = Network(layout=layout, xi=np.zeros(layout.size))
    with pytest.raises(UsageError, match=r"x\.mcap: has no reference flown by the law on board"):
        predict(model({}, network=network), [swinging(tmp_path / "x.mcap")])


def test_unusable_inputs_are_refused_in_one_line(flights: list[Flight]) -> None:
    with pytest.raises(UsageError, match="no flight to predict"):
        predict(None, [])
    with pytest.raises(UsageError, match=r"names ghost, which is no known effect.*--workspace") as refusal:
        predict(model({"ghost": {"k": 1.0}}), flights[:1])
    assert "\n" not in str(refusal.value)
    other = replace(model(TRUTH), vehicle_id="0" * 12, vehicle_name="other")
    with pytest.raises(UsageError, match=r"of vehicle other \(000000000000\).*give flights"):
        predict(other, flights[:1])
    with pytest.raises(LogsRefused) as again:
        predict(None, [flights[0], flights[0]])
    assert again.value.details == {"code": Code.LOG_GIVEN_TWICE}
