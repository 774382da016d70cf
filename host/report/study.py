"""The page of a study: table, who was taken for whom, errors beside their intervals, what went wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, StrictUndefined, select_autoescape

from host.report import figures
from host.report.figures import Figure


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """The study's pictures by file stem: `confusion` and, where an effect was named rightly, `coverage`."""
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
    """The HTML of a study's report; offline, one file."""
    environment = Environment(
        autoescape=select_autoescape(default_for_string=True, default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = files("host.report").joinpath("study.html.j2").read_text(encoding="utf-8")
    answer = outcome["answer"]
    return environment.from_string(template).render(
        title=f"Blind study of {answer['worlds']} worlds, seed {answer['seed']}",
        table=outcome["table"],
        thin=outcome["thin"],
        real=outcome["real"],
        baselines=outcome["baselines"],
        figures=list(drawn.values()),
        wrong=outcome["wrong"],
        provenance=json.dumps(dict(provenance), indent=1, default=str),
        data=json.dumps(answer, allow_nan=False).replace("</", "<\\/"),
    )
