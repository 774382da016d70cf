"""Fits of sets of effects to whole flights, predicted from their references by the closed-loop model phi.

In command-driven segments, noise of the gyro enters both the commands that drive the model and the
measurements that it is compared with. This biases motor lag, delay and inertia. Here the reference drives the
model through the control law, so timing, inertia, thrust over mass and aerodynamic parameters have no such
bias. The integrator state of the rate controller shows unmodelled torques.

A gust shows in position, attitude and rate at once. The residual of poses, body rate and rate integral is
therefore one coloured process over all channels. A vector autoregression, fitted to the residual, whitens it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.flight_fit.loop import ClosedLoop, Slopes
from trimtab.host.trace.flight_fit.whitening import (
    Regressors,
    Whitening,
    autoregression,
    regressors,
    span_of,
    usable_bins,
    whitened,
)
from trimtab.host.trace.parameters import ParameterSpace

LOOP_SETTLED = 0.3
"""A fit ends at a step smaller than this many standard deviations."""

_WHITENING_SETTLED = 0.03
"""Change of a step, in standard deviations, below which its whitening is not fitted again."""

_ITERATIONS = 24
"""Greatest number of iterations. Few fits need more than six: those in which the law is often at a limit."""

_STALLED_NATS = 0.1
"""A fit also ends if a step gains less and the slopes at its point are known."""

_REFIT_SETTLED = 0.1
"""Step, in standard deviations, below which `fit_with_whitening` ends."""

_LINE = (0.5, 0.25, 0.1)
"""Step lengths of the line search, as shares of the Gauss-Newton step, if the whole step gains too little."""

_ENOUGH = 0.5
"""Share of the promised decrease of the cost with which a whole step is taken."""


@dataclass(frozen=True, kw_only=True)
class FlightFit:
    """A set of effects fitted to whole flights in closed loop.

    Log evidences of two fits are comparable if both use the same recordings and the same order.

    Attributes
    ----------
    effects
        The fitted set.
    theta_scaled, covariance
        Estimate and its covariance, scaled.
    at
        Scaled parameters of the last linearisation.
    log_evidence
        In nats.
    whitening
        Whitening of the residual.
    grams
        Grams of the whitened [residual | slopes], linearised at `at`.
    error_m
        Root mean square of the position residual.
    """

    effects: tuple[str, ...]
    theta_scaled: Annotated[np.ndarray, "parameters"]
    at: Annotated[np.ndarray, "parameters"]
    covariance: Annotated[np.ndarray, "parameters parameters"]
    log_evidence: float
    whitening: Whitening
    grams: Annotated[np.ndarray, "flights columns columns"]
    error_m: float


def whitened_grams(
    white: Whitening, loop: ClosedLoop, base: Sequence[np.ndarray], slopes: Slopes
) -> Annotated[np.ndarray, "flights columns columns"]:
    """Return the Grams of the whitened [residual | slopes].

    base: residual (bins, 12) of each flight, measured minus predicted. slopes: derivatives of the prediction
    of each flight.
    """

    def gram(index: int) -> np.ndarray:
        known = loop.recordings[index].known
        columns = [whitened(white, part, known) for part in (base[index][None], slopes[index])]
        both = np.concatenate(columns, dtype=float)
        return both @ both.T

    return np.stack(loop.each(gram))


def fit_closed_loop(
    loop: ClosedLoop,
    effects: Sequence[str],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    order: int,
    *,
    hopeless: float = -np.inf,
) -> FlightFit:
    """Fit the set `effects` to whole flights by Gauss-Newton with a line search.

    Parameters
    ----------
    loop
        Closed-loop model with the recordings of the flights.
    effects
        Effects that are free within the slab; all others stay within the spike of the prior.
    theta_scaled
        Start of the fit.
    order
        Order of the autoregression, which is fitted again to the residual of every linear step.
    hopeless
        Log evidence below which the slopes of all effects are not computed again at the end.
    """
    space = loop.space
    precision = prior_of(space).precision(effects)
    theta_scaled = space.clipped(theta_scaled)
    base = [r[0] for r in loop.residuals(theta_scaled[:, None])]
    iteration, afresh = 0, False
    while True:
        slopes = loop.slopes(theta_scaled, effects, base, afresh=afresh)
        take_step = partial(_linear_step, loop, base, slopes, order, theta_scaled, precision)
        step, covariance, white, grams = take_step(np.zeros(len(theta_scaled)))
        for _ in range(2):
            before = step
            step, covariance, white, grams = take_step(before)
            if _deviations(step - before, covariance) < _WHITENING_SETTLED:
                break
        small = _deviations(step, covariance) < LOOP_SETTLED
        own = afresh or not effects  # whether the slopes are those of this point, not of one nearby
        known = own or loop.knows_slopes(theta_scaled)
        if small and not known:
            known = _log_evidence(loop, white, grams, theta_scaled, effects, order) < hopeless
        if small and known:
            end, missed_nats = space.clipped(theta_scaled + step), 0.0
            break
        cost = _Cost(loop=loop, white=white, precision=precision)
        end, residuals, gain_nats, missed_nats = _line_search(cost, theta_scaled, step, base, grams.sum(0))
        stalled = gain_nats < _STALLED_NATS
        iteration += 1
        if (stalled and own) or iteration == _ITERATIONS:
            break
        theta_scaled, base, afresh = end, residuals, small or stalled
    return FlightFit(
        effects=tuple(sorted(effects)),
        theta_scaled=end,
        at=theta_scaled,
        covariance=covariance,
        log_evidence=_log_evidence(loop, white, grams, theta_scaled, effects, order) - missed_nats,
        whitening=white,
        grams=grams,
        error_m=_position_rms(loop, base),
    )


def _log_evidence(
    loop: ClosedLoop,
    white: Whitening,
    grams: np.ndarray,
    theta_scaled: np.ndarray,
    effects: Sequence[str],
    order: int,
) -> float:
    """Return the log evidence of the set `effects` in the linearisation at theta_scaled."""
    count = sum(len(usable_bins(k, span_of(order))) for k in loop.known)
    log_det = count * float(np.linalg.slogdet(white.innovation)[1]) / white.temper
    prior, limits = prior_of(loop.space), loop.space.bounds
    return evidence.log_evidences(grams.sum(0), log_det, theta_scaled, prior, [effects], limits)[0]


def _deviations(step: np.ndarray, covariance: np.ndarray) -> float:
    """Return the greatest component of a step in standard deviations."""
    return float((np.abs(step) / np.sqrt(np.diag(covariance))).max())


def _linear_step(
    loop: ClosedLoop,
    base: Sequence[np.ndarray],
    slopes: Slopes,
    order: int,
    theta_scaled: np.ndarray,
    precision: np.ndarray,
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, Whitening, np.ndarray]:
    """Return step, covariance, whitening and Grams; the whitening is fitted to the residual after `step`."""
    moved = step.any()

    def regressors_of(index: int) -> Regressors:
        r = base[index] - np.tensordot(step, slopes[index], 1) if moved else base[index]
        return regressors(r, loop.recordings[index].known, order)

    white = autoregression(loop.each(regressors_of))
    grams = whitened_grams(white, loop, base, slopes) / white.temper + _of_rotors(loop, theta_scaled)
    step, covariance = evidence.bounded_step(grams.sum(0), theta_scaled, precision, loop.space.bounds)
    return step, covariance, white, grams


def _of_rotors(loop: ClosedLoop, theta_scaled: np.ndarray) -> np.ndarray | float:
    """Return the Grams of the rotor speeds of each flight, or 0 without any."""
    return 0.0 if loop.speeds is None else loop.speeds.grams(theta_scaled)


def _position_rms(loop: ClosedLoop, residuals: Sequence[np.ndarray]) -> float:
    """Return the root mean square in m of the position part of residuals (bins, 12) of each flight."""
    squares = [np.square(r[mask, :3]).sum(1) for r, mask in zip(residuals, loop.known, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def prior_of(space: ParameterSpace) -> Prior:
    """Return the prior of flight fits: its spike combines tolerance and loop discrepancy."""
    tolerance = np.array([column.tolerance / column.scale for column in space.columns])
    return replace(space.prior, spike=np.hypot(tolerance, loop_discrepancy(space)))


def loop_discrepancy(space: ParameterSpace) -> Annotated[np.ndarray, "parameters"]:
    """Return the loop discrepancy of every parameter.

    It is the standard deviation, scaled, of the value that flight fits show although the effect is absent.
    """
    return np.array([column.loop_discrepancy for column in space.columns])


@dataclass(frozen=True, kw_only=True)
class _Cost:
    """Cost of scaled parameters: twice the negative log posterior in nats, up to a constant.

    precision, centre: of the prior. flight_weight: weight of each flight.
    """

    loop: ClosedLoop
    white: Whitening
    precision: Annotated[np.ndarray, "parameters"]
    centre: Annotated[np.ndarray, "parameters"] | float = 0.0
    flight_weight: float = 1.0

    def at(
        self, points: Annotated[np.ndarray, "parameters points"], whole: Sequence[np.ndarray]
    ) -> Annotated[np.ndarray, "points"]:
        """Return the cost of each point. whole: residuals (points, bins, 12) of each flight."""
        loop = self.loop
        squares = loop.each(lambda i: (whitened(self.white, whole[i], loop.known[i]) ** 2).sum(1))
        from_centre = (points.T - self.centre).T
        cost = (self.precision[:, None] * from_centre**2).sum(0)
        cost = cost + self.flight_weight * np.sum(squares, axis=0) / self.white.temper
        return cost if loop.speeds is None else cost + self.flight_weight * loop.speeds.squares(points)

    def decrease_nats(self, theta_scaled: np.ndarray, step: np.ndarray, gram: np.ndarray) -> float:
        """Return what the linearisation at theta_scaled promises that `step` gains, in nats."""
        downhill = gram[0, 1:] - self.precision * (theta_scaled - self.centre)
        return float(downhill @ step - 0.5 * (step @ gram[1:, 1:] @ step + self.precision @ step**2))


def _line_search(
    cost: _Cost,
    theta_scaled: np.ndarray,
    step: np.ndarray,
    base: Sequence[np.ndarray],
    gram: np.ndarray,
) -> tuple[np.ndarray, list[np.ndarray], float, float]:
    """Return the best point along `step` by full roll-outs, the residuals there, and two gains in nats.

    They are the gain of that point, and by how much the linearisation promises more for the whole step.

    The first candidate is the whole step. If it gains less than _ENOUGH of what the linearisation promises,
    the candidates are theta_scaled itself, and theta_scaled plus the shares _LINE of `step`. base:
    residual (bins, 12) of each flight at theta_scaled. gram: of the whitened [residual | slopes], with the
    weight of the flights.
    """
    loop = cost.loop

    def along(shares: Sequence[float]) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Return the points at these shares of the step, the residuals there, and the costs."""
        points = np.column_stack([loop.space.clipped(theta_scaled + share * step) for share in shares])
        residuals = loop.residuals(points)
        return points, residuals, cost.at(points, residuals)

    promised_nats = cost.decrease_nats(theta_scaled, step, gram)
    points, residuals, costs = along((1.0,))
    start = cost.at(theta_scaled[:, None], [r[None] for r in base])[0]
    if not start - costs[0] > _ENOUGH * 2.0 * promised_nats:
        more, more_residuals, more_costs = along(_LINE)
        points, costs = np.column_stack([points, more]), np.concatenate([costs, more_costs])
        residuals = [np.concatenate(pair) for pair in zip(residuals, more_residuals, strict=True)]
    best = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
    if not costs[best] < start:
        return theta_scaled, list(base), 0.0, promised_nats
    gain_nats = 0.5 * float(start - costs[best])
    return points[:, best], [r[best].copy() for r in residuals], gain_nats, promised_nats - gain_nats


