"""Pages of `trimtab show` in a headless Chromium: what is drawn, what the slider moves, what fits."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.report.show import page
from trimtab.host.show.content import read_content
from trimtab.host.workspace import open_workspace

DATA = Path(__file__).parent.parent / "data"
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--allow-file-access-from-files",  # so that the frame below can be read
    "--window-size=1400,1000",
    "--dump-dom",
)
FRAME = """<iframe id="frame" width="{width}" height="900" src="{page}#check"></iframe><pre id="said"></pre>
<script>document.getElementById("frame").onload = () => {{
  const inside = document.getElementById("frame").contentDocument;
  document.getElementById("said").textContent = inside.getElementById("check").textContent;
}};</script>"""
"""A window cannot be as narrow as a phone; a frame can."""
FLIGHT = ["Tracking error", "Position", "Velocity", "Attitude", "Body rate", "Motor commands"]


@pytest.fixture
def checked(require: Callable[[str], None], tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """What the page of some inputs says of itself at a width, CSS pixels."""
    require("browser")
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next(path for path in map(shutil.which, names) if path is not None)

    def check(*inputs: Path, width: int) -> dict[str, Any]:
        text = page(read_content(inputs, open_workspace(tmp_path)))
        (tmp_path / "page.html").write_text(text, encoding="utf-8")
        (tmp_path / "frame.html").write_text(FRAME.format(width=width, page="page.html"), encoding="utf-8")
        done = subprocess.run(
            [browser, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}", (tmp_path / "frame.html").as_uri()],
            capture_output=True,
            text=True,
            check=True,
        )
        (said,) = re.findall(r'<pre id="said">(.*?)</pre>', done.stdout, flags=re.DOTALL)
        assert said, "the page ended before its check"
        return json.loads(html.unescape(said))

    return check


def holds(said: dict[str, Any], width: int) -> None:
    """What every page must hold."""
    assert said["errors"] == []
    assert said["requests"] == 0
    assert (said["width"], said["overflow"]) == (width, 0)
    for plot, places in zip(said["plots"], said["cursor_places"], strict=True):
        assert plot["series"] > 0
        assert plot["colours"] > 20, plot["title"]  # axes, labels and lines, smoothed
        assert places > 40, plot["title"]
    assert said["scene_colours"] > 100
    assert said["vehicle_places"] > 20


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
    assert (said["errors"], said["overflow"]) == ([], 0)


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
        (("none.mcap",), 5),
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
