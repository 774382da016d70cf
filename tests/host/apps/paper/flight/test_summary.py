"""Figures, tables and the list of what is worse than the paper, from stored results."""

from __future__ import annotations

import numpy as np
import pytest

from tests.host.apps.paper.flight.made_up import made_up_world
from tests.narrowing import not_none
from trimtab.host.apps.paper.flight.summary import cluster_interval, summary


def pieces(*worlds: dict) -> dict:
    return {f"world-{k:02d}": {"result": world} for k, world in enumerate(worlds)}


def test_summary_ratio_is_the_median_over_worlds_of_ours_over_nominal():
    worlds = (made_up_world(k, ratio=ratio) for k, ratio in enumerate((0.2, 0.4, 0.9)))
    answer = summary({}, pieces(*worlds))["answer"]
    assert answer["prediction_ratio"] == pytest.approx({"train": 0.2, "test": 0.2, "ood": 0.2})
    paper = answer["prediction"]["test"]["flights"]["ratios"]["paper"]["position_rmse_m"]
    assert (paper["median"], paper["least"], paper["greatest"]) == pytest.approx((0.4, 0.2, 0.9))
    mean = answer["prediction"]["ood"]["segments"]["errors"]["ours"]["velocity_rmse_m_s"]["mean"]
    assert mean == pytest.approx(0.1 * np.mean([0.2, 0.4, 0.9]))


def test_summary_roll_out_that_diverged_leaves_no_mean():
    world = made_up_world()
    world["errors"]["ood"]["paper"]["flights"]["position_rmse_m"] = None
    outcome = summary({}, pieces(world, made_up_world(1)))
    row = outcome["answer"]["prediction"]["ood"]["flights"]["errors"]["paper"]["position_rmse_m"]
    assert row["mean"] is None
    assert row["values"] == [None, pytest.approx(0.05)]
    table = outcome["tables"]["Table II: prediction error of whole flights, mean over worlds"]
    assert table[4]["paper's settings"] == "diverged"


def test_summary_names_what_is_worse_than_the_paper_and_nothing_else():
    world = made_up_world(ratio=0.7, error_m=0.112)
    worse = {row["what"]: row for row in summary({}, pieces(world))["answer"]["worse"]}
    # 0.7 of 0.1 m is more than the paper's 0.064 and 0.067 m; ours, 0.35, is less.
    assert worse["prediction, training, position, m, paper's settings"]["ours"] == pytest.approx(0.07)
    assert worse["prediction, training, position, m, paper's settings over nominal"][
        "paper"
    ] == pytest.approx(0.064 / 0.101)
    assert not any("ours" in what for what in worse)
    # 0.112 m of min-snap: less than 0.113 m by the baseline, more than 0.111 and 0.104 m.
    assert "pretzel, mean position error, m, baseline, min-snap" not in worse
    assert worse["pretzel, mean position error, m, DO, min-snap"]["paper"] == 0.111
    # 0.8: less than the paper's 0.87 by the baseline and 0.808 by Neural DO, more than 0.784 by DO.
    ratios = [what for what in worse if "position error" in what and what.endswith("over min-snap")]
    assert ratios == ["pretzel, mean position error, m, DO, min-residual over min-snap"]
    # Both plans have 9 and 20 m/s^3: less than the paper's; acceleration over acceleration is 1.
    assert "pretzel, greatest jerk, m/s^3, min-snap" not in worse
    assert worse["pretzel, greatest acceleration, m/s^2, min-residual over min-snap"]["ours"] == 1.0
    assert "pretzel, greatest jerk, m/s^3, min-residual over min-snap" not in worse


def test_summary_first_table_is_what_is_worse():
    tables = summary({}, pieces(made_up_world()))["tables"]
    assert next(iter(tables)) == "Worse than in the paper"
    rows = tables["Table III: the pretzel"]
    assert [row["flights"] for row in rows] == ["", "", "", "", "2 + 2", "2 + 2", "2 + 2"]
    assert rows[4]["ratio"] == "0.80 (0.80-0.80)"
    assert (rows[4]["paper, min-snap"], rows[4]["min-residual"]) == ("0.113", "0.0800 (0.0800-0.0800)")


def test_summary_splits_the_pretzels_errors_into_constant_and_varying_parts():
    outcome = summary({}, pieces(made_up_world(error_m=0.1)))
    found = outcome["answer"]["pretzel"]["controllers"]["baseline"]
    assert found["min-snap"]["constant_m"] == pytest.approx(0.05)  # of a mean vector (0, 3, 4) cm
    assert found["min-residual"]["varying_mean_m"] == pytest.approx(0.03)
    # 0.03 m over 0.05 m without the constant part, 0.8 with it.
    assert found["varying_ratio"]["mean"] == pytest.approx(0.6)
    rows = outcome["tables"]["The pretzel: path lengths, and errors without their constant part"]
    assert [row["ratio"] for row in rows[:4]] == ["1.00", "0.90", "1.00", "0.60 (0.60-0.60)"]


def test_summary_remark_one_has_no_whole_flights_by_a_controller_on_the_host():
    title = "Remark 1: learned under the baseline, predicting flights of other controllers"
    outcome = summary({}, pieces(made_up_world(ratio=0.5)))
    assert list(outcome["answer"]["controllers"]["mpc"]) == ["ahead", "ahead-same-torque"]
    rows = outcome["tables"][title]
    by_horizon = {
        row["predicted"]: [r["flown by"] for r in rows if r["predicted"] == row["predicted"]] for row in rows
    }
    assert [len(laws) for laws in by_horizon.values()] == [4, 7, 7]
    assert {row["ours, ratio"] for row in rows} == {"0.25"}


def test_summary_flight_that_failed_is_named_and_left_out():
    world = made_up_world()
    first = world["pretzel"]["flights"][0]
    world["pretzel"]["flights"][0] = {key: first[key] for key in ("kind", "controller", "flight")}
    world["pretzel"]["flights"][0]["failed"] = "tilted"
    world["failed"] = [{"flight": "ood-0, baseline", "why": "late"}]
    answer = summary({}, pieces(world))["answer"]
    assert [row["why"] for row in answer["failed"]] == ["late", "tilted"]
    baseline = answer["pretzel"]["controllers"]["baseline"]
    assert (baseline["min-snap"]["flights"], baseline["min-residual"]["flights"]) == (1, 2)
    assert baseline["ratio"]["mean"] == pytest.approx(0.8)


def test_summary_pretzel_without_a_plan_is_not_flown_and_counts_as_worse():
    world = made_up_world()
    world["pretzel"] = {"plans": {}, "flights": [], "failed": "no path"}
    outcome = summary({}, pieces(world))
    assert outcome["answer"]["failed"][0]["why"] == "no path"
    assert outcome["tables"]["Table III: the pretzel"][4]["min-snap"] == "not flown"
    assert any(row["ours"] is None for row in outcome["answer"]["worse"])


def test_cluster_interval_of_equal_values_is_that_value():
    assert cluster_interval([[0.3, 0.3], [0.3]]) == pytest.approx([0.3, 0.3])
    assert cluster_interval([[], []]) is None


def test_cluster_interval_draws_worlds_not_flights():
    # Two worlds that differ, many flights in each: the interval spans both worlds.
    low, high = not_none(cluster_interval([[1.0] * 50, [2.0] * 50]))
    assert (low, high) == pytest.approx((1.0, 2.0))
    # One world: only its flights vary.
    low, high = not_none(cluster_interval([[1.0, 2.0] * 50]))
    assert 1.35 < low < 1.45 < 1.55 < high < 1.65
