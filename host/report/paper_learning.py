"""Report of the study of learning: the paper's numbers beside ours, in tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.apps.paper.learning.summary import METHODS
from trimtab.host.report import learning_figures
from trimtab.host.report.figures import Figure
from trimtab.host.report.tables import tables_page


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the study's pictures by file stem."""
    panels: dict[str, list[Any]] = {}
    for trial in outcome["curves"]:
        held = ", reference held" if trial["held"] else ""
        panels.setdefault(f"L: {trial['weight']}{held}", []).append(trial)
    return {
        "curves": learning_figures.learning_curves(
            panels, "Learning curves of Adam from random first weights, by weights of the loss."
        ),
        "noise": learning_figures.over_noise(
            outcome["noise"], "Pointwise acceleration error on exact test flights, by method of learning."
        ),
        "worlds": learning_figures.over_nominal(
            outcome["flown"]["ratios"],
            METHODS,
            "Whole flights through firmware and radio: position error of the prediction over that of the "
            "nominal model. One point for each world; bars are medians.",
        ),
    }


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    return tables_page("The paper's learning section", outcome, drawn, provenance)
