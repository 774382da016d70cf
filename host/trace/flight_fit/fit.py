"""Refinement over the closed loop: whole flights rolled out from their references by phi.

Command-driven segments see the gyro's noise in what drives them and in what they are compared with, which
biases lag, delay and inertia. Here nothing measured drives the model: the reference does, through the law,
and timing, inertia, thrust over mass and aerodynamic terms come out without that bias; what torque something
takes the law's rate integral shows. Poses, body rate and integral, in bins, less their prediction are one
coloured process in all channels at once, since a gust shows in position, attitude and rate: a vector
autoregression, fitted to what is left, whitens it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.flight_fit.loop import Loop
from trimtab.host.trace.flight_fit.whitening import (
    Whitening,
    autoregression,
    span_of,
    stretches,
    whitened,
)
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.search import Names

LOOP_SETTLED = 0.3
"""Greatest step, in standard deviations, that is taken without looking at the roll-outs again."""

_ITERATIONS = 6
_PASSES, _SETTLED_WELL = 6, 0.1
_LINE = (1.0, 0.5, 0.25, 0.1)


@dataclass(frozen=True, kw_only=True)
class FlightFit:
    """A set of effects fitted over the closed loop, comparable with others of the same recordings and order.

    theta_scaled (P,) and its covariance (P, P); grams (flights, 1 + P, 1 + P) of the whitened
    [residual | slopes] by flight, linearised at `at` (P,).
    """

    effects: tuple[str, ...]
    theta_scaled: np.ndarray
    at: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    whitening: Whitening
    grams: np.ndarray
    error_m: float


def whitened_grams(
    white: Whitening, loop: Loop, base: Sequence[np.ndarray], slopes: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the Grams (flights, 1 + P, 1 + P) of the whitened [residual | slopes]."""
    grams = []
    for recording, r, s in zip(loop.recordings, base, slopes, strict=True):
        columns = whitened(white, np.concatenate([r[None], s]), recording.known)
        grams.append(columns @ columns.T)
    return np.stack(grams)


def fit_loop(loop: Loop, effects: Sequence[str], theta_scaled: np.ndarray, order: int) -> FlightFit:
    """Fit the set `effects` over the closed loop from theta_scaled (P,), by Gauss-Newton with line search.

    The whitening is fitted again to the residual of every linear step.
    """
    space = loop.space
    precision = prior_of(space).precision(effects)
    theta_scaled = space.clipped(theta_scaled)
    base = [r[0] for r in loop.residuals(theta_scaled[:, None])]
    iteration = 0
    while True:
        slopes = loop.slopes(theta_scaled, effects, base)
        take_step = partial(_linear_step, loop, base, slopes, order, theta_scaled, precision)
        step, covariance, white, grams = take_step(np.zeros(len(theta_scaled)))
        for _ in range(2):
            step, covariance, white, grams = take_step(step)
        small = (np.abs(step) / np.sqrt(np.diag(covariance))).max() < LOOP_SETTLED
        if small or iteration == _ITERATIONS - 1:
            break
        moved, residuals = _line_search(loop, white, precision, theta_scaled, step, base)
        if np.array_equal(moved, theta_scaled):
            break
        theta_scaled, base = moved, residuals
        iteration += 1
    count = sum(len(stretches(k, span_of(order))) for k in loop.known)
    log_det = count * float(np.linalg.slogdet(white.innovation)[1])
    return FlightFit(
        effects=tuple(sorted(effects)),
        theta_scaled=space.clipped(theta_scaled + step),
        at=theta_scaled,
        covariance=covariance,
        log_evidence=evidence.log_evidence(
            grams.sum(0), log_det, theta_scaled, precision, len(effects), space.bounds
        ),
        whitening=white,
        grams=grams,
        error_m=_position_rms(loop, base),
    )