def fit_with_whitening(
    loop: ClosedLoop,
    white: Whitening,
    effects: Sequence[str],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    *,
    centre: Annotated[np.ndarray, "parameters"] | float = 0.0,
    flight_weight: float = 1.0,
) -> tuple[
    Annotated[np.ndarray, "parameters"],
    Annotated[np.ndarray, "parameters parameters"],
    Annotated[np.ndarray, "flights columns columns"],
    Annotated[np.ndarray, "parameters"],
]:
    """Fit `effects` with a given whitening; return the estimate, its covariance, the Grams and their point.

    The fit is by Gauss-Newton with a line search: only the last step, below _REFIT_SETTLED, is taken without
    a look at its cost. All are scaled. The Grams of the whitened [residual | slopes] are divided by
    `white.temper`, since the innovations stay correlated over about a second (see `whitening`).

    Parameters
    ----------
    loop
        Closed-loop model with the recordings of the flights.
    white
        Whitening of the residuals.
    effects
        Effects that are free within the slab; all others stay within the spike of the prior.
    theta_scaled
        Start of the fit, scaled.
    centre
        Mean of the prior, scaled.
    flight_weight
        Weight of each flight.
    """
    precision = prior_of(loop.space).precision(effects)
    cost = _Cost(loop=loop, white=white, precision=precision, centre=centre, flight_weight=flight_weight)
    limits = (loop.space.bounds[0] - centre, loop.space.bounds[1] - centre)
    theta_scaled = loop.space.clipped(theta_scaled)
    base = [r[0] for r in loop.residuals(theta_scaled[:, None])]
    iteration, afresh = 0, not loop.knows_slopes(theta_scaled)
    while True:
        slopes = loop.slopes(theta_scaled, effects, base, afresh=afresh)
        grams = whitened_grams(white, loop, base, slopes) / white.temper + _of_rotors(loop, theta_scaled)
        grams = flight_weight * grams
        step, covariance = evidence.bounded_step(grams.sum(0), theta_scaled - centre, precision, limits)
        if _deviations(step, covariance) < _REFIT_SETTLED:
            return loop.space.clipped(theta_scaled + step), covariance, grams, theta_scaled
        end, residuals, gain_nats, _ = _line_search(cost, theta_scaled, step, base, grams.sum(0))
        stalled = gain_nats < _STALLED_NATS
        iteration += 1
        if (stalled and afresh) or iteration == _ITERATIONS:
            return end, covariance, grams, theta_scaled
        theta_scaled, base, afresh = end, residuals, iteration == 1 or stalled
