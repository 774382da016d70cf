"""Report of a trace: verdict, parameters, errors before and after, ranking, health of the data."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trimtab.host.log import Flight
from trimtab.host.report import figures
from trimtab.host.report.html import VERDICTS, render, script_data
from trimtab.host.report.show import component
from trimtab.host.show.content import Content, content_of_flights
from trimtab.host.show.lattice import Track, peaks
from trimtab.host.trace import words
from trimtab.host.trace.prediction import Errors
from trimtab.host.trace.result import Trace

SHOWN = 3
"""Number of flights that are shown at first if none was held out."""
USED, HELD_OUT = "learned from", "held out"
"""Headings of the flights."""


def pictures(result: Trace) -> list[figures.Figure]:
    """Return the figures for `page`: the ranking of the candidates."""
    return [figures.ranking(result.evidence, [e.name for e in result.effects])]


def shown_flights(
    result: Trace, flights: Sequence[Flight], held_out: Sequence[Flight], more: Sequence[Flight] = ()
) -> Content:
    """Return the flights of a trace for `page`; held-out ones with their prediction errors before and after.

    The held-out flights are shown at first, without any the first `SHOWN`. `more` are further flights. Raises
    LogError if a log can no longer be read.
    """
    content = content_of_flights([flight.path for flight in (*flights, *held_out, *more)])
    tracks = []
    for index, (flight, track) in enumerate(zip((*flights, *held_out, *more), content.tracks, strict=True)):
        number = index - len(flights)
        is_held_out = 0 <= number < len(held_out)
        shown = is_held_out if held_out else index < SHOWN
        track = replace(track, group=HELD_OUT if is_held_out else USED, shown=shown)
        if is_held_out and result.before:
            track = _with_prediction(track, flight, result, number)
        tracks.append(track)
    return replace(content, tracks=tracks)


def _with_prediction(track: Track, flight: Flight, result: Trace, number: int) -> Track:
    """Return the track of a held-out flight with its prediction errors, mm: before, after, noise floor."""
    channel = next(iter(track.channels.values()))
    grid_us = (track.first + np.arange(len(channel))) * track.step_us
    zero_us = 0 if result.drive == "reference" or flight.tracking is None else flight.tracking[0]
    columns = []
    for errors in (result.before[number], result.after[number]):
        t_us = np.rint(1e6 * errors.t_s).astype(np.int64) - zero_us
        order = np.argsort(t_us, kind="stable")
        norm_mm = 1e3 * np.linalg.norm(errors.p_error_ned, axis=1)
        columns.append(peaks(grid_us, t_us[order], norm_mm[order])[:, 0])
    floor_m = result.noise_floor["position_rmse_m"]
    if floor_m is not None:
        columns.append(np.where(np.isfinite(columns[0]), 1e3 * floor_m, np.nan))
    return replace(track, channels={**track.channels, "prediction": np.stack(columns, axis=1)})


def page(
    result: Trace,
    flights: Sequence[Flight],
    held_out: Sequence[Flight],
    shown: Content,
    answer: Mapping[str, Any],
    drawn: Sequence[figures.Figure],
    extra: Mapping[str, Any] | None = None,
) -> str:
    """Return the HTML of the report.

    `shown` are the `shown_flights`, and `drawn` the `pictures` of the result. `extra` adds sections, a list
    of {title, text, figures, table} under "sections", links to files beside it (name, text)
    under "beside", and entries of the JSON data under "data".
    """
    return render(
        "page.html.j2",
        title=VERDICTS[result.verdict].capitalize(),
        sentence=words.verdict(result),
        words=words,
        result=result,
        figures=drawn,
        show=component(shown, folded=True),
        show_words=_show_words(bool(held_out)),
        titles=titles_of(shown),
        outside=None if result.description is None else figures.dependence(result.description),
        errors=_table(result),
        flights=flights,
        held_out=held_out,
        sections=(extra or {}).get("sections", ()),
        beside=(extra or {}).get("beside", ()),
        provenance=json.dumps(dict(result.model.provenance), indent=1, default=str),
        data=script_data({**answer, **(extra or {}).get("data", {})}),
        effects=result.space.effects,
    )


def titles_of(shown: Content) -> dict[str, str]:
    """Return the title of each flight, by the id of its log."""
    return {row["id"]: track.name for row, track in zip(shown.flights, shown.tracks, strict=True)}


def _show_words(held_out: bool) -> str:
    """Return what a reader can do with the flights."""
    words = "Tick the flights to compare; a heading shows its flights only."
    if held_out:
        words += " Held-out flights have their prediction error before and after, over time and on the path."
    return words


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
