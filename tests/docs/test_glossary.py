"""The glossary names modules and identifiers that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in (ROOT / "docs" / "reference" / "glossary.md").read_text("utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| term")
]
CODE = "\n".join(
    path.read_text("utf-8")
    for folder in ("host", "firmware_model", "protocol", "sitl")
    for path in (ROOT / folder).rglob("*.py")
)


def test_every_term_is_listed_once() -> None:
    terms = [row[0] for row in ROWS]
    assert len(terms) > 60
    assert len(set(terms)) == len(terms)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_term_names_what_exists(row: list[str]) -> None:
    for module in re.findall(r"`((?:host|firmware_model|protocol|sitl)[\w.]*)`", row[4]):
        path = ROOT / module.replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").is_file(), module
    for name in re.findall(r"`([A-Za-z_]\w+)`", row[1]):
        assert re.search(rf"\b{name}\b", CODE), name
