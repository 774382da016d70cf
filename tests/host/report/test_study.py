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
        "secret": None,
        "secret_sha256": None,
        "worlds": 4,
        "first": None,
        "plant": "rotor<b>py",
        "by_family": {
            "timing": {"coverage_2sigma": 0.5, "interval": [0.01, 0.99], "n": 2},
            "force": {"coverage_2sigma": None, "interval": None, "n": 0},
        },
        "probabilities": {
            "one flight": {
                "n": 3,
                "sure": 0.5,
                "sure_n": 2,
                "bins": [
                    {"low": 0.25, "high": 0.5, "mean": 0.3, "there": 0.0, "n": 1, "interval": [0.0, 0.975]},
                    {
                        "low": 0.99,
                        "high": 0.999,
                        "mean": 0.999,
                        "there": 0.5,
                        "n": 2,
                        "interval": [0.01, 0.99],
                    },
                ],
            },
            "one pair": {"n": 0, "sure": None, "sure_n": 0, "bins": []},
        },
        "detection": {
            size: {
                "total": [
                    {"low": 0.0, "high": 2.0, "n": 4, "found": 0.25, "interval": [0.01, 0.8]},
                    {"low": 64.0, "high": None, "n": 2, "found": 1.0, "interval": [0.15, 1.0]},
                ],
                "kinds": {
                    "wind": [{"low": 0.0, "high": 2.0, "n": 4, "found": 0.25, "interval": [0.01, 0.8]}],
                    "mass": [{"low": 64.0, "high": None, "n": 2, "found": 1.0, "interval": [0.15, 1.0]}],
                },
            }
            for size in ("sigma", "tolerances")
        },
    },
    "table": [{"figure": "top-1 <b>", "value": "50 %", "n": 2, "interval": "1-99 %", "target": ">= 95 %"}],
    "tables": {"Kinds <u>": [{"kind": "wind", "found": "1 of 4"}]},
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
    assert list(drawn) == ["confusion", "reliability", "detection", "coverage"]
    assert all(picture.png.startswith(b"\x89PNG") for picture in drawn.values())
    assert "6 counts in 2 rows and 3 columns, 3 where names agree" in drawn["confusion"].alt
    assert "timing 50 %" in drawn["coverage"].alt
    assert drawn["reliability"].alt == "Effects given at least 95 % that are there: one flight 50 % of 2."
    assert list(pictures({**OUTCOME, "deviations": {"timing": []}})) == [
        "confusion",
        "reliability",
        "detection",
    ]


def test_page_holds_table_pictures_and_wrong_worlds_and_nothing_from_elsewhere() -> None:
    html = page(OUTCOME, pictures(OUTCOME), {"version": "1"})
    assert "<title>Blind study of 4 worlds in the plant of rotor&lt;b&gt;py, seed 3 " in html
    assert "top-1 &lt;b&gt;" in html
    assert "motor-lag: undecided, motor-lag" in html
    assert "no &lt;i&gt;" in html
    assert ">6</td></tr>" in html
    assert "mass &amp; more" in html
    assert html.count("<img ") == 4
    assert "Kinds &lt;u&gt;" in html
    assert "1 of 4" in html
    stopped = page({**OUTCOME, "answer": {**OUTCOME["answer"], "first": 2}}, {}, {})
    assert "<title>Blind study of the first 2 of 4 worlds in the plant of " in stopped
    published = {"seed": None, "secret": "ab" * 32, "secret_sha256": "cd" * 32}
    sealed = page({**OUTCOME, "answer": {**OUTCOME["answer"], **published}}, {}, {})
    assert "<title>Blind study of 4 worlds in the plant of rotor&lt;b&gt;py, secret abababab " in sealed
    assert "ab" * 32 in sealed
    assert "cd" * 32 in sealed
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
