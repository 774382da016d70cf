"""Quantities for the rules of tracing, measured from flights in a world without effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.trace import evidence
from trimtab.host.trace.data.logs import read_logs
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import fit_closed_loop, prior_of, whitened_grams
from trimtab.host.trace.flight_fit.loop import ClosedLoop, Slopes, closed_loop, order_of
from trimtab.host.trace.flight_fit.repeatability import repeatability_of, turbulence
from trimtab.host.trace.flight_fit.whitening import Whitening, whitened
from trimtab.host.trace.parameters import ParameterSpace, space
from trimtab.host.vehicle import Vehicle
from trimtab.sitl.studies.scoring.effective import deviations_scaled

RepeatPairs = Sequence[tuple[int, int]]


class Measured(NamedTuple):
    """Quantities of one world.

    Attributes
    ----------
    repeat_share
        Lower bound of the power that repeats between flights, over turbulence and noise.
    slope_power_1, slope_power_2, slope_power_3, slope_power_4
        Mean power of differences of repeat flights along the slopes, whitened by an autoregression of that
        order, or of the greatest one that the flights determine. 1 for white innovations.
    error_power
        Mean square error of the estimates over the reported variance, from chance and model error together.
        Only estimates that depend on the data more than on their prior count.
    """

    repeat_share: float
    slope_power_1: float
    slope_power_2: float
    slope_power_3: float
    slope_power_4: float
    error_power: float


def rules_in_force() -> dict[str, float]:
    """Return the measured rules, in the order of `Measured`."""
    return {
        "flight_repeat_chance": RULES.flight_repeat_chance,
        **{f"temper, order {order}": value for order, value in enumerate(RULES.temper, 1)},
        "min_widening": RULES.min_widening,
    }


def measure(paths: Sequence[Path], vehicle: Vehicle, deviations: Mapping[str, float]) -> Measured:
    """Return the quantities measured from the logs of one world, in which every reference is flown twice.

    `deviations` are those of the build, by "effect.parameter".
    """
    logs = read_logs([read_flight(path) for path in paths], [], vehicle)
    chosen = space(vehicle, load_effects())
    loop = closed_loop(logs.flights, vehicle, chosen, np.zeros(len(chosen.columns)))
    order = order_of(loop)
    theta_scaled = fit_closed_loop(loop, (), np.zeros(len(chosen.columns)), order).theta_scaled
    repeats = repeatability_of(loop, theta_scaled, order, logs.repeat_flights)
    orders = range(1, len(RULES.temper) + 1)
    found = (turbulence(loop, theta_scaled, each, logs.repeat_flights) for each in orders)
    whites = [white for white in found if white is not None]
    if repeats is None or not whites:
        raise ValueError("no reference was flown twice")
    residuals = [each[0] for each in loop.residuals(theta_scaled[:, None])]
    slopes = loop.slopes(theta_scaled, (), residuals, afresh=True)
    true = deviations_scaled(chosen, deviations)
    powers = [_slope_power(loop, white, residuals, slopes, logs.repeat_flights) for white in whites]
    white = whites[order - 1]
    grams = whitened_grams(white, loop, residuals, slopes) / white.temper
    return Measured(
        repeat_share=repeats.lower_share(RULES),
        slope_power_1=powers[0],
        slope_power_2=powers[1],
        slope_power_3=powers[2],
        slope_power_4=powers[3],
        error_power=_error_power(chosen, grams.sum(0), theta_scaled, true),
    )


def _slope_power(
    loop: ClosedLoop,
    white: Whitening,
    residuals: Sequence[np.ndarray],
    slopes: Slopes,
    repeat_pairs: RepeatPairs,
) -> float:
    """Return the mean of (S e)^2 / |S|^2, with e the difference of two repeat flights over sqrt(2)."""
    powers = []
    for a, b in repeat_pairs:
        bins = min(len(residuals[a]), len(residuals[b]))
        known = loop.known[a][:bins] & loop.known[b][:bins]
        difference = (residuals[a][:bins] - residuals[b][:bins]) / np.sqrt(2.0)
        columns = whitened(white, np.concatenate([difference[None], slopes[a][:, :bins]]), known)
        e, S = columns[0], columns[1:]
        squares = (S**2).sum(1)
        shown = squares > 0.0
        powers.append((S[shown] @ e) ** 2 / squares[shown])
    return float(np.concatenate(powers).mean())


def _error_power(
    chosen: ParameterSpace, gram: np.ndarray, theta_scaled: np.ndarray, true: np.ndarray
) -> float:
    """Return the mean square error of the estimates over the reported variance.

    Each candidate is selected alone. The estimate of what does not act in these flights, such as a payload's
    swing without a payload, stays at the mean of its prior and has no error. Estimates whose variance exceeds
    half that of their prior therefore do not count. `gram` (1 + P, 1 + P) is of all flights, linearised at
    theta_scaled (P,). `true` (P,) are the deviations of the build.
    """
    squares = []
    for candidate in chosen.candidates:
        precision = prior_of(chosen).precision((candidate,))
        mine = list(chosen.groups[candidate])
        step, covariance = evidence.posterior(gram, theta_scaled, precision)
        error, variance = (theta_scaled + step - true)[mine], np.diag(covariance)[mine]
        informed = variance * precision[mine] < 0.5
        squares.append(error[informed] ** 2 / variance[informed])
    return float(np.concatenate(squares).mean())
