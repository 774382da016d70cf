"""Page of a demo's truth: what the sealed world held beside what was found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.apps.demo.truth import Judgement, Row, judgement_words
from trimtab.host.report.html import render

_WIDTH = 240.0
_REACH = 4.0
"""Standard deviations that a bar shows on each side of the truth."""


def page(
    judgement: Judgement,
    truth: Mapping[str, Any],
    verdict_id: str,
    before_m: float | None,
    after_m: float | None,
) -> str:
    """Return the HTML, one file that opens offline.

    truth: of `open_truth`. verdict_id: of the verdict's file. before_m, after_m: prediction error on held-out
    flights.
    """
    return render(
        "truth.html.j2",
        sentence=judgement_words(judgement),
        judgement=judgement,
        rows=[_row(row) for row in judgement.rows],
        world=truth["world"],
        turbulence=truth["turbulence"],
        deviations=[(name, f"{value:.3g}") for name, value in sorted(truth["deviations"].items())],
        verdict_id=verdict_id,
        error=None
        if before_m is None or after_m is None
        else (f"{1e3 * before_m:.1f}", f"{1e3 * after_m:.1f}"),
        width=_WIDTH,
        middle=0.5 * _WIDTH,
        band=(0.5 * _WIDTH - 2.0 * _scale(), 4.0 * _scale()),
    )


def _scale() -> float:
    """Return the pixels of one standard deviation."""
    return 0.5 * (_WIDTH - 16.0) / _REACH


def _row(row: Row) -> dict[str, str]:
    """Return a row of the table as text, with the place of the found value in its bar."""
    sigmas = row.sigmas
    shown = 0.0 if sigmas is None else max(-_REACH, min(_REACH, sigmas))
    return {
        "effect": row.effect,
        "key": row.key,
        "unit": "" if row.unit == "1" else row.unit,
        "true": "not in the world" if row.true is None else f"{row.true:.4g}",
        "found": "not named" if row.found is None else f"{row.found:.4g}",
        "sd": "–" if row.sd is None else f"{row.sd:.2g}",
        "sigmas": "–" if sigmas is None else f"{round(sigmas, 1) + 0.0:.1f}",
        "place": "" if sigmas is None else f"{0.5 * _WIDTH + _scale() * shown:.1f}",
    }
