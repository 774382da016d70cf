"""The page of study attack, made from rows that nobody flew."""

from __future__ import annotations

from typing import Any

import pytest
from generators.attack import page

from tests.sitl.studies.attack.made_up import made_up_rows
from trimtab.host.report import attack
from trimtab.sitl.studies.attack.study import summary

PROVENANCE = {"command": "trimtab study attack --seed 12", "git": "0123456789ab"}


@pytest.fixture
def report() -> dict[str, Any]:
    told = {"seed": 12, "quick": False, "folder": "study"}
    return {**told, "scores": made_up_rows(changed=True, takeover="hold"), "provenance": PROVENANCE}


def test_page_holds_every_cell_of_every_table(report: dict[str, Any]) -> None:
    lines = page(report).splitlines()
    made = summary({key: report[key] for key in ("seed", "quick", "folder")}, report["scores"])
    for title, rows in made["tables"].items():
        start = lines.index(f"### {title}") + 4
        assert lines[start : start + len(rows)] == [f"| {' | '.join(row.values())} |" for row in rows]


def test_page_begins_with_the_figures_and_says_seed_commit_and_limits(report: dict[str, Any]) -> None:
    text = page(report)
    assert "Results of seed 12, commit 0123456789ab." in " ".join(text.split())
    assert "beyond what `OWN_OTHERS` allows and without a false sender | 1 |" in text
    assert "Jam the radio" in text
    assert "development figures" not in text
    assert "development figures" in page({**report, "quick": True})
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 120


@pytest.mark.parametrize("quick", [False, True])
def test_report_holds_title_and_tables(quick: bool) -> None:
    outcome = summary({"seed": 12, "quick": quick, "folder": "study"}, made_up_rows())
    html = attack.page(outcome, {}, PROVENANCE)
    assert ("quick check" in html) is quick
    assert "seed 12" in html
    assert all(title in html for title in outcome["tables"])
