"""The paper's claims: confirmed where flights hold them, not confirmed where they do not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.host.apps.paper.controllers.made_up import balanced, error_m
from trimtab.host.apps.paper.controllers.claims import WORDS, cells_of, claims
from trimtab.host.apps.paper.controllers.design import COURSES
from trimtab.host.apps.paper.controllers.statistics import FAILED_M
from trimtab.host.apps.paper.controllers.table import MIN_RESIDUAL, MIN_RESIDUAL_STAR, MIN_SNAP

Rows = dict[tuple[str, str, str], dict[str, Any]]
Change = Callable[[dict[str, Any]], dict[str, Any]]


def keep(row: dict[str, Any]) -> dict[str, Any]:
    """Replace no entry."""
    return {}


def claim_rows(change: Change = keep) -> Rows:
    """Claims of two worlds in which every row got some entries replaced."""
    results = [balanced(world, course) for world in range(2) for course in range(COURSES)]
    for result in results:
        result["rows"] = [row | change(row) for row in result["rows"]]
    return {(r["claim"], r["regressor"], r["family"]): r for r in claims(cells_of(results))}


def test_claims_that_hold_in_every_cell_are_confirmed():
    rows = claim_rows()
    assert {claim for claim, _, _ in rows} == set(WORDS)
    assert all(row["confirmed"] for row in rows.values())
    assert {row["courses"] for row in rows.values()} == {6}
    assert len(rows) == 20


def test_claim_effects_are_the_ratios_of_the_made_up_errors():
    rows = claim_rows()
    assert rows["neural-best-mpc", "paper", "mpc"]["effect"] == pytest.approx(0.8)
    assert rows["neural-better-than-neural-c", "ours", "mpc"]["effect"] == pytest.approx(0.8)
    assert rows["feedforward-helps", "paper", "dfbc"]["effect"] == pytest.approx(0.8)
    assert rows["baseline-beats-feedforward", "ours", "dfbc"]["effect"] == pytest.approx(0.7 / 0.8)
    # The weakest comparison is that of the controller with the least error: 0.3 * 0.7^0.5 / 0.7.
    assert rows["star-lifts-all", "paper", "dfbc"]["effect"] == pytest.approx(0.3 / 0.7**0.5)
    assert rows["star-makes-alike", "ours", "mpc"]["effect"] == pytest.approx(0.5)


def test_claim_of_several_comparisons_is_not_confirmed_if_one_of_them_fails():
    worse = {"mpc-l1": 0.01}
    rows = claim_rows(lambda row: {"error_mean_m": worse.get(row["controller"], row["error_mean_m"])})
    assert not rows["neural-best-mpc", "paper", "mpc"]["confirmed"]
    assert rows["neural-best-mpc", "paper", "mpc"]["effect"] > 1.0
    assert rows["neural-better-than-neural-c", "paper", "mpc"]["confirmed"]


def test_claim_without_a_difference_is_not_confirmed():
    def as_starred(row: dict[str, Any]) -> dict[str, Any]:
        starred = row["trajectory"] in (MIN_RESIDUAL, MIN_RESIDUAL_STAR)
        return {"error_mean_m": error_m(row["controller"], MIN_RESIDUAL_STAR)} if starred else {}

    rows = claim_rows(as_starred)
    assert not rows["star-better-than-plain", "ours", "dfbc"]["confirmed"]
    assert rows["star-better-than-plain", "ours", "dfbc"]["effect"] == pytest.approx(1.0)
    assert rows["star-lifts-all", "ours", "dfbc"]["confirmed"]


def test_claim_against_the_paper_s_direction_is_not_confirmed():
    swap = {MIN_RESIDUAL: MIN_RESIDUAL_STAR, MIN_RESIDUAL_STAR: MIN_RESIDUAL}
    rows = claim_rows(
        lambda row: {"error_mean_m": error_m(row["controller"], swap.get(row["trajectory"], MIN_SNAP))}
    )
    row = rows["star-better-than-plain", "paper", "mpc"]
    assert not row["confirmed"]
    assert row["ci95"][0] > 1.0


def test_failed_flight_counts_against_its_own_side():
    def fails(row: dict[str, Any]) -> dict[str, Any]:
        lost = (row["controller"], row["trajectory"]) == ("dfbc", MIN_RESIDUAL) and not row["anchor"]
        return {"failed": "flight: tilt", "error_mean_m": None} if lost else {}

    row = claim_rows(fails)["baseline-beats-feedforward", "paper", "dfbc"]
    assert not row["confirmed"]
    assert row["effect"] == pytest.approx(FAILED_M / 0.08)
    assert row["courses"] == 6


def test_failed_flight_makes_controllers_differ():
    def fails(row: dict[str, Any]) -> dict[str, Any]:
        lost = row["trajectory"] == MIN_RESIDUAL_STAR and not row["anchor"]
        return {"failed": "plan: no path", "error_mean_m": None} if lost else {}

    row = claim_rows(fails)["star-makes-alike", "ours", "mpc"]
    assert not row["confirmed"]
    assert row["effect"] == pytest.approx(FAILED_M)


def test_claim_p_values_are_corrected_for_their_number():
    rows = claim_rows()
    # Six courses of one sign give 2/2^6 in the exact test; twenty rows are tested.
    assert {row["p"] for row in rows.values()} == {2.0 / 64.0}
    assert {row["p_holm"] for row in rows.values()} == {20.0 * 2.0 / 64.0}


def test_claim_of_too_few_courses_is_not_confirmed_and_shows_its_weakest_comparison():
    results = [balanced(0, course) for course in range(COURSES)]
    rows = {(r["claim"], r["regressor"], r["family"]): r for r in claims(cells_of(results))}
    row = rows["neural-best-mpc", "paper", "mpc"]
    assert (row["confirmed"], row["ci95"], row["courses"]) == (False, None, 3)
    assert row["effect"] == pytest.approx(0.8)


def test_claims_without_cells_are_not_confirmed():
    rows = claims([])
    assert len(rows) == 20
    assert not any(row["confirmed"] for row in rows)
    assert {row["effect"] for row in rows} == {None}
