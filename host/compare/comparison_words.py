"""A comparison as lines of text."""

from __future__ import annotations

from trimtab.host.compare.comparison import Comparison
from trimtab.host.compare.logs import FigureComparison, LogsComparison, Over
from trimtab.host.compare.models import FAR_SDS, ComparedModel, ModelsComparison, ParameterDifference
from trimtab.host.compare.plans import FIGURES as PLAN_FIGURES
from trimtab.host.compare.plans import PlansComparison
from trimtab.host.log import settings_lines
from trimtab.host.show.models import SDS

_LOG_WORDS = {
    "error_mean_m": ("tracking error, mean", 1e3, "mm", 1),
    "error_rmse_m": ("tracking error, RMSE", 1e3, "mm", 1),
    "error_max_m": ("tracking error, greatest", 1e3, "mm", 1),
    "feedforward_faded_s": ("feed-forward faded", 1.0, "s", 2),
}
"""Name, factor, unit and decimals of the figures of flights."""
_PLAN_WORDS = {
    "duration_s": ("duration", 1.0, "s", 2),
    "path_length_m": ("path length", 1.0, "m", 2),
    "speed_max_m_s": ("greatest speed", 1.0, "m/s", 2),
    "tilt_max_deg": ("greatest tilt", 1.0, "deg", 1),
    "thrust_share_max": ("greatest thrust of a rotor", 100.0, "%", 1),
    "clearance_m": ("least clearance", 1.0, "m", 3),
    "predicted_error_max_m": ("predicted error, greatest", 1e3, "mm", 1),
}
_NETWORKS = {
    "same": "network: the same weights",
    "different": "network: different weights",
    "only-a": "network: only in A",
    "only-b": "network: only in B",
}


def lines(result: Comparison) -> list[str]:
    """Return the lines of text for the terminal."""
    out = [f"A: {result.a}", f"B: {result.b}"]
    if result.logs is not None:
        out += _logs(result.logs)
    for models in result.models:
        out += _models(models)
    for plans in result.plans:
        out += _plans(plans)
    return out + [f"no counterpart: {name}" for name in result.unpaired]


def notes(result: Comparison) -> list[str]:
    """Return what a reader must know of the comparison, as sentences for stderr."""
    return [*result.notes, *(() if result.logs is None else result.logs.notes)]


def _logs(logs: LogsComparison) -> list[str]:
    out = []
    for pair in logs.pairs:
        a, b = pair.figures["error_rmse_m"]
        flights = f"{len(pair.a_logs)} and {len(pair.b_logs)} flights"
        change = f"{1e3 * a:.1f} and {1e3 * b:.1f} mm"
        out.append(f"  reference {pair.reference}, {flights}: tracking error {change} RMSE")
    if not logs.pairs:
        means = ": the means below are over all flights, and not paired" if logs.figures else ""
        out.append(f"no reference in common, so no difference{means}")
    out += [_figure(figure, logs.over) for figure in logs.figures]
    for side, names in (("A", logs.a_only), ("B", logs.b_only)):
        if names:
            out.append(f"only in {side}: {', '.join(names)}")
    return out + settings_lines(logs.settings, ("in A", "in B"))


def _figure(figure: FigureComparison, over: Over | None) -> str:
    name, factor, unit, digits = _LOG_WORDS[figure.figure]
    text = f"{name}: {factor * figure.a:.{digits}f} and {factor * figure.b:.{digits}f} {unit}"
    difference = figure.difference
    if difference is None or difference.mean is None:
        return text
    text += f", difference {factor * difference.mean:+.{digits}f} {unit}"
    if difference.low is None or difference.high is None:
        return f"{text}; too few to say: fly two references, or one twice for each side"
    interval = f"{factor * difference.low:+.{digits}f} to {factor * difference.high:+.{digits}f} {unit}"
    zero = "" if difference.excludes_zero else ", which includes 0"
    return f"{text}, 95 % interval {interval} ({difference.count} {over}){zero}"


def _models(models: ModelsComparison) -> list[str]:
    out = [f"models of {models.vehicle}: {models.a.file} and {models.b.file}"]
    out.append(f"  verdict: {_support(models.a)} and {_support(models.b)}")
    judged = any(each.sds is not None for each in models.parameters)
    if judged:
        out.append(
            "  +- is two standard deviations (sd); the last number is the difference over the combined sd"
        )
    shown = [each for each in models.parameters if each.a_named or each.b_named or each.far]
    out += [f"  {_parameter(each)}" for each in shown]
    if len(shown) < len(models.parameters):
        others = len(models.parameters) - len(shown)
        out.append(f"  {others} further adjustments: not more than {FAR_SDS:g} sd apart, or without an sd")
    for side, names in (("A", models.a_only), ("B", models.b_only)):
        out += [f"  named only in {side}: {name}" for name in names]
    if models.networks in _NETWORKS:
        out.append(f"  {_NETWORKS[models.networks]}")
    if judged and models.shared_logs:
        out.append(
            f"  {models.shared_logs} common logs are behind both: the values are not independent, and the "
            "combined sd is too large"
        )
    return out


def _support(model: ComparedModel) -> str:
    """Return a model's verdict and held-out errors as text."""
    if model.error_before_m is None or model.error_after_m is None:
        return model.verdict or "not stated"
    errors = f"{1e3 * model.error_before_m:.1f} to {1e3 * model.error_after_m:.1f} mm"
    return f"{model.verdict} (held out {errors})"


def _parameter(parameter: ParameterDifference) -> str:
    unit = "" if parameter.unit in (None, "1") else f" {parameter.unit}"
    values = [
        f"{value:.4g}" + ("" if sd is None else f" +- {SDS * sd:.2g}")
        for value, sd in ((parameter.a, parameter.a_sd), (parameter.b, parameter.b_sd))
    ]
    adjusted = "" if parameter.a_named or parameter.b_named else " (adjustment)"
    text = f"{parameter.effect}.{parameter.key}{adjusted}: {values[0]} and {values[1]}{unit}, "
    text += f"difference {parameter.difference:+.3g}"
    if parameter.sds is None:
        return f"{text}; a file states no uncertainty"
    return f"{text}, {parameter.sds:+.1f} sd"


def _plans(plans: PlansComparison) -> list[str]:
    out = [f"plans: {plans.a.file} and {plans.b.file}"]
    if plans.same:
        out.append("  the same reference")
    if plans.a.vehicle != plans.b.vehicle or plans.a.vehicle is None:
        out.append(f"  vehicle: {plans.a.vehicle or 'not known'} and {plans.b.vehicle or 'not known'}")
    for figure in PLAN_FIGURES:
        a, b = getattr(plans.a, figure), getattr(plans.b, figure)
        if a is None and b is None:
            continue
        name, factor, unit, digits = _PLAN_WORDS[figure]
        values = ["unknown" if x is None else f"{factor * x:.{digits}f} {unit}" for x in (a, b)]
        difference = plans.differences[figure]
        change = "" if difference is None else f", difference {factor * difference:+.{digits}f} {unit}"
        out.append(f"  {name}: {values[0]} and {values[1]}{change}")
    return out
