"""Report of the study of planning: the paper's numbers beside ours, in tables and a figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.apps.paper.planning.compare import KINDS
from trimtab.host.report import learning_figures
from trimtab.host.report.figures import Figure
from trimtab.host.report.tables import tables_page

_MEASURES = {
    "planned residual": "residual_mean_m_s2",
    "flown mean error": "error_mean_m",
    "greatest jerk": "jerk_max_m_s3",
}


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the study's picture by file stem."""
    others = [kind for kind in KINDS if kind not in ("min-snap", "min-control*", "min-control-r")]
    ratios = {
        title: {kind: [_over(course["kinds"], kind, key) for course in outcome["courses"]] for kind in others}
        for title, key in _MEASURES.items()
    }
    return {
        "courses": learning_figures.over_nominal(
            ratios,
            {kind: kind for kind in others},
            "Held-out courses, planned with a learned model and flown by the DFBC: ratio to the min-snap "
            "plan of the same course in the same time. One point for each course; bars are medians.",
            over="min-snap",
        )
    }


def _over(kinds: Mapping[str, Mapping[str, Any]], kind: str, key: str) -> float | None:
    value, base = kinds[kind].get(key), kinds["min-snap"].get(key)
    return None if value is None or not base else value / base


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    return tables_page("The paper's planning section", outcome, drawn, provenance)
