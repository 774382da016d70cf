"""The page of a trace: verdict, health of the data, error before and after, ranking, parameters, limits."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.log import Flight
from trimtab.host.report import figures
from trimtab.host.report.html import render, script_data
from trimtab.host.trace.result import Trace
from trimtab.host.trace.score import Errors

VERDICTS = {
    "traced": "Traced",
    "nothing-missing": "Nothing missing",
    "undecided": "Undecided",
    "outside-library": "Outside the library",
}


def page(
    result: Trace,
    flights: Sequence[Flight],
    held_out: Sequence[Flight],
    answer: Mapping[str, Any],
    extra: Mapping[str, Any] | None = None,
) -> str:
    """The HTML of the report; `extra` adds sections: a list of {title, text, figures, table} under
    "sections".
    """
    pictures = []
    if result.before:
        worst = int(np.argmax([np.linalg.norm(e.position, axis=1).mean() for e in result.before]))
        panels = [
            (title, errors[worst].measured, np.linalg.norm(errors[worst].position, axis=1))
            for title, errors in (("before", result.before), ("after", result.after))
        ]
        caption = (
            "Path of the held-out flight with the greatest error before, coloured by the prediction's error."
        )
        pictures.append(figures.paths(panels, caption))
        pictures.append(figures.residuals(result.before, result.after, result.noise_floor["position_rmse_m"]))
    pictures.append(figures.ranking(result.evidence, [e.name for e in result.effects]))
    return render(
        "page.html.j2",
        title=VERDICTS[result.verdict],
        sentence=sentence(result),
        result=result,
        figures=pictures,
        outside=None if result.description is None else figures.dependence(result.description),
        errors=_table(result),
        flights=flights,
        held_out=held_out,
        sections=(extra or {}).get("sections", ()),
        provenance=json.dumps(dict(result.model.provenance), indent=1, default=str),
        data=script_data({**answer, **(extra or {}).get("data", {})}),
        effects=result.space.effects,
    )


def sentence(result: Trace) -> str:
    """The verdict in one sentence."""
    names = _listed([e.title.lower() for e in result.effects])
    if result.verdict == "traced":
        text = f"The model is missing {names}."
    elif result.verdict == "undecided":
        text = f"The model may be missing {names}; another explanation cannot be excluded."
    elif result.verdict == "nothing-missing":
        text = "Nothing beyond the vehicle's tolerances stands out."
    else:
        text = "Something acts that the library does not hold: " + "; ".join(result.reasons) + "."
    if result.before_score and result.after_score and result.effects:
        b, a = result.before_score["position_rmse_m"], result.after_score["position_rmse_m"]
        n = len(result.before)
        flights = "flight" if n == 1 else "flights"
        text += (
            f" On {n} held-out {flights} the prediction error went from {1e3 * b:.0f} to {1e3 * a:.0f} mm."
        )
    return text


def _listed(names: Sequence[str]) -> str:
    """Names as in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _table(result: Trace) -> list[dict[str, Any]]:
    """Rows of position error by axis and norm: rms, 95th percentile and greatest, before, adjusted and
    after.
    """
    if not result.before:
        return []
    rows = []
    columns = (
        ("before", result.before),
        ("adjustments only", result.adjustments_only),
        ("after", result.after),
    )
    for label, errors in columns:
        p = np.concatenate([e.position for e in errors])
        norm = np.linalg.norm(p, axis=1)
        rows.append(
            {
                "label": label,
                "axes": [float(np.sqrt((p[:, i] ** 2).mean())) * 1e3 for i in range(3)],
                "rms": float(np.sqrt((norm**2).mean())) * 1e3,
                "p95": float(np.quantile(norm, 0.95)) * 1e3,
                "greatest": float(norm.max()) * 1e3,
                "flights": [_rms(e) for e in errors],
            }
        )
    return rows


def _rms(errors: Errors) -> float:
    return float(np.sqrt((errors.position**2).sum(1).mean())) * 1e3
