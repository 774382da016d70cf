"""A prediction as lines of text, and as a card."""

from __future__ import annotations

from trimtab.host.base.card import card, table
from trimtab.host.compare.prediction import FlightPrediction, Prediction, Score
from trimtab.host.compare.statistics import Difference


def lines(result: Prediction, title: str) -> list[str]:
    """Return the lines of text for the terminal. title: name of the model."""
    ahead = "whole flights from their references"
    if result.horizon_s is not None:
        ahead = f"{result.horizon_s:g} s ahead from recorded inputs"
    compared = result.model_id is not None
    out = [f"{title}: position error of predictions, {ahead}"]
    out += [f"  {_flight(flight, compared)}" for flight in result.flights]
    out.append(f"RMSE of all flights: {_rmse(result.together, result.nominal_together, compared)}")
    medians = (result.median_m, result.nominal_median_m) if compared else (result.median_m,)
    out.append(f"median of the flights: {_of_nominal([_median(each) for each in medians])}")
    difference = result.difference
    if difference is not None:
        better = f"better than the nominal model on {result.better} of {len(result.flights)}"
        out += [_difference(difference), better]
    if result.diverged:
        count = f"{len(result.diverged)} of {len(result.flights)}"
        out.append(f"diverges on {count}, which count as infinite errors")
    drift = result.drift
    if drift is not None:
        slope_mm, low_mm, high_mm = (
            1e3 * value for value in (drift.slope_m_month, drift.low_m_month, drift.high_m_month)
        )
        interval = f"95 % interval {low_mm:+.1f} to {high_mm:+.1f} mm"
        flights = f"{drift.flights} flights over {drift.days:.0f} days"
        out.append(f"drift: {slope_mm:+.1f} mm a month, {interval} ({flights})")
    return out


def notes(result: Prediction) -> list[str]:
    """Return what a reader must know of the prediction, as sentences for stderr."""
    out = []
    used = sum(flight.used for flight in result.flights)
    if used:
        out.append(f"the model was made from {used} of these flights; their errors are no test of it")
    if result.inactive:
        out.append(f"{', '.join(result.inactive)}: cannot act in predictions of these logs")
    return out


def prediction_card(result: Prediction) -> str:
    """Return the HTML card of a prediction for notebooks."""
    difference = result.difference
    return card(
        f"Prediction of {len(result.flights)} flights",
        [
            ("vehicle", result.vehicle),
            ("model", result.model_id or "nominal"),
            ("error of all flights", _rmse(result.together, result.nominal_together, difference is not None)),
            ("model less nominal", None if difference is None else _difference(difference)),
        ],
        table(
            ("log", "model", "nominal", "made the model"),
            [(each.log, _score(each.model), _score(each.nominal), each.used) for each in result.flights],
        ),
    )


def _flight(flight: FlightPrediction, compared: bool) -> str:
    date = "" if flight.date is None else f"  {flight.date:%Y-%m-%d}"
    used = "  (the model was made from it)" if flight.used else ""
    return f"{flight.log}{date}  {_rmse(flight.model, flight.nominal, compared)}{used}"


def _rmse(model: Score, nominal: Score, compared: bool) -> str:
    """Return an error in mm, and that of the nominal model if another model is compared with it."""
    return _of_nominal([_score(each) for each in ((model, nominal) if compared else (model,))])


def _of_nominal(texts: list[str]) -> str:
    return ", nominal model ".join(texts)


def _score(score: Score) -> str:
    return "diverges" if score.diverged else f"{1e3 * score.position_rmse_m:.1f} mm"


def _median(median_m: float | None) -> str:
    return "diverges" if median_m is None else f"{1e3 * median_m:.1f} mm"


def _difference(difference: Difference) -> str:
    """Return the difference of the model from the nominal one."""
    if difference.mean is None:
        median = "infinite" if difference.median is None else f"{1e3 * difference.median:+.1f} mm"
        return f"difference: median {median}; no mean and no interval, because a roll-out diverges"
    text = f"difference: mean {1e3 * difference.mean:+.1f} mm"
    if difference.low is None or difference.high is None:
        return f"{text}; too few flights for an interval, give two or more"
    zero = "" if difference.excludes_zero else ", which includes 0"
    return f"{text}, 95 % interval {1e3 * difference.low:+.1f} to {1e3 * difference.high:+.1f} mm{zero}"
