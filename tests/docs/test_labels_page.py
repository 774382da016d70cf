"""The page of study labels, made from a report of flights that nobody flew."""

from __future__ import annotations

from typing import Any

import pytest
from generators.labels import page

from tests.sitl.studies.labels.made_up import made_up_world
from trimtab.sitl.studies.labels.summary import summary

PROVENANCE = {"command": "trimtab study labels --seed 12", "git": "0123456789ab"}


@pytest.fixture(scope="module")
def outcome() -> dict[str, Any]:
    told = {"study": "labels", "seed": 12, "worlds": 3, "quick": False}
    return summary(told, [made_up_world(world) for world in range(3)])


def test_page_holds_every_cell_of_every_table(outcome: dict[str, Any]) -> None:
    lines = page({**outcome["answer"], "provenance": PROVENANCE}).splitlines()
    for title, rows in outcome["tables"].items():
        start = lines.index(f"### {title}") + 4
        assert lines[start : start + len(rows)] == [f"| {' | '.join(row.values())} |" for row in rows]


def test_page_says_seed_commit_and_size_in_short_lines(outcome: dict[str, Any]) -> None:
    text = page({**outcome["answer"], "provenance": PROVENANCE})
    assert "    trimtab study labels --seed 12\n" in text
    prose = " ".join(text.split())
    assert "Results of seed 12, 3 worlds, commit 0123456789ab, 96 held-out flights." in prose
    assert "development figures" not in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 120


def test_page_of_a_quick_run_says_so(outcome: dict[str, Any]) -> None:
    text = page({**outcome["answer"], "quick": True, "provenance": PROVENANCE})
    assert "development figures" in text
