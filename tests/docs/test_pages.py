"""The pages under docs/ say what the code does."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from pydantic import BaseModel

from tests.docs.page_commands import PAGES as DOCS
from tests.docs.page_commands import ROOT, page_of
from trimtab.host.cli import VERBS, build_app
from trimtab.host.control.settings import (
    AdaptationSettings,
    DfbcSettings,
    GainFactors,
    MpcSettings,
    Tuned,
    Weights,
)
from trimtab.host.route import (
    Box,
    Cylinder,
    FigureEight,
    Gate,
    LimitsOverride,
    RandomWaypoints,
    Sphere,
    YawProfile,
    check_route,
    parse_route,
)
from trimtab.host.route.files import RouteFile
from trimtab.host.vehicle import Battery, Gains, Limits, Rotor, Vehicle, load_vehicle

PAGES = [*DOCS, ROOT / "CHANGELOG.md"]


SUBCOMMANDS = (
    ["log", "info"],
    ["log", "recover"],
    ["log", "export"],
    ["vehicle", "new"],
    ["vehicle", "check"],
)


@pytest.mark.parametrize(
    ("page", "models"),
    [
        ("../concepts/controllers.md", (DfbcSettings, MpcSettings, GainFactors, Weights)),
        ("../concepts/controllers.md", (AdaptationSettings, Tuned)),
        ("vehicle-file.md", (Vehicle, Rotor, Battery, Limits, Gains)),
        ("route-file.md", (RouteFile, YawProfile, LimitsOverride, Gate, Box, Sphere, Cylinder)),
        ("route-file.md", (FigureEight, RandomWaypoints)),
    ],
)
def test_page_names_every_key(page: str, models: tuple[type[BaseModel], ...]) -> None:
    text = (ROOT / "docs" / "reference" / page).read_text()
    keys = {name for model in models for name in model.model_fields}
    assert sorted(key for key in keys if not re.search(rf"[`\[.]{key}[`\]]", text)) == []


def test_route_pages_example_is_a_good_route() -> None:
    page = (ROOT / "docs" / "reference" / "route-file.md").read_text()
    (example,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    limits = check_route(parse_route(example, "example"), load_vehicle("research"))
    assert limits.speed_max_m_s == 3.0


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_of_page_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
        assert (page.parent / target).is_file(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_commands_of_page_are_ones_that_the_command_line_takes(page: Path) -> None:
    for command in page_of(page.read_text()).commands:
        program, *words = command.text.split()
        if program == "trimtab":
            build_app().parse_args(words, exit_on_error=False, print_error=False)


def test_options_of_every_page_exist(capsys: pytest.CaptureFixture[str]) -> None:
    verbs = [[verb.name] for verb in VERBS]
    for words in ([], *verbs, *SUBCOMMANDS):
        build_app()([*words, "--help"])
    known = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out))
    for page in PAGES:
        text = re.sub(r"mavproxy\.py [^`\n]*", "", page.read_text())  # another program's options
        named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text))
        assert sorted(named - known) == [], page.name


def test_drawing_places_rotors_as_the_research_vehicle_has_them() -> None:
    # Up on the page is forward, right is right; the body's centre is drawn at (250, 250).
    svg = "{http://www.w3.org/2000/svg}"
    tree = ElementTree.parse(ROOT / "docs" / "concepts" / "conventions.svg")
    drawn: dict[tuple[bool, bool], list[str]] = {}
    for text in tree.iter(f"{svg}text"):
        x, y = float(text.get("x", 0)) - 250, 250 - float(text.get("y", 0))
        if text.text in ("1", "2", "3", "4", "cw", "ccw"):
            drawn.setdefault((y > 0, x > 0), []).append(text.text)
    expected = {}
    for number, rotor in enumerate(load_vehicle("research").rotors, start=1):
        expected[(rotor.position_m[0] > 0, rotor.position_m[1] > 0)] = [str(number), rotor.spin]
    assert drawn == expected
