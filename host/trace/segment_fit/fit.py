"""Fits of sets of effects to command-driven segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.linearisation import DisturbanceVariances, Linearisation
from trimtab.host.trace.parameters import ParameterSpace, RollOutDiverged
from trimtab.host.trace.search import Names, Score
from trimtab.host.trace.segment_fit import linearise
from trimtab.host.trace.segment_fit.linearise import Basis
from trimtab.host.trace.segment_fit.model import SegmentModel

_CALM = float(np.log(0.05**2))
"""Log variance of a force in calm air, (m/s^2)^2."""
START = DisturbanceVariances(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.6**2)))
START_RATE_DRIVEN = DisturbanceVariances(
    log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.02**2))
)

SEGMENTS_SETTLED = 0.2
"""Greatest step, in standard deviations, at which a fit ends. If fits ended at greater steps, their evidence
would depend on where they start, by several nats.
"""


_SETTLED_STEP = 0.03
"""Greatest step, scaled, at which a fit ends whatever its standard deviations are."""

_GREATEST_STEP = 4.0
"""Greatest step of one iteration, scaled: the linearisation does not hold farther away."""

_ITERATIONS = 15
_GAINED_NATS = 1.0
_PATIENCE = 2
"""A fit ends after this many iterations in a row that gain less than _GAINED_NATS."""


@dataclass(frozen=True, kw_only=True)
class SegmentFit:
    """A set of effects fitted to segments.

    Attributes
    ----------
    effects
        The fitted set.
    log_evidence
        In nats.
    theta_scaled, covariance
        Estimate and its covariance, scaled.
    nuisances
        Nuisances of each flight.
    process
        Variances of the process disturbance of greatest evidence.
    lin
        Last linearisation; its point is one step away from the estimate.
    data
        Segments with the fitted initial states and disturbances.
    basis
        Columns of the Jacobian that further fits reuse.
    """

    effects: Names
    log_evidence: float
    theta_scaled: Annotated[np.ndarray, "parameters"]
    nuisances: Annotated[np.ndarray, "flights nuisances"]
    covariance: Annotated[np.ndarray, "parameters parameters"]
    process: DisturbanceVariances
    lin: Linearisation
    data: Segments
    basis: Basis


def starting_process(data: Segments) -> DisturbanceVariances:
    """Return the process disturbance from which the first fit of these segments starts."""
    return START_RATE_DRIVEN if data.rate_driven else START


@dataclass(frozen=True, kw_only=True, eq=False)
class SegmentFitter:
    """Fitter of sets of effects to command-driven segments."""

    segment_model: SegmentModel
    _starts: dict[tuple[str, Names, bytes], tuple[float, np.ndarray]] = field(
        default_factory=dict, init=False
    )

    @property
    def space(self) -> ParameterSpace:
        """Parameter space of the fits."""
        return self.segment_model.space

    @property
    def prior(self) -> Prior:
        """Prior of the parameters."""
        return self.segment_model.space.prior

    def fit(self, effects: Sequence[str], start: SegmentFit) -> SegmentFit:
        """Return the set `effects` refitted from `start`, with log evidence -inf if its model diverges."""
        try:
            return self._refit(effects, start)
        except RollOutDiverged:
            return replace(start, effects=tuple(sorted(effects)), log_evidence=-np.inf)

    def _refit(self, effects: Sequence[str], start: SegmentFit) -> SegmentFit:
        for name in sorted(set(effects) - set(start.effects)):
            if self._has_starts(name):
                gain, theta_scaled = self._best_start(name, start)
                if gain > RULES.worth_fitting_nats:
                    return refit(
                        self.segment_model,
                        undisturbed(start.data),
                        effects,
                        start,
                        theta_scaled=theta_scaled,
                    )
        return refit(self.segment_model, start.data, effects, start)

    def scorer(self, fit: SegmentFit) -> Score:
        """Return a function that gives the log evidence of sets in the linearisation of `fit`.

        It uses the process disturbance of `fit`.
        """
        return self._scorer(fit, fit.process)

    def screening_scorers(self, fit: SegmentFit) -> list[Score]:
        """Return functions like `scorer`, of which the first is `saturated_scorer`."""
        return [self.saturated_scorer(fit), self.scorer(fit)]

    def saturated_scorer(self, fit: SegmentFit) -> Score:
        """Return a function like `scorer` that uses the process disturbance fitted with every candidate."""
        saturated = evidence.fit_process(fit.lin, self.prior, self.space.candidates, fit.process)
        return self._scorer(fit, saturated)

    def _scorer(self, fit: SegmentFit, process: DisturbanceVariances) -> Score:
        """Return a function that scores sets in the linearisation of `fit` with this process."""
        prior, limits = self.prior, self.space.bounds
        white = evidence.marginal_grams(fit.lin, process, prior)
        return lambda sets: evidence.log_evidences(
            white.gram, white.log_det, fit.lin.theta_scaled, prior, sets, limits, fit.effects
        )

    def underrated_extensions(self, fit: SegmentFit) -> list[Names]:
        """Return sets with one more effect that gains much from one of its start values."""
        absent = sorted(set(self.space.candidates) - set(fit.effects))
        return [
            tuple(sorted((*fit.effects, name)))
            for name in absent
            if self.start_gain(name, fit) > RULES.worth_fitting_nats
        ]

    def start_gain(self, name: str, fit: SegmentFit) -> float:
        """Return the gain in nats of an effect at the best of its starts; 0 if it needs none."""
        return self._best_start(name, fit)[0] if self._has_starts(name) else 0.0

    def _has_starts(self, name: str) -> bool:
        """Return whether fits of the effect may start from the values in its effect file.

        An effect with states of its own needs none: segments start on the measured path, which already
        contains a payload's swing.
        """
        effect = self.space.effect(name)
        return bool(effect.starts) and not effect.memory

    def _best_start(self, name: str, fit: SegmentFit) -> tuple[float, np.ndarray]:
        """Return the gain in nats of the effect at the best of its starts, and theta_scaled there.

        Such an effect is not smooth: a fit from neutral would end near it. The other parameters are those of
        `fit`, or all neutral: what explains an absent effect may have driven them far away. They are fixed.
        There is no disturbance at the starts, since that of `fit` explains the effect as well.
        """
        key = (name, fit.effects, fit.lin.theta_scaled.tobytes())
        if key not in self._starts:
            others = (fit.lin.theta_scaled, theta_without_effects(self.space, fit))
            points = np.concatenate([self.space.at_starts(name, point) for point in others])
            costs = self._costs(fit, undisturbed(fit.data), points)
            best = int(np.argmin(costs))
            (without,) = self._costs(fit, fit.data, fit.lin.theta_scaled[None])
            self._starts[key] = without - costs[best], points[best]
        return self._starts[key]

    def _costs(self, fit: SegmentFit, data: Segments, points: np.ndarray) -> list[float]:
        """Return the negative log evidence of points with the process of `fit`, up to a constant."""
        lins = linearise.residuals_alone(self.segment_model, data, points, fit.lin.nuisances, fit.basis)
        whites = [
            evidence.marginal_grams(
                lin.with_variance_factor(fit.lin.variance_factor), fit.process, self.prior
            )
            for lin in lins
        ]
        costs = [0.5 * float(white.gram[0, 0]) for white in whites]
        return [cost if np.isfinite(cost) else np.inf for cost in costs]


def undisturbed(data: Segments) -> Segments:
    """Return the segments without process disturbance."""
    return data.with_w(np.zeros_like(data.disturbance_frd))


@dataclass(frozen=True)
class _Iterate:
    """A step of `refit`: cost and linearisation of its point, then what a fit that ends there returns."""

    cost: float
    lin: Linearisation
    white: evidence.MarginalGrams
    process: DisturbanceVariances
    data: Segments
    step: Annotated[np.ndarray, "parameters"]
    covariance: Annotated[np.ndarray, "parameters parameters"]
    nuisances: Annotated[np.ndarray, "flights nuisances"]


def refit(
    segment_model: SegmentModel,
    data: Segments,
    effects: Sequence[str],
    start: SegmentFit | None,
    *,
    theta_scaled: Annotated[np.ndarray, "parameters"] | None = None,
    iterations: int = _ITERATIONS,
) -> SegmentFit:
    """Fit all parameters by Gauss-Newton under the prior of `effects`.

    Every step also fits the process disturbance. The basis (Jacobian columns of initial state, nuisances and
    disturbance) is reused by later fits, so the first fit, without `start`, also finds the trajectories for
    it. On wrong trajectories the basis column of, say, a constant torque would differ from the column of an
    effect that acts alike, and terms that should cancel would look like information.

    Where an effect is not smooth, a step may increase the cost. The fit then returns the best iterate. A
    first fit, and one from `theta_scaled`, return the last one: each of their steps finds new trajectories.

    Parameters
    ----------
    segment_model
        Model of the segments.
    data
        Segments. Their initial states and disturbances are the start of the fit.
    effects
        Effects that are free within the slab of the prior; all others stay within the spike.
    start
        Fit from which parameters, process and basis start; None for a first fit.
    theta_scaled
        Parameters to start from, scaled, where they are far from those of `start`. Every step then takes the
        basis again, on the trajectories that it leads to.
    iterations
        Greatest number of Gauss-Newton steps.
    """
    space, prior = segment_model.space, segment_model.space.prior
    precision, far = prior.precision(effects), theta_scaled is not None
    if start is None:
        theta_scaled, process = np.zeros(len(space.columns)), starting_process(data)
        nuisances = np.zeros((int(data.flight.max()) + 1, segment_model.nuisances))
        data = data.with_w(linearise.disturbance_from_measured_rotation(segment_model, data))
        basis = linearise.basis(segment_model, data, theta_scaled, nuisances)
    else:
        theta_scaled = (start.lin.theta_scaled if theta_scaled is None else theta_scaled).copy()
        nuisances, process = start.lin.nuisances, start.process
        for name in set(start.effects) - set(effects):
            if not space.effect(name).starts:  # the prior alone pulls such an effect back: see `_best_start`
                theta_scaled[[*space.groups[name], *space.forms[name]]] = 0.0
        if space.rolled is not space:
            # Of two sets the common parameters are nearly free, so what takes the place of an effect that
            # leaves must be found on trajectories that it would give: attitude responds strongly to torque.
            left = theta_scaled - start.lin.theta_scaled
            data = data.with_w(evidence.disturbances(start.lin, process, left, np.zeros_like(nuisances)))
        basis = start.basis
    best: _Iterate | None = None
    idle, factor = 0, 1.0 if start is None else start.lin.variance_factor
    for iteration in range(iterations):
        if iteration == 0 and start is not None and (theta_scaled == start.lin.theta_scaled).all():
            lin = start.lin
        else:
            lin, x0 = linearise.linearise(segment_model, data, theta_scaled, nuisances, basis)
            data = data.with_x0(x0)
            lin = lin.with_variance_factor(factor)
        lin, process, white, step, covariance = _linear_step(lin, process, prior, effects, space)
        factor = lin.variance_factor
        largest = (np.abs(step) / np.sqrt(np.diag(covariance))).max()
        small = np.abs(step).max() < _SETTLED_STEP
        settled = small or (iteration >= 1 and largest < SEGMENTS_SETTLED)
        limited = np.clip(step, -_GREATEST_STEP, _GREATEST_STEP)
        step = space.clipped(theta_scaled + limited) - theta_scaled
        nuisance_step = evidence.nuisance_step(lin, white, prior, step)
        cost = 0.5 * (float(white.gram[0, 0] + precision @ theta_scaled**2) + white.log_det)
        gained = best is None or start is None or cost < best.cost - _GAINED_NATS
        idle = 0 if gained else idle + 1
        if best is None or gained or far or cost < best.cost:
            best = _Iterate(cost, lin, white, process, data, step, covariance, nuisances + nuisance_step)
        if settled or idle == _PATIENCE:
            break
        nuisances = nuisances + nuisance_step
        data = data.with_w(evidence.disturbances(lin, process, step, nuisance_step))
        theta_scaled = theta_scaled + step
        if far or (start is None and iteration < 2):
            data = data.with_x0(linearise.fitted_x0(segment_model, data, theta_scaled, nuisances, basis, 2))
            basis = linearise.basis(segment_model, data, theta_scaled, nuisances)
        del lin  # before the next one is made: of many flights each is large
    assert best is not None
    at = best.lin.theta_scaled
    return SegmentFit(
        effects=tuple(sorted(effects)),
        log_evidence=evidence.log_evidences(
            best.white.gram, best.white.log_det, at, prior, [effects], space.bounds
        )[0],
        theta_scaled=at + best.step,
        nuisances=best.nuisances,
        covariance=best.covariance,
        process=best.process,
        lin=best.lin,
        data=best.data,
        basis=basis,
    )


def _linear_step(
    lin: Linearisation,
    process: DisturbanceVariances,
    prior: Prior,
    effects: Sequence[str],
    space: ParameterSpace,
) -> tuple[Linearisation, DisturbanceVariances, evidence.MarginalGrams, np.ndarray, np.ndarray]:
    """Return the results of `evidence.fit_noise` from `process`, and step and covariance with them."""
    at, precision = lin.theta_scaled, prior.precision(effects)

    def bounded(white: evidence.MarginalGrams) -> tuple[np.ndarray, np.ndarray]:
        return evidence.bounded_step(white.gram, at, precision, space.bounds, space.added)

    lin, process, white = evidence.fit_noise(lin, prior, effects, process, lambda grams: bounded(grams)[0])
    return lin, process, white, *bounded(white)


def at_parameters(
    segment_model: SegmentModel,
    start: SegmentFit,
    effects: Names,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    covariance: Annotated[np.ndarray, "parameters parameters"],
    log_evidence: float,
) -> SegmentFit:
    """Return a segment fit at parameters that were fitted to whole flights.

    Only initial states, nuisances, the disturbance, its variances and that of the sensor noise are fitted to
    the segments of `start`.

    Parameters
    ----------
    segment_model
        Model of the segments.
    start
        Segment fit that gives segments, nuisances, process and basis.
    effects
        The selected set.
    theta_scaled, covariance
        Estimate and covariance, scaled, of the flight fit.
    log_evidence
        Log evidence of the flight fit, in nats.
    """
    prior, data, nuisances, process = segment_model.space.prior, start.data, start.nuisances, start.process
    fixed = np.zeros(len(theta_scaled))
    passes = 2
    while True:
        try:
            lin, x0 = linearise.linearise(segment_model, data, theta_scaled, nuisances, start.basis)
        except RollOutDiverged:  # the disturbance belongs to other parameters
            data = undisturbed(data)
            lin, x0 = linearise.linearise(segment_model, data, theta_scaled, nuisances, start.basis)
        data = data.with_x0(x0)
        lin, process, white = evidence.fit_noise(lin, prior, effects, process, lambda _: fixed)
        nuisance_step = evidence.nuisance_step(lin, white, prior, fixed)
        nuisances = nuisances + nuisance_step
        passes -= 1
        if not passes:
            break
        data = data.with_w(evidence.disturbances(lin, process, fixed, nuisance_step))
        del lin  # before the next one is made: of many flights each is large
    return SegmentFit(
        effects=effects,
        log_evidence=log_evidence,
        theta_scaled=theta_scaled,
        nuisances=nuisances,
        covariance=covariance,
        process=process,
        lin=lin,
        data=data,
        basis=start.basis,
    )


def disturbance_left(
    fit: SegmentFit, theta_scaled: Annotated[np.ndarray, "parameters"]
) -> Annotated[np.ndarray, "segments bins 6"]:
    """Return the unexplained disturbance, FRD, at theta_scaled.

    Specific force in m/s^2, then angular acceleration in rad/s^2, in the linearisation of `fit`.
    """
    return evidence.disturbances(
        fit.lin, fit.process, theta_scaled - fit.lin.theta_scaled, fit.nuisances - fit.lin.nuisances
    )


def theta_without_effects(space: ParameterSpace, null_fit: SegmentFit) -> Annotated[np.ndarray, "parameters"]:
    """Return theta_scaled of the model without effects: 0, except for freed adjustments.

    null_fit: segment fit without effects, which gives the values of the freed adjustments.
    """
    freed = [i for i, column in enumerate(space.columns) if column.owner in space.freed]
    theta_scaled = np.zeros(len(space.columns))
    theta_scaled[freed] = null_fit.theta_scaled[freed]
    return theta_scaled
