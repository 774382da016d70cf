"""A result as a small HTML card, which notebooks show: facts and tables, without script.

Cards set no colour of their own, so that they are readable on a light and on a dark page.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape as escape_html

from trimtab.host.base.text import escaped

Row = Sequence[object]

_BADGE = "border:1px solid currentColor;border-radius:.3em;padding:0 .4em;font-size:.85em;font-weight:normal"


def card(title: str, facts: Iterable[tuple[str, object]], *tables: str, badge: str | None = None) -> str:
    """Return a card: a title with a badge, facts as rows of name and value, and tables made by `table`.

    A fact whose value is None is left out. All texts are escaped.
    """
    mark = "" if badge is None else f' <span style="{_BADGE}">{escape(badge)}</span>'
    known = [(name, _text(value)) for name, value in facts if value is not None]
    return (
        f'<div class="trimtab"><p style="margin:.3em 0;font-weight:bold">{escape(title)}{mark}</p>'
        f"{table((), known)}{''.join(tables)}</div>"
    )


def table(head: Sequence[str], rows: Iterable[Row]) -> str:
    """Return a table, or an empty text without rows. Numbers get four digits, None a dash."""
    lines = [_row("td", row) for row in rows]
    if not lines:
        return ""
    top = f"<thead>{_row('th', head)}</thead>" if head else ""
    return f'<table style="margin:.3em 0">{top}<tbody>{"".join(lines)}</tbody></table>'


def simulated_badge(simulated: int, flights: int) -> str | None:
    """Return the badge of a result from so many flights, of which so many are known to be simulated."""
    if simulated == 0:
        return None
    return "simulated" if simulated == flights else f"{simulated} of {flights} flights simulated"


def escape(text: str) -> str:
    """Return a text for a page: markup and what cannot be seen are escaped."""
    return escape_html(escaped(text, lines=True))


def _row(tag: str, cells: Row) -> str:
    return "<tr>" + "".join(_cell(tag, cell) for cell in cells) + "</tr>"


def _cell(tag: str, value: object) -> str:
    is_number = value is None or (isinstance(value, float | int) and not isinstance(value, bool))
    style = f"text-align:{'right' if is_number else 'left'};padding:.1em .8em .1em 0"
    return f'<{tag} style="{style}">{escape(_text(value))}</{tag}>'


def _text(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
