"""Single causes fitted to the difference between the balances of two sets of logs.

A hover gives four numbers, so no two causes at once are searched. What the vehicle file lacks in both sets is
free: one offset of each channel. A cause acts only in the logs after the change. Nuisances are the tolerances
of the build, and in each log its thrust scale and a yaw torque of tilted rotor axes. How large the nuisances
are is unknown (`Hypothesis`): the evidence of a cause is its mean over all hypotheses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Annotated, NamedTuple

import numpy as np
from scipy.special import softmax

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.hover.balance import CHANNELS, Balance, predicted, slopes
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.residual.unexplained import FlightRepeat
from trimtab.host.trace.search import Names
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

    def precision(
        self, selected: Sequence[str], linearised_with: Sequence[str] = ()
    ) -> Annotated[np.ndarray, "parameters"]:
        """Return the prior precision, scaled, if the effects `selected` are in the model."""
        precision = super().precision(selected, linearised_with)
        for name in set(selected) & set(self.limits):
            for column, sigma in self.limits[name].items():
                precision[column] = max(precision[column], 1.0 / max(sigma, self.spike[column]) ** 2)
        return precision


@dataclass(frozen=True, kw_only=True)
class HoverFit:
    """A cause fitted to the change of the balance.

    Attributes
    ----------
    effects
        The effects of the cause; empty for none.
    theta_scaled, covariance
        Estimate and its covariance, scaled.
    log_evidence
        In nats, with the prior odds of the cause.
    widest
        Least square of whitened residual and prior under the most probable of the hypotheses with the whole
        tolerances: how badly the cause fits whatever the prior says of its size.
    gram
        Gram of the whitened [residual | slopes] of that hypothesis.
    thrust_sigma
        Standard deviation of the thrust scale from log to log: root mean square over the hypotheses.
    """

    effects: Names
    theta_scaled: Annotated[np.ndarray, "parameters"]
    covariance: Annotated[np.ndarray, "parameters parameters"]
    log_evidence: float
    widest: float
    gram: Annotated[np.ndarray, "columns columns"]
    thrust_sigma: float


class Hypothesis(NamedTuple):
    """What is unknown beside the cause.

    curve: index of the thrust curve. thrust_sigma: standard deviation of the thrust scale from log to log.
    scatter: factor on the error of the mean of a log. handling: factor on all tolerances of the build.
    """

    curve: int
    thrust_sigma: float
    scatter: float
    handling: float


@dataclass(frozen=True, kw_only=True, eq=False)
class HoverFitter:
    """Fitter of single causes to the balances of logs, of which the first `baseline` are the baseline.

    curves: the balances of all logs, for each hypothesis about the thrust curve.
    """

    vehicle: Vehicle
    space: ParameterSpace
    curves: Sequence[Sequence[Balance]]
    baseline: int

    @cached_property
    def causes(self) -> list[Names]:
        """Return the causes: none, each candidate alone, and each with the effects that it brings."""
        space = self.space
        brought = [tuple(sorted({name, *space.effect(name).comes_with})) for name in space.candidates]
        return list(dict.fromkeys([(), *((name,) for name in space.candidates), *brought]))

    def fit(self, names: Names) -> HoverFit:
        """Return a cause fitted from neutral."""
        fit = self._step(names, np.zeros(len(self.space.columns)))
        for _ in range(_ITERATIONS - 1 if names else 0):
            fit = self._step(names, fit.theta_scaled)
        return fit

    def _step(self, names: Names, theta_scaled: Annotated[np.ndarray, "parameters"]) -> HoverFit:
        """Return the fit of a cause in the linearisation at scaled parameters."""
        at, limits = self.space.clipped(theta_scaled), self.space.bounds
        columns = [self._columns(logs, at) for logs in self.curves]
        steps, covariances, values, squares, grams = [], [], [], [], []
        for hypothesis in self._hypotheses:
            root = np.linalg.cholesky(_covariance(self.curves[hypothesis.curve], hypothesis))
            white = np.linalg.solve(root, columns[hypothesis.curve])
            gram, log_det = white.T @ white, 2.0 * float(np.log(np.diag(root)).sum())
            prior = self._prior(at, hypothesis.handling)
            precision = prior.precision(names)
            step, covariance = evidence.bounded_step(gram, at, precision, limits)
            moved = np.concatenate([[1.0], -step])
            steps.append(step)
            covariances.append(covariance)
            values += evidence.log_evidences(gram, log_det, at, prior, [names], limits)
            squares.append(float(moved @ gram @ moved + precision @ (at + step) ** 2))
            grams.append(gram)
        weights = softmax(values)
        step = weights @ np.array(steps)
        spread = np.array(steps) - step
        whole = [each.handling == max(RULES.hover_handling) for each in self._hypotheses]
        likely = int(np.argmax(np.where(whole, values, -np.inf)))
        odds = -len(names) * RULES.prior_log_odds - np.log(RULES.change_odds_against) * bool(names)
        return HoverFit(
            effects=names,
            theta_scaled=self.space.clipped(at + step),
            covariance=np.einsum("h,hij->ij", weights, covariances) + (weights[:, None] * spread).T @ spread,
            log_evidence=float(np.logaddexp.reduce(values) + odds),
            widest=squares[likely],
            gram=grams[likely],
            thrust_sigma=float(np.sqrt(weights @ [each.thrust_sigma**2 for each in self._hypotheses])),
        )

    @cached_property
    def _hypotheses(self) -> list[Hypothesis]:
        """All hypotheses, equally probable before the logs are seen."""
        curves = range(len(self.curves))
        known = RULES.hover_thrust_sigmas, RULES.hover_scatters, RULES.hover_handling
        return [Hypothesis(*each) for each in product(curves, *known)]

    @cached_property
    def _arm_m(self) -> float:
        """Mean distance of the rotors from the centre."""
        return float(np.mean([np.hypot(*rotor.position_m[:2]) for rotor in self.vehicle.rotors]))

    def _prior(self, at: Annotated[np.ndarray, "parameters"], handling: float) -> CoupledPrior:
        """Return the prior at scaled parameters: an attached mass acts at most at about the end of an arm."""
        space, prior = self.space, self.space.prior
        limits: dict[str, dict[int, float]] = {}
        for name in space.candidates:
            share = float(np.abs(space.scale * at)[list(space.groups[name])].max())
            columns = [i for other in space.effect(name).comes_with for i in space.groups[other]]
            if share > 0.0 and columns:
                limits[name] = {i: share * self._arm_m / np.sqrt(2.0) / space.scale[i] for i in columns}
        return CoupledPrior(
            groups=prior.groups,
            forms=prior.forms,
            spike=handling * prior.spike,
            nuisance_sigma=prior.nuisance_sigma,
            limits=limits,
        )

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


def _covariance(logs: Sequence[Balance], hypothesis: Hypothesis) -> Annotated[np.ndarray, "rows rows"]:
    """Return the covariance of all channels of all logs."""
    whole = np.tile(np.eye(CHANNELS), (len(logs), len(logs))) * _OFFSET**2
    for index, log in enumerate(logs):
        rows = slice(CHANNELS * index, CHANNELS * (index + 1))
        own = hypothesis.scatter**2 * log.covariance
        own += hypothesis.thrust_sigma**2 * np.outer(log.scale, log.scale)
        own[3, 3] += (hypothesis.handling * log.yaw_sigma) ** 2
        whole[rows, rows] += own
    return whole


@dataclass(frozen=True, kw_only=True)
class HoverDiagnosis:
    """The most probable cause of a comparison of hovers, and the probabilities of all.

    The attributes are those of `trimtab.host.trace.selection.Diagnosis` that a result shows.
    """

    selected: HoverFit
    posterior_weights: Mapping[Names, float]
    repeatability: tuple[FlightRepeat | None, FlightRepeat | None] = (None, None)
