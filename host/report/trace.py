"""Report of a trace: verdict, parameters, errors before and after, ranking, health of the data."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.log import Flight
from trimtab.host.report import figures
from trimtab.host.report.html import VERDICTS, render, script_data
from trimtab.host.trace import words
from trimtab.host.trace.prediction import Errors
from trimtab.host.trace.result import Trace


def pictures(result: Trace) -> list[figures.Figure]:
    """Return the figures of errors and ranking, for `page`."""
    drawn = []
    if result.before:
        worst = int(np.argmax([np.linalg.norm(e.p_error_ned, axis=1).mean() for e in result.before]))
        panels = [
            (title, errors[worst].p_measured_ned, np.linalg.norm(errors[worst].p_error_ned, axis=1))
            for title, errors in (("before", result.before), ("after", result.after))
        ]
        caption = (
            "Path of the held-out flight with the greatest error before, coloured by the prediction error."
        )
        drawn.append(figures.paths(panels, caption))
        drawn.append(figures.residuals(result.before, result.after, result.noise_floor["position_rmse_m"]))
    drawn.append(figures.ranking(result.evidence, [e.name for e in result.effects]))
    return drawn


def page(
    result: Trace,
    flights: Sequence[Flight],
    held_out: Sequence[Flight],
    answer: Mapping[str, Any],
    drawn: Sequence[figures.Figure],
    extra: Mapping[str, Any] | None = None,
) -> str:
    """Return the HTML of the report.

    `drawn` are the `pictures` of the result. `extra` adds sections, a list of {title, text, figures, table}
    under "sections", and entries of the JSON data under "data".
    """
    return render(
        "page.html.j2",
        title=VERDICTS[result.verdict].capitalize(),
        sentence=words.verdict(result),
        words=words,
        result=result,
        figures=drawn,
        outside=None if result.description is None else figures.dependence(result.description),
        errors=_table(result),
        flights=flights,
        held_out=held_out,
        sections=(extra or {}).get("sections", ()),
        provenance=json.dumps(dict(result.model.provenance), indent=1, default=str),
        data=script_data({**answer, **(extra or {}).get("data", {})}),
        effects=result.space.effects,
    )


def _table(result: Trace) -> list[dict[str, Any]]:
    """Return rows of position errors, mm, for "before", "adjustments only" and "after".

    Each holds the RMS by axis, and the RMS, 95th percentile and maximum of the norm.
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
        p = np.concatenate([e.p_error_ned for e in errors])
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
    return float(np.sqrt((errors.p_error_ned**2).sum(1).mean())) * 1e3
