"""Report of the link study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.report.figures import Figure
from trimtab.host.report.tables import tables_page


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return no pictures; the sequence picture is a separate file."""
    return {}


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    size = f"{outcome['answer']['runs']} uploads per channel"
    return tables_page("The link", outcome, drawn, provenance, size)
