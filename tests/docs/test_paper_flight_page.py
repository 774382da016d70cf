"""The page of study paper-flight, made from a report of flights that nobody flew."""

from __future__ import annotations

from typing import Any

import pytest
from generators.paper_flight import page

from tests.host.apps.paper.flight.made_up import made_up_world
from trimtab.host.apps.paper.flight.summary import summary

PROVENANCE = {"command": "trimtab study paper-flight --seed 12", "git": "0123456789ab"}


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    told = {"study": "paper-flight", "seed": 12, "quick": False}
    pieces = {f"world-{k:02d}": {"result": made_up_world(k, ratio=0.7)} for k in range(2)}
    return {**summary(told, pieces)["answer"], "provenance": PROVENANCE}


def test_page_says_first_what_is_worse_than_the_paper(report: dict[str, Any]) -> None:
    text = page(report)
    assert "Results of seed 12, 2 worlds, commit 0123456789ab.\n" in text
    titles = [line for line in text.splitlines() if line.startswith("##")]
    assert titles[:3] == ["## Worse than in the paper", "## Method", "## Results"]
    assert "- prediction, training, position, m, paper's settings: 0.070, in the paper 0.064\n" in text


def test_page_holds_every_cell_of_every_table(report: dict[str, Any]) -> None:
    lines = page(report).splitlines()
    tables = {title: rows for title, rows in report["tables"].items() if not title.startswith("Worse")}
    assert len(tables) == 7
    for title, rows in tables.items():
        start = lines.index(f"### {title}") + 4
        assert lines[start : start + len(rows)] == [f"| {' | '.join(row.values())} |" for row in rows]


def test_page_has_no_long_line_of_prose_and_says_where_nothing_is_worse(report: dict[str, Any]) -> None:
    none = [{"figure": "none", "paper": "", "ours": ""}]
    text = page({**report, "quick": True, "tables": {**report["tables"], "Worse than in the paper": none}})
    assert "- none\n" in text
    assert "quick check" in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 120
