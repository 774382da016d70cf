"""Figures of the study from stored pieces, against numbers computed by hand."""

from __future__ import annotations

import pytest

from tests.host.apps.paper.controllers.made_up import BASE_M, error_m, pieces
from trimtab.host.apps.paper.controllers.design import COURSES
from trimtab.host.apps.paper.controllers.statistics import FAILED_M
from trimtab.host.apps.paper.controllers.summary import summary
from trimtab.host.apps.paper.controllers.table import (
    BASELINE_TRAJECTORIES,
    CONTROLLERS,
    MIN_ERROR,
    MIN_RESIDUAL,
    MIN_SNAP,
    REGRESSORS,
    TRAJECTORIES,
)


def test_rows_are_medians_with_intervals_and_ratios_to_the_baseline_of_the_cell():
    rows = summary({}, pieces(2, COURSES))["answer"]["rows"]
    assert len(rows) == len(TRAJECTORIES) * sum(len(c.regressors) for c in CONTROLLERS)
    row = next(
        r
        for r in rows
        if (r["controller"], r["regressor"], r["trajectory"]) == ("mpc-neural", "ours", MIN_RESIDUAL)
    )
    assert row["cells"] == 6
    assert row["error_mean_m"] == pytest.approx(0.028)
    assert row["ci95_m"] == pytest.approx([0.028, 0.028])
    assert row["over_baseline"]["median"] == pytest.approx(0.28)
    assert row["over_baseline"]["courses"] == 6


def test_selection_uses_tuning_courses_only():
    found = pieces(1, COURSES)
    for row in found["full-radio-0"]["result"]["rows"]:
        if (row["controller"], row["trajectory"], row["regressor"]) == ("dfbc-do", MIN_RESIDUAL, "paper"):
            row["error_mean_m"] = 0.001
    for row in found["select-0"]["result"]["rows"]:
        row["error_mean_m"] = (
            0.02 if (row["trajectory"], row["regressor"]) == (MIN_RESIDUAL, "paper") else 0.05
        )
    answer = summary({}, found)["answer"]
    best = answer["best"]
    assert (best["controller"], best["regressor"], best["trajectory"]) == ("dfbc-do", "paper", MIN_RESIDUAL)
    assert best["median"] == pytest.approx(error_m("dfbc-do", MIN_RESIDUAL) / BASE_M)
    ratio = answer["error_ratio_baseline"]
    assert (ratio["trajectory"], ratio["regressor"]) == (MIN_RESIDUAL, "paper")
    assert ratio["median"] == pytest.approx(0.7)
    assert ratio["courses"] == COURSES  # anchors count: every course has a cell of the regressor


def test_baseline_has_error_and_jerk_of_each_of_its_trajectories_on_every_course():
    rows = summary({}, pieces(1, COURSES))["answer"]["baseline"]
    by_key = {(row["regressor"], row["trajectory"]): row for row in rows}
    assert len(by_key) == len(REGRESSORS) * len(BASELINE_TRAJECTORIES)
    row = by_key["ours", MIN_ERROR]
    assert row["over_min_snap"]["median"] == pytest.approx(0.25)
    assert row["over_min_snap"]["courses"] == COURSES
    assert row["error_mean_m"] == pytest.approx(0.25 * BASE_M)
    assert row["jerk_rms_m_s3"] == pytest.approx(40.0)
    assert by_key["paper", MIN_SNAP]["over_min_snap"]["median"] == 1.0


def test_wired_courses_do_not_select():
    found = pieces(1, COURSES)
    for row in found["full-wired-0"]["result"]["rows"]:
        row["error_mean_m"] = 1e-6 if row["controller"] == "dfbc" else 1.0
    assert summary({}, found)["answer"]["best"]["controller"] == "mpc-traced"


def test_failures_are_listed_and_count_in_the_medians():
    found = pieces(1, COURSES)
    for result in (found[f"balanced-00-{c}"]["result"] for c in range(COURSES)):
        for row in result["rows"]:
            if (row["controller"], row["trajectory"], row["regressor"]) == ("mpc", "min-control", "paper"):
                row |= {"failed": "plan: no path", "error_mean_m": None}
    answer = summary({}, found)["answer"]
    row = next(
        r
        for r in answer["rows"]
        if (r["controller"], r["regressor"], r["trajectory"]) == ("mpc", "paper", "min-control")
    )
    assert (row["cells"], row["failed"], row["error_mean_m"]) == (3, 3, FAILED_M)
    listed = [each for each in answer["failed"] if each["why"] == "plan: no path"]
    assert len(listed) == 3
    assert listed[0]["what"].startswith("mpc, paper, min-control, ")


def test_steps_are_medians_over_flights_and_the_greatest_counts():
    answer = summary({}, pieces(1, COURSES))["answer"]
    by_name = {(row["controller"], row["regressor"]): row for row in answer["steps"]}
    assert by_name["mpc-neural", "paper"]["p99_ms"] == pytest.approx(3.2)
    assert by_name["mpc-neural", "paper"]["flights"] == 15
    assert answer["mpc_step_ms_p99"] == pytest.approx(7.2)
    inside = answer["closed_form_in_mpc"]
    assert inside["error"]["median"] == pytest.approx(0.75)
    assert inside["step"]["median"] == pytest.approx(0.75)


def test_needs_say_which_settings_reach_the_target():
    rows = summary({}, pieces(1, 1))["answer"]["needs"]
    reached = {
        (r["frame"], r["excitation"], r["training_flights"]): (
            r["median"],
            r["reached"],
            r["failed"],
            r["within_region"],
        )
        for r in rows
    }
    assert reached["body", "gentle", 12] == (pytest.approx(0.65), True, 0, 1)
    assert reached["world", "gentle", 12] == (pytest.approx(0.9), False, 0, 0)
    assert reached["world", "aggressive", 4] == (pytest.approx(FAILED_M), False, 1, 0)


def test_front_has_error_over_min_snap_and_jerk_of_each_weight():
    rows = {(r["plan"], r["factor"]): r for r in summary({}, pieces(2, 1))["answer"]["front"]}
    assert rows["min-residual", 1.0]["over_min_snap"]["median"] == pytest.approx(0.7)
    assert rows["min-residual", 1.0]["jerk_rms_m_s3"] == pytest.approx(16.0)
    assert rows["min-residual", 1.0]["over_min_snap"]["courses"] == 2
    assert rows["min-residual", 0.1]["failed"] == 2
    assert rows["min-residual", 0.1]["jerk_rms_m_s3"] is None


def test_tables_have_every_set_and_both_links():
    titles = list(summary({}, pieces(1, COURSES))["tables"])
    assert titles[0].startswith("The paper's claims")
    assert sum("median error" in title for title in titles) == 4
    assert sum("like the paper's" in title for title in titles) == 2
    assert titles[-1] == "Failed plans and flights"
