"""Report of the study of attacks."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from trimtab.host.report.figures import Figure
from trimtab.host.report.html import render, script_data


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return no pictures; the report consists of tables."""
    return {}


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    answer = outcome["answer"]
    scope = "quick check, not for the record" if answer["quick"] else f"{answer['trials']:,} frames"
    return render(
        "tables.html.j2",
        title=f"Attacks on the link: {scope}, seed {answer['seed']}",
        tables=outcome["tables"],
        figures=list(drawn.values()),
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=script_data(answer),
    )
