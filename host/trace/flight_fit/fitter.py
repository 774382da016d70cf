"""Fitter of the search for sets of effects: whole flights in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.flight_fit.fit import FlightFit, fit_closed_loop, prior_of
from trimtab.host.trace.flight_fit.loop import ClosedLoop
from trimtab.host.trace.flight_fit.whitening import whitened
from trimtab.host.trace.parameters import ParameterSpace, RollOutDiverged
from trimtab.host.trace.search import Names, Score


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightFitter:
    """Fitter of sets of effects to whole flights in closed loop, with one order of the autoregression."""

    loop: ClosedLoop
    order: int
    _starts: dict[tuple[str, Names, bytes], tuple[float, np.ndarray]] = field(
        default_factory=dict, init=False
    )

    @property
    def space(self) -> ParameterSpace:
        """Parameter space of the fits."""
        return self.loop.space

    @property
    def prior(self) -> Prior:
        """Prior of the parameters."""
        return prior_of(self.loop.space)

    def fit(self, effects: Sequence[str], start: FlightFit) -> FlightFit:
        """Return the set `effects` fitted from `start`, with log evidence -inf if its model diverges."""
        theta_scaled = start.theta_scaled.copy()
        for name in set(start.effects) - set(effects):
            columns = [*self.space.groups[name], *self.space.forms[name]]
            spike = self.prior.spike[columns]
            theta_scaled[columns] = np.clip(theta_scaled[columns], -spike, spike)
        for name in set(effects) - set(start.effects):
            if self.space.effect(name).starts:
                gain, theta_start = self._start_gain(name, start)
                columns = list(self.space.groups[name])
                if gain > RULES.worth_fitting_nats:
                    theta_scaled[columns] = theta_start[columns]
        hopeless = start.log_evidence - RULES.hopeless_nats
        try:
            fit = fit_closed_loop(self.loop, effects, theta_scaled, self.order, hopeless=hopeless)
        except RollOutDiverged:
            return replace(start, effects=tuple(sorted(effects)), log_evidence=-np.inf)
        # The autoregression predicts a large smooth error well: log evidence alone would not reject it.
        worse = not fit.error_m < RULES.worse_fit_ratio * start.error_m or not np.isfinite(fit.log_evidence)
        return replace(fit, log_evidence=-np.inf) if worse else fit

    def scorer(self, fit: FlightFit) -> Score:
        """Return a function that gives the log evidence of sets in the linearisation of `fit`.

        It keeps the whitening of `fit`. For sets with more effects the value is only a hint, since the
        whitening has absorbed a part of what the additional effects explain.
        """
        gram, prior, limits = fit.grams.sum(0), self.prior, self.space.bounds
        return lambda sets: evidence.log_evidences(gram, 0.0, fit.at, prior, sets, limits, fit.effects)

    def screening_scorers(self, fit: FlightFit) -> list[Score]:
        """Return `scorer` alone."""
        return [self.scorer(fit)]

    def underrated_extensions(self, fit: FlightFit) -> list[Names]:
        """Return sets with one more effect that gains much from one of the start values in its effect file.

        The linearisation of `fit` underrates such an effect, since its slope at neutral shows little.
        """
        absent = sorted(set(self.space.candidates) - set(fit.effects))
        with_starts = [name for name in absent if self.space.effect(name).starts]
        promising = [
            name for name in with_starts if self._start_gain(name, fit)[0] > RULES.worth_fitting_nats
        ]
        return [tuple(sorted((*fit.effects, name))) for name in promising]

    def _start_gain(self, name: str, fit: FlightFit) -> tuple[float, np.ndarray]:
        """Return `_best_start(name, fit)`, computed once for each effect and fit."""
        key = (name, fit.effects, fit.theta_scaled.tobytes())
        if key not in self._starts:
            self._starts[key] = self._best_start(name, fit)
        return self._starts[key]

    def _best_start(self, name: str, fit: FlightFit) -> tuple[float, np.ndarray]:
        """Return the gain in nats of the effect at the best of its starts, and theta_scaled there.

        Treat the change of the prediction from `fit` to the start as one regressor with a non-negative
        coefficient. The gain is that of its best coefficient, with all other parameters free under the prior
        of `fit`. Measured rotor speeds do not count.
        """
        space, columns = self.space, list(self.space.groups[name])
        points = space.at_starts(name, fit.theta_scaled).T
        base = [r[0] for r in self.loop.residuals(fit.theta_scaled[:, None])]
        slopes = self.loop.slopes(fit.theta_scaled, fit.effects, base)

        def gram_of(index: int, r: np.ndarray) -> np.ndarray:
            columns = np.concatenate([base[index][None], slopes[index], base[index] - r])
            white = whitened(fit.whitening, columns, self.loop.recordings[index].known)
            return white @ white.T / fit.whitening.temper

        gram = np.sum(self.loop.with_residuals(points, gram_of), axis=0)
        others = [i for i in range(len(fit.theta_scaled)) if i not in columns]
        precision = self.prior.precision(fit.effects)[others]
        rhs = gram[0, 1:][others] - precision * fit.theta_scaled[others]
        normal = gram[1:, 1:][np.ix_(others, others)] + np.diag(precision)
        gains = []
        for start in range(1 + len(fit.theta_scaled), len(gram)):
            cross = gram[start, 1:][others]
            projection = np.linalg.solve(normal, cross)
            curvature = gram[start, start] - cross @ projection
            slope = gram[0, start] - rhs @ projection
            valid = np.isfinite(curvature) and curvature > 0.0
            gains.append(0.5 * max(slope, 0.0) ** 2 / curvature if valid else 0.0)
        best = int(np.argmax(gains))
        return gains[best], points[:, best]
