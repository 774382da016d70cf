"""Tables of a blind study: each figure with count, exact interval and target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trimtab.sitl.studies import text_tables
from trimtab.sitl.studies.scoring.metrics import OUTCOMES, is_right
from trimtab.sitl.studies.scoring.probabilities import SURE, data_of

Row = dict[str, Any]

_SHARES = (
    ("singles_exact_identifiable", "exact set, identifiable single effects", ">= 95 %"),
    ("singles_exact", "exact set, all single effects", ""),
    ("top1", "top-1 on identifiable single effects", ""),
    ("pairs_exact_identifiable", "exact set, identifiable pairs", ">= 90 %"),
    ("pairs_exact", "exact set, all pairs", ""),
    ("triples_exact_identifiable", "exact set, identifiable triples", ">= 70 %"),
    ("triples_exact", "exact set, all triples", ""),
    ("in_alias", "truth inside the alias set", ">= 99 %"),
    ("in_answer", "truth among names, aliases and what is possible beside them", ""),
    ("false_alarm", "false alarms where nothing is missing", "<= 1 %"),
    ("abstain_outside", "abstention outside the library, detectable", ">= 92 %"),
    ("abstain_undetectable", "abstention outside the library, not detectable", ""),
    ("abstain_inside", "abstention inside the library", "<= 2 %"),
    ("thin_wrong", "thin data: traced with a wrong effect", "0 %"),
    ("thin_told", "thin data: missing data reported", "100 %"),
)
_NUMBERS = (
    ("parameter_error_median", "parameter error, median", "<= 3 %", "parameter_error", "%"),
    ("parameter_error_p90", "parameter error, 90th percentile", "<= 10 %", "parameter_error", "%"),
    ("parameter_error_torque_p90", "the same of torques", "<= 15 %", "parameter_error_torque", "%"),
    (
        "after_over_floor_median",
        "held-out error after, over floor, median",
        "<= 1.05",
        "after_over_floor",
        "",
    ),
    ("after_over_floor_p90", "the same, 90th percentile", "<= 1.10", "after_over_floor", ""),
    ("after_mm_median", "held-out error after, median", "", "after_over_floor", "mm"),
    ("floor_mm_median", "its floor, median", "", "after_over_floor", "mm"),
    ("alias_size_mean", "size of the alias set, mean", "<= 1.5", "alias_size_mean", ""),
    ("alias_size_max", "size of the alias set, greatest", "<= 4", "alias_size_mean", ""),
    ("trace_s_median", "processor time of a trace, median", "<= 15 s", "trace_s", "s"),
)


def table(figures: Mapping[str, Any]) -> list[Row]:
    """Return rows of strings: figure, value, n, interval, target."""
    rows = []
    for key, label, target in _SHARES:
        rows.append(share_row(label, target, figures[key], figures["n"][key], figures["interval"][key]))
    for data, found in figures["probabilities"].items():
        label, target = f"given >= 95 % and there, {data}", ">= 95 %"
        rows.append(share_row(label, target, found["sure"], found["sure_n"], found["sure_interval"]))
    for data, found in figures["probabilities"].items():
        label, between = f"traced with a false name, {data}", found["false_names_interval"]
        rows.append(share_row(label, "<= 3 %", found["false_names"], found["worlds"], between))
    for data, found in figures["probabilities"].items():
        label, between = f"false name, of what is traced, {data}", found["false_names_of_traced_interval"]
        rows.append(share_row(label, "", found["false_names_of_traced"], found["traced"], between))
    for data, found in figures["probabilities"].items():
        rows.append(_row(f"Brier score, {data}", _text(found["brier"], ""), found["n"], "", ""))
    for name, found in figures["by_family"].items():
        label = f"2-sigma coverage, {name}"
        rows.append(share_row(label, "90-98 %", found["coverage_2sigma"], found["n"], found["interval"]))
    for name, found in figures["by_family"].items():
        width = _text(found["width_over_bound"], "")
        rows.append(_row(f"width over the bound, {name}", width, found["n"], "", "<= 1.4"))
    for key, label, target, counted, unit in _NUMBERS:
        rows.append(_row(label, _text(figures[key], unit), figures["n"][counted], "", target))
    rows.append(_row("worlds drawn again", str(figures["redrawn"]), figures["n"]["worlds"], "", ""))
    return rows


def truth_table(figures: Mapping[str, Any]) -> list[Row]:
    """Return rows of strings that compare estimates with effective and with drawn values.

    Keys: figure, n, effective, drawn, each with its exact interval if it is a share.
    """
    errors = [
        _truth_row(label, figures["n"][n], figures["n"][f"{n}_drawn"], figures[key], figures[f"{key}_drawn"])
        for key, label, _, n, _ in _NUMBERS
        if key.startswith("parameter_error")
    ]
    coverage = [
        _truth_row(
            f"2-sigma coverage, {name}",
            found["n"],
            found["n"],
            found["coverage_2sigma"],
            found["coverage_2sigma_drawn"],
            (found["interval"], found["interval_drawn"]),
        )
        for name, found in figures["by_family"].items()
    ]
    return [*errors, *coverage]


def _truth_row(
    figure: str,
    n: int,
    n_drawn: int,
    effective: float | None,
    drawn: float | None,
    intervals: tuple[Sequence[float] | None, Sequence[float] | None] = (None, None),
) -> Row:
    cells = [
        _text(value, "%") + ("" if between is None else f" ({_between(between)})")
        for value, between in zip((effective, drawn), intervals, strict=True)
    ]
    return {"figure": figure, "n": str(n), "effective": cells[0], "n, drawn": str(n_drawn), "drawn": cells[1]}


def kind_tables(figures: Mapping[str, Any]) -> dict[str, list[Row]]:
    """Return a table for kinds inside and one for kinds outside the library, by title."""
    inside = [
        {
            "kind": kind,
            "single, exact": f"{c['exact']} of {c['singles']}",
            "identifiable, exact": f"{c['exact_identifiable']} of {c['identifiable']}",
            "found in all worlds": f"{c['found']} of {c['all']}",
            "named though absent": str(c["false"]),
        }
        for kind, c in figures["by_kind"].items()
    ]
    outside = [
        {
            "kind": kind,
            "detectable, abstained": f"{c['abstained_detectable']} of {c['detectable']}",
            "not detectable, abstained": f"{c['abstained_rest']} of {c['worlds'] - c['detectable']}",
            "traced with a false name": f"{c['false']} of {c['worlds']}",
        }
        for kind, c in figures["by_outside_kind"].items()
    ]
    tables = {"Kinds inside the library": inside, "Kinds outside the library": outside}
    return {title: rows for title, rows in tables.items() if rows}


def thin_table(figures: Mapping[str, Any]) -> list[Row]:
    """Return rows for thin data: the case, its number of worlds, and the number of each outcome."""
    return [{"case": case, **counts} for case, counts in figures["thin"].items()]


def false_certainties(score: Mapping[str, Any]) -> list[str]:
    """Return a line for each absent effect that was given at least SURE, by kind of data."""
    answers = {**score["few"], data_of(score): score}
    return [
        f"{data}: {row['name']} given {row['probability']:.3f}, absent"
        for data, answer in answers.items()
        for row in answer["probabilities"]
        if row["probability"] >= SURE and not row["there"]
    ]


def baseline_table(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return rows of strings: method, top1, pairs, alarms, named, error."""
    return [
        {
            "method": row["method"],
            "top1": _of(row, "top1"),
            "pairs": _of(row, "pairs_exact"),
            "alarms": _of(row, "false_alarm"),
            "named": _text(row["named_mean"], ""),
            "error": _text(row["after_mm_median"], "mm"),
        }
        for row in rows
    ]


