"""The interactive page of `trimtab show`: one file with its data, its scripts and its plotting library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from trimtab.host.report.html import VERDICTS, render, script_data
from trimtab.host.show.content import Content

_LIBRARY = "vendor/uplot/uPlot.iife.min.js"
_LIBRARY_STYLE = "vendor/uplot/uPlot.min.css"
_SCRIPTS = ("show_data.js", "show_plots.js", "show_scene.js", "show_page.js")
_BAR_WIDTH = 160.0
_BAR_EDGE = 8.0


def page(content: Content) -> str:
    """Return the HTML. The same content gives the same bytes; paths are left out."""
    show = component(content)
    shared = _shared_notes(content.flights)
    return render(
        "show.html.j2",
        title=_title(content),
        simulated=show["simulated"],
        notes=[*content.notes, *(f"All flights: {note}" for note in shared)],
        flights=[
            _flight(row, title, shared) for row, title in zip(content.flights, _titles(content), strict=True)
        ],
        plans=[_plan(row) for row in content.plans],
        models=[_model(row) for row in content.models],
        tracks=content.tracks,
        show=show,
    )


def component(content: Content, *, folded: bool = False) -> dict[str, Any]:
    """Return what the templates `show_head`, `show_panels` and `show_scripts` take as `show`.

    folded: whether the events are folded.
    """
    tracks = [track.to_json() for track in content.tracks]
    simulated = [track.simulated for track in content.tracks if track.what != "plan"]
    if not all(simulated):  # else the page says it once for all
        for track in tracks:
            track["name"] += " (simulated)" if track["simulated"] else ""
    return {
        "simulated": bool(simulated) and all(simulated),
        "words": _scene_words(content),
        "notes": list(dict.fromkeys(note for row in content.flights for note in row["notes"])),
        "has_plan": any(track.what == "plan" for track in content.tracks),
        "has_events": any(track.events for track in content.tracks),
        "folded": folded,
        "data": script_data({"tracks": tracks, "scene": content.scene, "facts": _without_folders(content)}),
        "library": _text(_LIBRARY),
        "library_style": _text(_LIBRARY_STYLE),
        "style": _text("show.css"),
        "scripts": [_text(name) for name in _SCRIPTS],
    }


def _text(name: str) -> str:
    return files("trimtab.host.report").joinpath(name).read_text(encoding="utf-8")


def _title(content: Content) -> str:
    names = [*(track.name for track in content.tracks), *(_name(row) for row in content.models)]
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"


def _name(row: Mapping[str, Any]) -> str:
    """Return the name of a row's file, without its folder."""
    return Path(next(row[key] for key in ("log", "reference", "model") if key in row)).name


def _without_folders(content: Content) -> dict[str, Any]:
    """Return the facts with the names of files instead of their paths."""
    return {
        "flights": [{**row, "log": _name(row)} for row in content.flights],
        "plans": [{**row, "reference": Path(row["reference"]).name} for row in content.plans],
        "models": [{**row, "model": _name(row)} for row in content.models],
        "notes": content.notes,
    }


def _number(value: float | None, form: str, factor: float = 1.0) -> str:
    return "–" if value is None else format(factor * value, form)


