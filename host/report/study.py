"""The page of a study: table, who was taken for whom, errors beside their intervals, what went wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from trimtab.host.report import figures
from trimtab.host.report.figures import Figure
from trimtab.host.report.html import render, script_data


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the study's pictures by file stem: `confusion` and, where an effect was named rightly,
    `coverage`.
    """
    found = {
        "confusion": figures.counts(
            outcome["confusion"],
            "Worlds by what they held and what was named first; shaded by share of the row.",
            rows="what the world held",
            columns="what was named first, or the verdict",
        )
    }
    families = {name: errors for name, errors in outcome["deviations"].items() if errors}
    if families:
        by_family = outcome["answer"]["by_family"]
        coverage = {
            name: (by_family[name]["coverage_2sigma"], *by_family[name]["interval"]) for name in families
        }
        found["coverage"] = figures.deviations(
            families, coverage, "Errors of the parameters of effects that were named rightly, by family."
        )
    return found


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of a study's report; offline, one file."""
    answer = outcome["answer"]
    return render(
        "study.html.j2",
        title=f"Blind study of {answer['worlds']} worlds, seed {answer['seed']}",
        table=outcome["table"],
        thin=outcome["thin"],
        real=outcome["real"],
        baselines=outcome["baselines"],
        figures=list(drawn.values()),
        wrong=outcome["wrong"],
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=script_data(answer),
    )
