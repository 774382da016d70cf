"""Sets of effects fitted to the difference between the balances of two sets of logs.

What the vehicle file lacks in both sets is free: one offset of each channel. An effect acts only in the logs
after the change. Nuisances of each log are its thrust scale, and a yaw torque of tilted rotor axes. Four
things are unknown and averaged over, as hypotheses: how much thrust scales scatter from log to log, how much
the balance does, and the thrust curve if the logs declare it unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Annotated

import numpy as np
from scipy.special import softmax

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.hover.balance import CHANNELS, Balance, predicted, slopes
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.residual.unexplained import FlightRepeat
from trimtab.host.trace.search import Names, Score
from trimtab.host.vehicle import Vehicle

_OFFSET = 1e3
"""Standard deviation of the offset that both sets share, in m/s^2 and rad/s^2: it is free."""
_ITERATIONS = 5


@dataclass(frozen=True, kw_only=True)
class CoupledPrior(Prior):
    """A prior in which an effect limits others that come with it (`Effect.comes_with`).

    limits: by candidate, standard deviations, scaled, of columns of other candidates if it is selected too.
    """

    limits: Mapping[str, Mapping[int, float]] = field(default_factory=dict)

    def precision(self, selected: Sequence[str]) -> Annotated[np.ndarray, "parameters"]:
        """Return the prior precision, scaled, if the effects `selected` are in the model."""
        precision = super().precision(selected)
        for name in set(selected) & set(self.limits):
            for column, sigma in self.limits[name].items():
                precision[column] = max(precision[column], 1.0 / max(sigma, self.spike[column]) ** 2)
        return precision


@dataclass(frozen=True, kw_only=True)
class HoverFit:
    """A set of effects fitted to the change of the balance.

    Attributes
    ----------
    effects
        The fitted set.
    theta_scaled, covariance
        Estimate and its covariance, scaled.
    at
        Scaled parameters of the last linearisation.
    log_evidence
        In nats, with the prior odds of the set.
    square
        Least square of whitened residual and prior, under the most probable hypothesis.
    gram
        Gram of the whitened [residual | slopes] of that hypothesis.
    grams, log_dets
        Grams of the whitened [residual | slopes], and log determinants of the covariances by which they were
        whitened, of each hypothesis.
    """

    effects: Names
    theta_scaled: Annotated[np.ndarray, "parameters"]
    covariance: Annotated[np.ndarray, "parameters parameters"]
    at: Annotated[np.ndarray, "parameters"]
    log_evidence: float
    square: float
    gram: Annotated[np.ndarray, "columns columns"]
    grams: Annotated[np.ndarray, "hypotheses columns columns"]
    log_dets: Annotated[np.ndarray, "hypotheses"]


@dataclass(frozen=True, kw_only=True, eq=False)
class HoverFitter:
    """Fitter of sets of effects to the balances of logs, of which the first `baseline` are the baseline.

    curves: the balances of all logs, for each hypothesis about the thrust curve.
    """

    vehicle: Vehicle
    space: ParameterSpace
    curves: Sequence[Sequence[Balance]]
    baseline: int

    @property
    def prior(self) -> Prior:
        """Prior of the parameters, without couplings."""
        return self.space.prior

    def fit(self, effects: Sequence[str], start: HoverFit | None = None) -> HoverFit:
        """Return the set `effects` fitted from `start`, or from neutral."""
        names = tuple(sorted(effects))
        fit = self._step(names, np.zeros(len(self.space.columns)) if start is None else start.theta_scaled)
        for _ in range(_ITERATIONS - 1):
            fit = self._step(names, fit.theta_scaled)
        return fit

    def _step(self, names: Names, theta_scaled: Annotated[np.ndarray, "parameters"]) -> HoverFit:
        """Return the fit of a set in the linearisation at scaled parameters."""
        at = self.space.clipped(theta_scaled)
        grams, log_dets = self._grams(at)
        precision = self._coupled(at).precision(names)
        solved = [evidence.bounded_step(gram, at, precision, self.space.bounds) for gram in grams]
        steps, covariances = (np.array(each) for each in zip(*solved, strict=True))
        values = [self._scores(gram, det, at, [names])[0] for gram, det in zip(grams, log_dets, strict=True)]
        weights = softmax(values)
        step = weights @ steps
        spread = steps - step
        likely = int(np.argmax(values))
        moved = np.concatenate([[1.0], -steps[likely]])
        return HoverFit(
            effects=names,
            theta_scaled=self.space.clipped(at + step),
            covariance=np.einsum("h,hij->ij", weights, covariances) + (weights[:, None] * spread).T @ spread,
            at=at,
            log_evidence=float(np.logaddexp.reduce(values)),
            square=float(moved @ grams[likely] @ moved + precision @ (at + steps[likely]) ** 2),
            gram=grams[likely],
            grams=grams,
            log_dets=log_dets,
        )

    def scorers(self, fit: HoverFit) -> list[Score]:
        """Return the function that gives the log evidence of sets in the linearisation of `fit`."""

        def score(sets: Sequence[Names]) -> Sequence[float]:
            values = [
                self._scores(gram, det, fit.at, sets)
                for gram, det in zip(fit.grams, fit.log_dets, strict=True)
            ]
            return np.logaddexp.reduce(values, axis=0).tolist()

        return [score]

    def underrated_extensions(self, fit: HoverFit) -> list[Names]:
        """Return `fit` with each effect that brings others, and these: their prior depends on its size."""
        return [tuple(sorted({*fit.effects, *names})) for names in self.single_causes if len(names) > 1]

    @cached_property
    def single_causes(self) -> list[Names]:
        """Sets of one cause: each candidate alone, and with those that it brings."""
        alone = [(name,) for name in self.space.candidates]
        brought = [tuple(sorted({n, *self.space.effect(n).comes_with})) for n in self.space.candidates]
        return list(dict.fromkeys([*alone, *brought]))

    def causes(self, names: Sequence[str]) -> int:
        """Return how many causes a set has: effects that come with another one of the set are none."""
        owners = {self.space.effect(name).name for name in names}
        brought = {other for name in owners for other in self.space.effects[name].comes_with}
        return len(owners - brought)

    @cached_property
    def _arm_m(self) -> float:
        """Mean distance of the rotors from the centre."""
        return float(np.mean([np.hypot(*rotor.position_m[:2]) for rotor in self.vehicle.rotors]))

    def _coupled(self, at: Annotated[np.ndarray, "parameters"]) -> CoupledPrior:
        """Return the prior at scaled parameters: an attached mass acts at most at about the end of an arm."""
        space = self.space
        limits: dict[str, dict[int, float]] = {}
        for name in space.candidates:
            share = float(np.abs(space.scale * at)[list(space.groups[name])].max())
            columns = [i for other in space.effect(name).comes_with for i in space.groups[other]]
            if share > 0.0 and columns:
                limits[name] = {i: share * self._arm_m / np.sqrt(2.0) / space.scale[i] for i in columns}
        prior = space.prior
        return CoupledPrior(
            groups=prior.groups,
            forms=prior.forms,
            spike=prior.spike,
            nuisance_sigma=prior.nuisance_sigma,
            limits=limits,
        )

    def _scores(
        self, gram: np.ndarray, log_det: float, at: np.ndarray, sets: Sequence[Sequence[str]]
    ) -> list[float]:
        """Return the log evidence of sets under one hypothesis, with one prior odds for each cause."""
        values = evidence.log_evidences(gram, log_det, at, self._coupled(at), sets, self.space.bounds)
        return [
            value - len(names) * RULES.prior_log_odds - self.causes(names) * np.log(RULES.change_odds_against)
            for value, names in zip(values, sets, strict=True)
        ]

    def _grams(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return Grams and log determinants at scaled parameters, for each hypothesis."""
        grams, log_dets = [], []
        for logs in self.curves:
            columns = self._columns(logs, at)
            for hypothesis in product(RULES.session_thrust_sigmas, RULES.hover_scatters):
                root = np.linalg.cholesky(_covariance(logs, *hypothesis))
                white = np.linalg.solve(root, columns)
                grams.append(white.T @ white)
                log_dets.append(2.0 * np.log(np.diag(root)).sum())
        return np.array(grams), np.array(log_dets)

    def _columns(self, logs: Sequence[Balance], at: np.ndarray) -> Annotated[np.ndarray, "rows columns"]:
        """Return [residual | slopes] of all channels of all logs; the baseline is without effects."""
        rows = []
        neutral = np.zeros(len(at))
        for index, log in enumerate(logs):
            after = index >= self.baseline
            value = predicted(self.vehicle, self.space, at if after else neutral, log.thrust_n, log.state)
            S = slopes(self.vehicle, self.space, at, log) if after else np.zeros((len(at), CHANNELS))
            rows.append(np.column_stack([log.measured - value, S.T]))
        return np.concatenate(rows)


def _covariance(
    logs: Sequence[Balance], thrust_sigma: float, scatter: float
) -> Annotated[np.ndarray, "rows rows"]:
    """Return the covariance of all channels of all logs.

    thrust_sigma: standard deviation of the thrust scale of a log. scatter: factor on the error of its mean.
    """
    whole = np.tile(np.eye(CHANNELS), (len(logs), len(logs))) * _OFFSET**2
    for index, log in enumerate(logs):
        rows = slice(CHANNELS * index, CHANNELS * (index + 1))
        own = scatter**2 * log.covariance + thrust_sigma**2 * np.outer(log.scale, log.scale)
        own[3, 3] += log.yaw_sigma**2
        whole[rows, rows] += own
    return whole


@dataclass(frozen=True, kw_only=True)
class HoverDiagnosis:
    """The selected effects of a comparison of hovers, and their probabilities.

    The attributes are those of `trimtab.host.trace.selection.Diagnosis` that a result shows.
    """

    selected: HoverFit
    posterior_weights: Mapping[Names, float]
    repeatability: tuple[FlightRepeat | None, FlightRepeat | None] = (None, None)
