"""Pages in a headless Chromium: what a page says of itself at an address with #check, and what fits."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
DARK = "--blink-settings=preferredColorScheme=0"
FRAME = """<iframe id="frame" width="{width}" height="900" src="{page}#check"></iframe><pre id="said"></pre>
<script>document.getElementById("frame").onload = () => {{
  const frame = document.getElementById("frame"), inside = frame.contentDocument;
  const root = inside.documentElement;
  const check = inside.getElementById("check");
  document.getElementById("said").textContent = JSON.stringify({{
    ...(check ? JSON.parse(check.textContent) : {{}}),
    width: frame.contentWindow.innerWidth,
    overflow: root.scrollWidth - root.clientWidth,
    requests: frame.contentWindow.performance.getEntriesByType("resource").length,
    paper: frame.contentWindow.getComputedStyle(inside.querySelector("main")).backgroundColor,
  }});
}};</script>"""
"""A window cannot be as narrow as a phone; a frame can."""
LIGHT_PAPER, DARK_PAPER = "rgb(255, 255, 255)", "rgb(23, 27, 30)"


def ask(page: Path, folder: Path, *, width: int, dark: bool = False) -> dict[str, Any]:
    """What a page says of itself at a width, CSS pixels. folder: for what the browser writes."""
    frame = page.with_name("frame.html")
    frame.write_text(FRAME.format(width=width, page=page.name), encoding="utf-8")
    options = ["--allow-file-access-from-files", "--window-size=1400,1000", "--dump-dom"]
    try:
        shown = _run(frame, folder, *options, *([DARK] if dark else []))
    finally:
        frame.unlink()
    (said,) = re.findall(r'<pre id="said">(.*?)</pre>', shown, flags=re.DOTALL)
    assert said, "the page ended before its check"
    return json.loads(html.unescape(said))


def printed(page: Path, folder: Path) -> bytes:
    """The page as a PDF."""
    target = folder / "printed.pdf"
    _run(page, folder, f"--print-to-pdf={target}", DARK)
    return target.read_bytes()


def _run(page: Path, folder: Path, *options: str) -> str:
    browser = next(path for path in map(shutil.which, NAMES) if path is not None)
    command = [browser, *FLAGS, *options, f"--user-data-dir={folder / 'profile'}", page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def fits(said: dict[str, Any], width: int, *, dark: bool = False) -> None:
    """What every page must hold: nothing asked for, nothing beyond the window, the colours of the theme."""
    assert (said["width"], said["overflow"], said["requests"]) == (width, 0, 0)
    assert said["paper"] == (DARK_PAPER if dark else LIGHT_PAPER)


def draws(said: dict[str, Any], *, dark: bool = False) -> None:
    """What every page with flights or plans must hold: no error, all is drawn, and the slider moves it."""
    assert said["errors"] == []
    assert said["dark"] is dark
    assert said["dark_in_print"] is False
    assert said["plots"]
    for plot, places in zip(said["plots"], said["cursor_places"], strict=True):
        assert plot["series"] > 0
        assert plot["colours"] > 20, plot["title"]  # axes, labels and lines, smoothed
        assert plot["colours_in_print"] > 20, plot["title"]
        assert places > 40, plot["title"]
    assert said["scene_colours"] > 100
    assert said["vehicle_places"] > 20
