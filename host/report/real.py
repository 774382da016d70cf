"""Report of the study of real flights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.report.figures import Figure
from trimtab.host.report.tables import tables_page


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return no pictures; the report consists of tables."""
    return {}


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    size = f"{outcome['answer']['n']['groups']} groups"
    return tables_page("Real flights", outcome, drawn, provenance, size)
