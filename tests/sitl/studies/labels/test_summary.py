"""Figures of the study of labels, from worlds that nobody flew."""

from __future__ import annotations

from typing import Any

import pytest

from tests.sitl.studies.labels.made_up import made_up_world
from trimtab.host.apps.paper.controllers.statistics import FAILED_M
from trimtab.sitl.studies.labels.summary import SMOOTHED, TRUTH, failures, ratios, rows_of, summary

ANSWER = {"study": "labels", "seed": 1, "worlds": 3, "quick": False, "folder": "f"}


def ratio(rows: list[dict[str, Any]], name: str) -> dict[str, Any]:
    return next(row for row in rows if (row["regressor"], row["ratio"]) == ("paper", name))


def test_ratios_compare_flights_of_the_same_plan() -> None:
    rows = ratios([made_up_world(world) for world in range(3)])
    assert len(rows) == 6
    found = ratio(rows, "truth/smoothed")
    assert found["median"] == pytest.approx(0.8)
    assert found["ci95"] == pytest.approx([0.8, 0.8])
    assert (found["pairs"], found["courses"], found["better"], found["failed"]) == (12, 6, 6, 0)
    assert found["by_world"] == pytest.approx([0.8] * 3)
    assert found["p"] < found["p_holm"] <= 1.0
    assert ratio(rows, "truth/neural")["median"] == pytest.approx(0.4)
    assert ratio(rows, "smoothed/neural")["median"] == pytest.approx(0.5)


def test_failed_flight_counts_as_a_great_error() -> None:
    results = [made_up_world(0, failed=(TRUTH, 1)), made_up_world(1, failed=(SMOOTHED, 0))]
    found = ratio(ratios(results), "truth/smoothed")
    assert (found["pairs"], found["failed"], found["ci95"]) == (8, 4, None)
    assert found["by_world"][0] == pytest.approx((0.8 * FAILED_M / 0.02) ** 0.5)
    assert len(failures(results)) == 8
    errors = [row for row in rows_of(results) if row["controller"] == TRUTH]
    assert {(row["failed"], row["courses"]) for row in errors} == {(1, 4)}


def test_one_quick_world_has_ratios_without_intervals() -> None:
    found = summary({**ANSWER, "quick": True}, [made_up_world(0, courses=1)])
    assert all(row["ci95"] is None for row in found["answer"]["ratios"])
    assert found["answer"]["flights"] == 16
    assert "Neural-C, true labels over Neural-C, smoothed labels" in "\n".join(found["lines"])
    assert next(iter(found["tables"])) == "Ratios of flown errors on the same plans"
