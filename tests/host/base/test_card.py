"""Cards for notebooks: escaped tables without script or colour."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import pytest

from trimtab.host.base.card import card, simulated_badge, table


def test_card_escapes_every_text() -> None:
    bad = "<script>alert('x')</script>&"
    html = card(bad, [(bad, bad)], table((bad,), [(bad,)]), badge=bad)
    assert "<script" not in html
    root = ElementTree.fromstring(html)
    assert [element.text.strip() for element in root.iter() if element.text] == [bad] * 6
    assert {element.tag for element in root.iter()} <= {
        "div", "p", "span", "table", "thead", "tbody", "tr", "th", "td",
    }  # fmt: skip


def test_card_leaves_out_facts_without_a_value_and_tables_without_rows() -> None:
    html = card("One", [("known", 1.23456), ("unknown", None)], table(("head",), []))
    assert "known" in html
    assert "unknown" not in html
    assert "head" not in html
    assert "1.235" in html


def test_card_sets_no_colour_so_that_it_is_readable_in_dark_mode() -> None:
    html = card("One", [("a", 1)], table(("b",), [(None, True)]), badge="simulated")
    styles = [element.get("style") or "" for element in ElementTree.fromstring(html).iter()]
    properties = {part.split(":")[0] for style in styles for part in style.split(";")}
    assert not properties & {"color", "background", "background-color"}


@pytest.mark.parametrize(
    ("simulated", "flights", "badge"),
    [(0, 3, None), (3, 3, "simulated"), (1, 3, "1 of 3 flights simulated"), (0, 0, None)],
)
def test_badge_tells_how_many_flights_were_simulated(simulated: int, flights: int, badge: str | None) -> None:
    assert simulated_badge(simulated, flights) == badge
