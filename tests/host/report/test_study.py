"""The page of a study and its pictures, from an outcome as the study hands it over."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.browser import ask, fits
from trimtab.host.base.errors import UsageError
from trimtab.host.report.study import page, pictures
from trimtab.host.report.tables import tables_page
from trimtab.host.studies import find_study

OUTCOME = {
    "answer": {
        "seed": 3,
        "worlds": 4,
        "plant": "rotor<b>py",
        "by_family": {
            "timing": {"coverage_2sigma": 0.5, "interval": [0.01, 0.99], "n": 2},
            "force": {"coverage_2sigma": None, "interval": None, "n": 0},
        },
    },
    "table": [{"figure": "top-1 <b>", "value": "50 %", "n": 2, "interval": "1-99 %", "target": ">= 95 %"}],
    "thin": [
        {"case": "no <i>", "n": 7, "told": 6, "right": 5, "undecided": 2, "nothing-missing": 0, "refused": 0}
        | {"outside-library": 0, "wrong": 0, "failed": 0}
    ],
    "real": [
        {"name": "our", "used": "a1", "held_out": "c1", "verdict": "traced", "said": "mass & more"}
        | {"before": "9.0 mm", "after": "4.0 mm", "seconds": "3 s"}
    ],
    "baselines": [],
    "confusion": {"motor-lag": {"motor-lag": 3, "undecided": 1}, "nothing": {"nothing-missing": 2}},
    "deviations": {"timing": [0.4, -9.0], "force": []},
    "wrong": [("0001", "motor-lag: undecided, motor-lag")],
}


def test_pictures_are_drawn_for_what_was_counted() -> None:
    drawn = pictures(OUTCOME)
    assert list(drawn) == ["confusion", "coverage"]
    assert all(picture.png.startswith(b"\x89PNG") for picture in drawn.values())
    assert "6 counts in 2 rows and 3 columns, 3 where names agree" in drawn["confusion"].alt
    assert "timing 50 %" in drawn["coverage"].alt
    assert list(pictures({**OUTCOME, "deviations": {"timing": []}})) == ["confusion"]


def test_page_holds_table_pictures_and_wrong_worlds_and_nothing_from_elsewhere() -> None:
    html = page(OUTCOME, pictures(OUTCOME), {"version": "1"})
    assert "<title>Blind study of 4 worlds in the plant of rotor&lt;b&gt;py, seed 3 " in html
    assert "top-1 &lt;b&gt;" in html
    assert "motor-lag: undecided, motor-lag" in html
    assert "no &lt;i&gt;" in html
    assert ">6</td></tr>" in html
    assert "mass &amp; more" in html
    assert html.count("<img ") == 2
    assert not re.search(r'(src|href)="(?!data:)', html)


@pytest.mark.full  # a browser
@pytest.mark.parametrize("report", ["study", "tables"])
def test_page_fits_a_phone_and_is_dark_where_that_is_asked_for(
    require: Callable[[str], None], tmp_path: Path, report: str
) -> None:
    require("browser")
    row = {f"column {k}": "0.123 to 0.456" for k in range(12)}
    html = (
        page(OUTCOME, pictures(OUTCOME), {"version": "1"})
        if report == "study"
        else tables_page("Wide", {"answer": {"quick": True, "seed": 1}, "tables": {"A table": [row]}}, {}, {})
    )
    (tmp_path / "page.html").write_text(html, encoding="utf-8")
    fits(ask(tmp_path / "page.html", tmp_path, width=390, dark=True), 390, dark=True)


def test_study_that_nobody_has_is_refused() -> None:
    with pytest.raises(UsageError, match="no study called nosuch"):
        find_study("nosuch")
