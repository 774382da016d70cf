"""The page on manoeuvres says what the code does, and the library parts what is confounded at rest."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from generators.manoeuvres import PAIRS, page

DOCS = Path(__file__).parents[2] / "docs" / "reference"
NUMBER = re.compile(r"(?<= )\d+\.\d(?= \|)")
Sigmas = dict[str, dict[str, float]]


@pytest.fixture(scope="module")
def made() -> str:
    return page()


@pytest.fixture(scope="module")
def sigmas(made: str) -> Sigmas:
    """Sigma by pair and route, as the page has them."""
    rows = [line.strip("|").split("|") for line in made.splitlines() if line.startswith("| `")]
    table = [[cell.strip() for cell in row] for row in rows if len(row) == 1 + len(PAIRS)]
    return {
        pair.title: {row[0].strip("`"): float(row[1 + i]) for row in table} for i, pair in enumerate(PAIRS)
    }


def test_manoeuvres_page_is_the_one_the_code_makes(made: str) -> None:
    written = (DOCS / "manoeuvres.md").read_text(encoding="utf-8")
    assert NUMBER.sub("x", written) == NUMBER.sub("x", made), "run `make docs`"
    # Figures are made by another machine's arithmetic.
    told = [[float(x) for x in NUMBER.findall(text)] for text in (written, made)]
    assert told[0] == pytest.approx(told[1], rel=0.05, abs=0.15)


@pytest.mark.parametrize(
    ("pair", "route", "times"),
    [
        # What tracing's table of confounding has for a lemniscate over hover: 31 to 8, 5 to 0.1.
        ("com-offset / torque-bias", "fast-lemniscate", 4.0),
        ("linear-drag / quadratic-drag", "fast-lemniscate", 50.0),
        ("linear-drag / quadratic-drag", "speed-sweep", 50.0),
        ("wind / frame-tilt", "hover-turns", 5.0),
        ("linear-drag.dz / thrust-inflow", "fast-lemniscate", 20.0),
        ("ground-effect / thrust-gain", "low-high", 20.0),
        ("motor-lag / actuation-delay", "doublets", 100.0),
        ("gyroscopic / inertia", "doublets", 100.0),
        ("slung-payload / thrust-gain", "stop-and-go", 20.0),
        ("battery-sag / thrust-gain", "long-hover", 2.0),
    ],
)
def test_manoeuvre_made_for_a_pair_parts_it_where_hover_does_not(
    pair: str, route: str, times: float, sigmas: Sigmas
) -> None:
    assert sigmas[pair][route] > 4.2
    assert sigmas[pair][route] > times * sigmas[pair]["hover"]


@pytest.mark.parametrize("pair", [pair.title for pair in PAIRS])
def test_some_manoeuvre_decides_each_pair(pair: str, sigmas: Sigmas) -> None:
    assert max(sigmas[pair].values()) > 10.0
