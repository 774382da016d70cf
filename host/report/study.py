"""Report of the blind study: scores, confusion table, errors with their intervals, wrong verdicts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from trimtab.host.report import figures, study_figures
from trimtab.host.report.figures import Figure
from trimtab.host.report.html import render, script_data


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the pictures by file stem: `confusion`, and what there is of `reliability` (of probabilities),
    `detection` (of effects by size) and `coverage` (of correctly named effects).
    """
    drawn = {
        "confusion": figures.counts(
            outcome["confusion"],
            "Worlds by true effect and by the effect named first; shaded by share of the row.",
            rows="true effect",
            columns="effect named first, or verdict",
        )
    }
    given = {data: found for data, found in outcome["answer"]["probabilities"].items() if found["n"]}
    if given:
        drawn["reliability"] = study_figures.reliability(given)
    if outcome["answer"]["detection"]["sigma"]["total"]:
        drawn["detection"] = study_figures.detection(outcome["answer"]["detection"])
    families = {name: errors for name, errors in outcome["deviations"].items() if errors}
    if families:
        by_family = outcome["answer"]["by_family"]
        coverage = {
            name: (by_family[name]["coverage_2sigma"], *by_family[name]["interval"]) for name in families
        }
        drawn["coverage"] = figures.deviations(
            families, coverage, "Errors of the parameters of correctly named effects, by family."
        )
    return drawn


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    answer = outcome["answer"]
    worlds = f"{answer['worlds']} worlds"
    part = worlds if answer["first"] is None else f"the first {answer['first']} of {worlds}"
    where = "" if answer["plant"] is None else f" in the plant of {answer['plant']}"
    source = f"seed {answer['seed']}" if answer["secret"] is None else f"secret {answer['secret'][:8]}"
    return render(
        "study.html.j2",
        title=f"Blind study of {part}{where}, {source}",
        secret=answer["secret"],
        secret_sha256=answer["secret_sha256"],
        table=outcome["table"],
        tables=outcome["tables"],
        thin=outcome["thin"],
        real=outcome["real"],
        baselines=outcome["baselines"],
        figures=list(drawn.values()),
        wrong=outcome["wrong"],
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=script_data(answer),
    )