def _linear_step(
    loop: Loop,
    base: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
    order: int,
    theta_scaled: np.ndarray,
    precision: np.ndarray,
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, Whitening, np.ndarray]:
    """Return step, covariance, whitening and Grams; the whitening is fitted to the residual of `step`."""
    left = [r - np.tensordot(step, s, 1) for r, s in zip(base, slopes, strict=True)]
    white = autoregression(left, loop.known, order)
    grams = whitened_grams(white, loop, base, slopes)
    step, covariance = evidence.bounded(grams.sum(0), theta_scaled, precision, loop.space.bounds)
    return step, covariance, white, grams


def _position_rms(loop: Loop, residuals: Sequence[np.ndarray]) -> float:
    """Root mean square of the position's residuals (bins, 12) by flight."""
    known = [np.square(r[whole, :3]).sum(1) for r, whole in zip(residuals, loop.known, strict=True)]
    return float(np.sqrt(np.concatenate(known).mean()))


def prior_of(space: ParameterSpace) -> Prior:
    """Return the prior over the closed loop: what is left out moves within tolerance and loop discrepancy."""
    tolerance = np.array([column.tolerance / column.scale for column in space.columns])
    return replace(space.prior, spike=np.hypot(tolerance, loop_discrepancy(space)))


def loop_discrepancy(space: ParameterSpace) -> np.ndarray:
    """One sigma (P,), in scales, of what phi itself may be off by in every column."""
    return np.array([column.loop_discrepancy for column in space.columns])


