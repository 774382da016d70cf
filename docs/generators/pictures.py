"""Pictures of pages for the guides: `python docs/generators/pictures.py DEMO`, with the folder of a demo.

Needs Chromium. Not part of `make docs`: another version of the browser draws other pixels.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

TARGET = Path(__file__).parents[1] / "pictures"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FIRST, APPLIED = "05-sprint.mcap", "12-sprint-again.mcap"
"""Flights of the demo with seed 1."""
AT_SAMPLE = 1000
COLOURS = 160
FRAME = """<body style="margin:0"><iframe id="frame" style="border:0" width="{width}" height="{height}"
src="{page}"></iframe><script>document.getElementById("frame").onload = () => {{
  const slider = document.getElementById("frame").contentDocument.getElementById("slider");
  if (!slider) return;
  slider.value = {sample};
  slider.dispatchEvent(new Event("input"));
}};</script>"""
"""A window cannot be as narrow as a phone; a frame can."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture of a page: size in CSS pixels, and flights of the demo to show; none for its truth page."""

    name: str
    width: int
    height: int
    flights: tuple[str, ...] = ()
    dark: bool = False


PICTURES = (
    Picture(name="show-flight.png", width=1280, height=960, flights=(FIRST,)),
    Picture(name="show-phone.png", width=390, height=1340, flights=(FIRST,), dark=True),
    Picture(name="show-two.png", width=1280, height=1030, flights=(FIRST, APPLIED)),
    Picture(name="demo-truth.png", width=1080, height=890),
)


def draw(picture: Picture, demo: Path, folder: Path) -> None:
    """Write one picture, with few colours. folder: for what is needed meanwhile."""
    page = folder / "page.html"
    if picture.flights:
        logs = [str(demo / name) for name in picture.flights]
        command = [sys.executable, "-m", "trimtab.host.cli", "show", *logs, "--html", str(page), "--force"]
        subprocess.run(command, check=True)
    else:
        shutil.copy(demo / "truth.html", page)
    frame, shot = folder / "frame.html", folder / "shot.png"
    text = FRAME.format(width=picture.width, height=picture.height, page=page.name, sample=AT_SAMPLE)
    frame.write_text(text, encoding="utf-8")
    browser = next(path for path in map(shutil.which, BROWSERS) if path is not None)
    options = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--allow-file-access-from-files",
        "--hide-scrollbars",
        "--virtual-time-budget=4000",
        f"--user-data-dir={folder / 'profile'}",
        f"--window-size={max(500, picture.width)},{picture.height}",
        f"--screenshot={shot}",
    ]
    if picture.dark:
        options.append("--blink-settings=preferredColorScheme=0")
    subprocess.run([browser, *options, frame.as_uri()], check=True, capture_output=True)
    with Image.open(shot) as image:
        cut = image.convert("RGB").crop((0, 0, picture.width, picture.height))
        cut.quantize(COLOURS).save(TARGET / picture.name, optimize=True)


def main() -> None:
    """Write every picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("demo", type=Path)
    demo = parser.parse_args().demo
    TARGET.mkdir(exist_ok=True)
    for picture in PICTURES:
        with tempfile.TemporaryDirectory() as folder:
            draw(picture, demo, Path(folder))


if __name__ == "__main__":
    main()
