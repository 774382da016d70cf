"""The page of the study of learning: the paper's numbers beside ours, tables and pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from host.paper.learning.summary import METHODS
from host.report import learning_figures
from host.report.figures import Figure
from host.report.html import render, script_data


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """The study's pictures by file stem."""
    panels: dict[str, list[Any]] = {}
    for trial in outcome["curves"]:
        held = ", reference held" if trial["held"] else ""
        panels.setdefault(f"L: {trial['weight']}{held}", []).append(trial)
    return {
        "curves": learning_figures.learning_curves(
            panels, "Learning curves of Adam from random first weights, by weights of the loss."
        ),
        "noise": learning_figures.over_noise(
            outcome["noise"], "Pointwise acceleration error on exact test flights, by what was learned from."
        ),
        "worlds": learning_figures.over_nominal(
            outcome["flown"]["ratios"],
            METHODS,
            "Whole flights through firmware and radio: position error of the prediction over that of the "
            "nominal model, a point a world, medians as bars.",
        ),
    }


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """The HTML of the study's report; offline, one file."""
    answer = outcome["answer"]
    scope = "a quick look, no figure of record" if answer["quick"] else f"{answer['worlds']} worlds"
    return render(
        "tables.html.j2",
        title=f"The paper's learning section: {scope}, seed {answer['seed']}",
        tables=outcome["tables"],
        figures=list(drawn.values()),
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=script_data(answer),
    )
