"""The page of study paper-controllers, made from a report of flights that nobody flew."""

from __future__ import annotations

from typing import Any

import pytest
from generators.paper_controllers import page

from tests.host.apps.paper.controllers.made_up import pieces
from trimtab.host.apps.paper.controllers.design import COURSES
from trimtab.host.apps.paper.controllers.summary import summary

PROVENANCE = {"command": "trimtab study paper-controllers --seed 12", "git": "0123456789ab"}


@pytest.fixture(scope="module")
def outcome() -> dict[str, Any]:
    told = {"study": "paper-controllers", "seed": 12, "worlds": 2, "quick": False}
    return summary(told, pieces(2, COURSES))


def test_page_holds_every_cell_of_every_table(outcome: dict[str, Any]) -> None:
    lines = page({**outcome["answer"], "provenance": PROVENANCE}).splitlines()
    assert len(outcome["tables"]) == 14
    for title, rows in outcome["tables"].items():
        start = lines.index(f"### {title}") + 4
        assert lines[start : start + len(rows)] == [f"| {' | '.join(row.values())} |" for row in rows]


def test_page_says_seed_commit_and_size_in_short_lines(outcome: dict[str, Any]) -> None:
    text = page({**outcome["answer"], "provenance": PROVENANCE})
    assert "    trimtab study paper-controllers --seed 12\n" in text
    prose = " ".join(text.split())
    assert "Results of seed 12, 2 worlds, commit 0123456789ab, 570 flights of the balanced design." in prose
    assert "quick check" not in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 120


def test_page_begins_with_the_claims_that_are_not_confirmed(outcome: dict[str, Any]) -> None:
    answer = {**outcome["answer"], "provenance": PROVENANCE}
    heading = "## Claims of the paper that these flights do not confirm"
    assert heading not in page(answer)
    first, *others = answer["claims"]
    lost = {**first, "confirmed": False, "effect": 1.25, "ci95": [1.1, 1.4]}
    text = page({**answer, "claims": [lost, *others]})
    assert text.index(heading) < text.index("## Method")
    prose = " ".join(text.split())
    assert "with neural feed-forward: DFBC with the paper's regressor, 1.25 (1.10-1.40)" in prose


def test_page_answers_the_questions_of_the_study(outcome: dict[str, Any]) -> None:
    prose = " ".join(page({**outcome["answer"], "provenance": PROVENANCE}).split())
    assert "min-error with the paper's regressor leaves 0.25 (0.25-0.25) of the error on min-snap." in prose
    assert "Traced on min-residual* with our regressor leaves" in prose
    lines = page({**outcome["answer"], "provenance": PROVENANCE}).splitlines()
    assert sum(line.startswith("- Better ") for line in lines) == 2
    assert "body frame, 12 aggressive flights, 0.65; body frame, 12 gentle flights, 0.65." in prose


def test_page_of_a_quick_run_says_so(outcome: dict[str, Any]) -> None:
    assert "quick check" in page({**outcome["answer"], "quick": True, "provenance": PROVENANCE})
