"""Report of a study that consists of tables and figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from trimtab.host.report.figures import Figure
from trimtab.host.report.html import render, script_data


def tables_page(
    title: str,
    outcome: Mapping[str, Any],
    drawn: Mapping[str, Figure],
    provenance: Mapping[str, object],
    size: str | None = None,
) -> str:
    """Return the HTML of the study's report, one file that opens offline.

    size: how large the study is, in words; by default its number of worlds. A study without a seed draws
    nothing.
    """
    answer = outcome["answer"]
    quick = answer.get("quick", False)
    scope = "quick check, not for the record" if quick else size or f"{answer['worlds']} worlds"
    seed = f", seed {answer['seed']}" if "seed" in answer else ""
    return render(
        "tables.html.j2",
        title=f"{title}: {scope}{seed}",
        tables=outcome["tables"],
        figures=list(drawn.values()),
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=script_data(answer),
    )