def _line_search(
    loop: Loop,
    white: Whitening,
    precision: np.ndarray,
    theta_scaled: np.ndarray,
    step: np.ndarray,
    base: Sequence[np.ndarray],
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the best of z and a few points along the step, by the cost of real roll-outs; z if none is
    better.

    With it, as `base` for z, per flight the residual (bins, 12) there.
    """
    points = np.column_stack([loop.space.clipped(theta_scaled + share * step) for share in _LINE])
    rolled = [np.concatenate([r[None], along]) for r, along in zip(base, loop.residuals(points), strict=True)]
    points = np.column_stack([theta_scaled, points])
    cost = (precision[:, None] * points**2).sum(0)
    for recording, r in zip(loop.recordings, rolled, strict=True):
        cost += (whitened(white, r, recording.known) ** 2).sum(1)
    best = int(np.argmin(np.where(np.isfinite(cost), cost, np.inf)))
    return points[:, best], [r[best] for r in rolled]


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightFitter:
    """Fits sets of effects to whole flights over the closed loop, whitened to one order."""

    loop: Loop
    order: int
    _found: dict[tuple[str, Names, bytes], tuple[float, np.ndarray]] = field(default_factory=dict, init=False)

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        return self.loop.space

    @property
    def prior(self) -> Prior:
        """Their prior."""
        return prior_of(self.loop.space)

    def fit(self, effects: Sequence[str], start: FlightFit) -> FlightFit:
        """Return the set `effects` fitted from `start`."""
        theta_scaled = start.theta_scaled.copy()
        for name in set(start.effects) - set(effects):
            theta_scaled[list(self.space.groups[name])] = 0.0
        for name in set(effects) - set(start.effects):
            if self.space.effect(name).starts:
                gain, begun = self._begun(name, start)
                own = list(self.space.groups[name])
                theta_scaled[own] = begun[own] if gain > RULES.worth_fitting_nats else theta_scaled[own]
        fit = fit_loop(self.loop, effects, theta_scaled, self.order)
        # What is smooth and large an autoregression foretells: that alone would not speak against it.
        worse = not fit.error_m < RULES.worse_fit_ratio * start.error_m or not np.isfinite(fit.log_evidence)
        return replace(fit, log_evidence=-np.inf) if worse else fit

    def scorers(self, fit: FlightFit) -> list[Callable[[Names], float]]:
        """Log evidence of any set in the fit's linearisation and whitening.

        A hint for sets with more effects, since the whitening has taken up a part of what they explain.
        """
        gram, prior, limits = fit.grams.sum(0), self.prior, self.space.bounds
        return [
            lambda names: evidence.log_evidence(gram, 0.0, fit.at, prior.precision(names), len(names), limits)
        ]

    def beyond(self, fit: FlightFit) -> list[Names]:
        """Return sets with one effect more that explains much from one of its `starts`, if little as a
        slope.
        """
        absent = set(self.space.candidates) - set(fit.effects)
        found = [name for name in sorted(absent) if self.space.effect(name).starts]
        grown = [name for name in found if self._begun(name, fit)[0] > RULES.worth_fitting_nats]
        return [tuple(sorted((*fit.effects, name))) for name in grown]

    def _begun(self, name: str, fit: FlightFit) -> tuple[float, np.ndarray]:
        """Nats that the effect gains at the best of its starts, in whatever strength and with all else that
        may move moving along, and the scaled parameters (P,) there. Asked of a fit twice, found once.
        """
        asked = (name, fit.effects, fit.theta_scaled.tobytes())
        if asked not in self._found:
            self._found[asked] = self._best_start(name, fit)
        return self._found[asked]

    def _best_start(self, name: str, fit: FlightFit) -> tuple[float, np.ndarray]:
        space, own = self.space, list(self.space.groups[name])
        points = np.repeat(fit.theta_scaled[:, None], len(space.effect(name).starts), axis=1)
        for lane, values in enumerate(space.effect(name).starts):
            columns = [space.columns[i] for i in own]
            points[own, lane] = [(v - c.neutral) / c.scale for v, c in zip(values, columns, strict=True)]
        base = [r[0] for r in self.loop.residuals(fit.theta_scaled[:, None])]
        slopes = self.loop.slopes(fit.theta_scaled, fit.effects, base)
        gram = np.zeros((1 + len(fit.theta_scaled) + points.shape[1],) * 2)
        for recording, r, s, there in zip(
            self.loop.recordings, base, slopes, self.loop.residuals(points), strict=True
        ):
            columns = whitened(fit.whitening, np.concatenate([r[None], s, r - there]), recording.known)
            gram += columns @ columns.T
        rest = [i for i in range(len(fit.theta_scaled)) if i not in own]
        precision = self.prior.precision(fit.effects)[rest]
        rhs = gram[0, 1:][rest] - precision * fit.theta_scaled[rest]
        normal = gram[1:, 1:][np.ix_(rest, rest)] + np.diag(precision)
        gains = []
        for start in range(1 + len(fit.theta_scaled), len(gram)):
            cross = gram[start, 1:][rest]
            along = np.linalg.solve(normal, cross)
            left = gram[start, start] - cross @ along
            pull = gram[0, start] - rhs @ along
            gains.append(0.5 * max(pull, 0.0) ** 2 / left if np.isfinite(left) and left > 0.0 else 0.0)
        best = int(np.argmax(gains))
        return gains[best], points[:, best]


def weighted(
    loop: Loop,
    white: Whitening,
    effects: Sequence[str],
    theta_scaled: np.ndarray,
    *,
    centre: np.ndarray | float = 0.0,
    count: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit `effects` from theta_scaled with a given whitening.

    Returns scaled parameters (P,), covariance (P, P) and Grams (flights, 1 + P, 1 + P). Residuals count by
    1/RULES.temper. centre (P,): mean of the prior. count: weight of each flight.
    """
    precision = prior_of(loop.space).precision(effects)
    turn = 0
    while True:
        base = [r[0] for r in loop.residuals(theta_scaled[:, None])]
        grams = (
            count
            / RULES.temper
            * whitened_grams(white, loop, base, loop.slopes(theta_scaled, effects, base, afresh=turn < 2))
        )
        away = theta_scaled - centre
        limits = (loop.space.bounds[0] - centre, loop.space.bounds[1] - centre)
        step, covariance = evidence.bounded(grams.sum(0), away, precision, limits)
        theta_scaled = loop.space.clipped(theta_scaled + step)
        turn += 1
        settled = (np.abs(step) / np.sqrt(np.diag(covariance))).max() < _SETTLED_WELL
        if settled or turn == _PASSES:
            return theta_scaled, covariance, grams