def _shared_notes(flights: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the notes that every one of several flights has."""
    if len(flights) < 2:
        return []
    return [note for note in flights[0]["notes"] if all(note in row["notes"] for row in flights)]


def _titles(content: Content) -> list[str]:
    """Return the title of each flight."""
    return [track.name for track in content.tracks if track.what != "plan"]


def _flight(row: Mapping[str, Any], title: str, shared: Sequence[str]) -> dict[str, Any]:
    """Return a flight's row of the table, without the notes that all flights share."""
    source = {True: "simulated", False: "flown", None: "flight"}[row["simulated"]]
    tracking = row["tracking_s"]
    return {
        "title": title,
        "name": _name(row),
        "id": row["id"],
        "source": source if row["kind"] == "flight" else row["kind"],
        "vehicle": row["vehicle"],
        "route": row["route"],
        "duration": _number(row["duration_s"], ".2f"),
        "tracking": "–" if tracking is None else f"{tracking[1] - tracking[0]:.2f}",
        "rmse": _number(row["error_rmse_m"], ".1f", 1e3),
        "mean": _number(row["error_mean_m"], ".1f", 1e3),
        "max": _number(row["error_max_m"], ".1f", 1e3),
        "notes": [note for note in row["notes"] if note not in shared],
    }


def _plan(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a plan's row of the table."""
    margins = ", ".join(f"{name} {value:.3g}" for name, value in (row["margins"] or {}).items())
    return {
        "name": Path(row["reference"]).name,
        "id": row["id"],
        "vehicle": row["vehicle"],
        "route": row["route"],
        "duration": _number(row["duration_s"], ".2f"),
        "length": _number(row["path_length_m"], ".1f"),
        "speed": _number(row["speed_max_m_s"], ".2f"),
        "margins": margins or "–",
        "notes": row["notes"],
    }


def _model(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the page says of a model."""
    probabilities, effects = row["probabilities"], {each["effect"] for each in row["parameters"]}
    support = f"From {row['logs']} logs."
    if row["error_before_m"] is not None and row["error_after_m"] is not None:
        support += (
            f" Prediction error on {row['held_out_flights']} held-out flights: "
            f"{1e3 * row['error_before_m']:.1f} mm before, {1e3 * row['error_after_m']:.1f} mm after."
        )
    return {
        "name": _name(row),
        "id": row["id"],
        "verdict": VERDICTS[row["verdict"]],
        "support": support,
        "notes": row["notes"],
        "rows": [
            {
                "effect": each["effect"],
                "named": each["named"],
                "key": each["key"],
                "value": format(each["value"], ".4g"),
                "interval": "–" if each["low"] is None else f"{each['low']:.4g} to {each['high']:.4g}",
                "unit": "" if each["unit"] in (None, "1") else each["unit"],
                "bar": _bar(each),
                "probability": _number(probabilities.get(each["effect"]), ".3f"),
            }
            for each in row["parameters"]
        ],
        "excluded": ", ".join(
            f"{name} (probability {value:.3f})"
            for name, value in sorted(probabilities.items())
            if name not in effects
        ),
    }


def _bar(row: Mapping[str, Any]) -> dict[str, str] | None:
    """Return the places of neutral value, interval and value in a bar, px; None without an interval."""
    if row["low"] is None or row["neutral"] is None:
        return None
    ends = (row["neutral"], row["low"], row["high"])
    low, span = min(ends), max(ends) - min(ends)
    if span <= 0.0:
        return None
    return {
        key: f"{_BAR_EDGE + (_BAR_WIDTH - 2.0 * _BAR_EDGE) * (row[key] - low) / span:.1f}"
        for key in ("neutral", "low", "high", "value")
    }


def _scene_words(content: Content) -> str:
    """Return the caption of the path in 3D."""
    words = ["Drag to turn, scroll or pinch to zoom."]
    if any(track.what != "plan" for track in content.tracks):
        words.append("Dashed: reference. Arrow: from the reference to the vehicle, in the tracking phase.")
    words.append("The green line is the vehicle's forward axis; the vehicle may be drawn larger than it is.")
    scene = content.scene
    counts = [
        f"{len(scene[key])} {name}{'' if len(scene[key]) == 1 else 's'}"
        for key, name in (("waypoints", "waypoint"), ("gates", "gate"), ("keep_out", "keep-out shape"))
        if scene[key]
    ]
    if len({tuple(point["references"]) for point in scene["waypoints"]}) > 1:
        words.append("Waypoints, gates and keep-out shapes are those of the flights that are shown.")
    elif counts:
        words.append(f"Shown: {', '.join(counts)}.")
    else:
        words.append("The route is not known: no waypoints, gates or keep-out shapes.")
    return " ".join(words)