def real_table(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return rows of strings: name, used, held_out, verdict, said, before, after, seconds."""
    return [
        {
            "name": row["name"],
            "used": ", ".join(row["used"]),
            "held_out": ", ".join(row["held_out"]) or "-",
            "verdict": row["verdict"],
            "said": "; ".join([*map(_effect, row["effects"]), *row["doubts"]]) or row["errors"].strip(),
            "before": _millimetres(row["before_m"]),
            "after": _millimetres(row["after_m"]),
            "seconds": _text(row["trace_s"], "s"),
        }
        for row in rows
    ]


def _effect(effect: Mapping[str, Any]) -> str:
    """Return an effect with its values, two standard deviations, and its aliases."""
    values = ", ".join(
        f"{key} {p['value']:.3g} +- {2 * p['sd']:.2g}{'' if p['unit'] == '1' else ' ' + p['unit']}"
        for key, p in effect["parameters"].items()
    )
    others = ", ".join(alias["name"] for alias in effect["aliases"])
    return f"{effect['name']} {values}{f' (or {others})' if others else ''}"


def _millimetres(value_m: float | None) -> str:
    return "-" if value_m is None else f"{1e3 * value_m:.1f} mm"


def _of(row: Mapping[str, Any], key: str) -> str:
    n = row["n"][key]
    return f"{round(row[key] * n)} of {n}" if n else "-"


def lines(
    figures: Mapping[str, Any],
    scores: Sequence[Mapping[str, Any]],
    others: Sequence[Mapping[str, Any]] = (),
    real: Sequence[Mapping[str, Any]] = (),
) -> list[str]:
    """Return the table, thin data, wrong verdicts, other methods and recorded flights as lines of text."""
    rows = [{"figure": "", "value": "", "n": "n", "interval": "95 %", "target": "target"}, *table(figures)]
    widths = {key: max(len(str(row[key])) for row in rows) for key in rows[0]}
    out = ["  ".join(str(row[key]).ljust(width) for key, width in widths.items()).rstrip() for row in rows]
    out += text_tables.lines({"Truth in two columns": truth_table(figures), **kind_tables(figures)})
    for row in thin_table(figures):
        counts = ", ".join(f"{row[word]} {word}" for word in OUTCOMES if row[word])
        out.append(f"{row['case']}: {counts}; missing data reported in {row['told']} of {row['n']}")
    for score in scores:
        wrong = failure(score)
        if wrong:
            out.append(f"world {score['world']}: {wrong}")
        out += [f"world {score['world']}, {line}" for line in false_certainties(score)]
    out += [
        f"{row['method']}: first name correct {row['top1']}, pairs exact {row['pairs']}, false alarms "
        f"{row['alarms']}, {row['named']} effects named on average, held-out error {row['error']}"
        for row in baseline_table(others)
    ]
    out += [
        f"{row['name']}: {row['verdict']}, {row['said'] or 'nothing named'}; held out {row['held_out']}: "
        f"{row['before']} before, {row['after']} after"
        for row in real_table(real)
    ]
    return out


def failure(score: Mapping[str, Any]) -> str | None:
    """Return a line about a world's wrong verdict, or None if the verdict is correct."""
    kinds, named = " + ".join(score["kinds"]) or "nothing", ", ".join(score["named"]) or "nothing named"
    if is_right(score):
        return None
    weak = "" if score["identifiable"] in (None, True) else ", not identifiable"
    if score["detectable"] is False:
        weak = ", not detectable"
    reason = "; ".join(score["reasons"]) or score["errors"].strip()
    if score["case"] is not None:
        weak = f", {score['case']}{'' if score['told'] else ' not reported'}"
    return f"{kinds}{weak}: {score['verdict']}, {named}{f' ({reason})' if reason else ''}"


def share_row(label: str, target: str, share: float | None, n: int, interval: Sequence[float] | None) -> Row:
    """Return the row of a share with its count, exact interval and target, as strings."""
    between = "" if interval is None else _between(interval)
    return _row(label, _text(share, "%"), n, between, target)


def _between(interval: Sequence[float]) -> str:
    return f"{100 * interval[0]:.1f}-{100 * interval[1]:.1f} %"


def _row(label: str, value: str, n: int, interval: str, target: str) -> Row:
    return {"figure": label, "value": value, "n": n, "interval": interval, "target": target}


def _text(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    if unit == "%":
        return f"{100 * value:.1f} %"
    return f"{value:.3g}{' ' + unit if unit else ''}"
