"""Pages of `trimtab show` in a headless Chromium: what is drawn, what the slider moves, what fits."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.browser import ask, draws, fits
from trimtab.host.report.show import page
from trimtab.host.show.content import read_content
from trimtab.host.workspace import open_workspace

DATA = Path(__file__).parent.parent / "data"
FLIGHT = ["Tracking error", "Position", "Velocity", "Attitude", "Body rate", "Motor commands"]


@pytest.fixture
def checked(require: Callable[[str], None], tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """What the page of some inputs says of itself at a width, CSS pixels."""
    require("browser")

    def check(*inputs: Path, width: int) -> dict[str, Any]:
        target = tmp_path / "page.html"
        target.write_text(page(read_content(inputs, open_workspace(tmp_path))), encoding="utf-8")
        return ask(target, tmp_path, width=width)

    return check


def holds(said: dict[str, Any], width: int) -> None:
    """What every page of flights must hold."""
    fits(said, width)
    draws(said)


@pytest.mark.full  # a browser
@pytest.mark.parametrize("width", [390, 1280])
def test_page_of_a_flight_is_drawn_and_moves(checked: Callable[..., dict[str, Any]], width: int) -> None:
    said = checked(DATA / "a1.mcap", width=width)
    holds(said, width)
    assert [plot["title"] for plot in said["plots"]] == FLIGHT


@pytest.mark.full  # a browser
def test_page_of_several_flights_has_a_plot_for_each_axis(checked: Callable[..., dict[str, Any]]) -> None:
    said = checked(DATA / "a1.mcap", DATA / "c1.mcap", width=1280)
    holds(said, 1280)
    assert [plot["title"] for plot in said["plots"]][:3] == [
        "Tracking error",
        "Position: north",
        "Position: east",
    ]
    assert said["plots"][0]["series"] == 2
    assert said["choices"] == 2


@pytest.mark.full  # a browser
def test_page_of_a_cut_log_is_drawn(checked: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((DATA / "a1.mcap").read_bytes()[:500_000])
    said = checked(cut, width=390)
    holds(said, 390)


@pytest.mark.full  # a browser
def test_page_of_a_model_has_no_error_and_fits(
    checked: Callable[..., dict[str, Any]], drag_model: str, tmp_path: Path
) -> None:
    said = checked(tmp_path / drag_model, width=390)
    fits(said, 390)
    assert said["errors"] == []


@pytest.mark.full  # a browser
@pytest.mark.parametrize(("width", "dark"), [(390, True), (1280, False)])
def test_report_of_a_plan_is_drawn_and_fits(
    require: Callable[[str], None],
    trimtab: Callable[..., dict[str, Any]],
    tmp_path: Path,
    width: int,
    dark: bool,
) -> None:
    require("browser")
    trimtab("plan", "low-high", "--report", "plan.html", "-o", "a.ref")
    said = ask(tmp_path / "plan.html", tmp_path, width=width, dark=dark)
    fits(said, width, dark=dark)
    draws(said, dark=dark)
    assert [plot["title"] for plot in said["plots"]][2:4] == ["Planned speed", "Margin to the limits"]


def test_verb_writes_beside_the_input_and_overwrites_nothing(
    run_trimtab: Callable[..., tuple[int, dict[str, Any], str]], tmp_path: Path
) -> None:
    shutil.copy(DATA / "a1.mcap", tmp_path / "a1.mcap")
    code, said, _ = run_trimtab("show", "a1.mcap", "--json")
    assert (code, said["page"]) == (0, "a1.mcap.html")
    first = (tmp_path / "a1.mcap.html").read_bytes()
    code, said, _ = run_trimtab("show", "a1.mcap", "--json")
    assert (code, said["exit_code"]) == (2, 2)
    assert run_trimtab("show", "a1.mcap", "--force")[0] == 0
    assert (tmp_path / "a1.mcap.html").read_bytes() == first
    assert run_trimtab("show", ".", "--json")[1]["page"] == "show.html"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ((), 2),
        (("none.mcap",), 2),
        (("none.ref",), 2),
        (("none.model.toml",), 2),
        (("none.txt",), 2),
        (("none.mcap", "--html", "page.pdf"), 2),
        (("none.mcap", "--html", "none/page.html"), 2),
        (("none.ref", "--vehicle", "none"), 2),
    ],
)
def test_bad_input_of_the_verb_leaves_no_page(
    run_trimtab: Callable[..., tuple[int, dict[str, Any], str]],
    tmp_path: Path,
    words: tuple[str, ...],
    code: int,
) -> None:
    found, said, complaint = run_trimtab("show", *words, "--json")
    assert (found, said["exit_code"]) == (code, code)
    assert len(complaint.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
