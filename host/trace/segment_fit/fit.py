"""Fits of sets of effects to command-driven segments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.evidence import Linearisation, Prior, Process
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.search import Names
from trimtab.host.trace.segment_fit import linearise
from trimtab.host.trace.segment_fit.linearise import Basis
from trimtab.host.trace.segment_fit.model import LOCALS, SegmentModel

_CALM = float(np.log(0.05**2))
"""Log variance of a force in calm air, (m/s^2)^2."""
START = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.6**2)))
START_RATE_DRIVEN = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.02**2)))

SEGMENTS_SETTLED = 0.2
"""Greatest step, in standard deviations, at which a fit ends. With a greater one, the evidence would depend
on the start of the fit by nats."""


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
        Estimate (P,) and its covariance (P, P), scaled.
    local
        Nuisances (flights, LOCALS).
    process
        Process disturbance of greatest evidence.
    lin
        Last linearisation; its point is up to a standard deviation from the estimate.
    data
        Segments with the fitted initial states and disturbances.
    basis
        Columns of the Jacobian that further fits reuse.
    """

    effects: Names
    log_evidence: float
    theta_scaled: np.ndarray
    local: np.ndarray
    covariance: np.ndarray
    process: Process
    lin: Linearisation
    data: Segments
    basis: Basis


def starting_process(data: Segments) -> Process:
    """Return the process disturbance from which the first fit of these segments starts."""
    return START_RATE_DRIVEN if data.rate_driven else START


@dataclass(frozen=True, kw_only=True)
class SegmentFitter:
    """Fitter of sets of effects to command-driven segments."""

    segment_model: SegmentModel

    @property
    def space(self) -> ParameterSpace:
        """Parameter space of the fits."""
        return self.segment_model.space

    @property
    def prior(self) -> Prior:
        """Prior of the parameters."""
        return self.segment_model.space.prior

    def fit(self, effects: Sequence[str], start: SegmentFit) -> SegmentFit:
        """Return the set `effects` refitted from `start`."""
        return refit(self.segment_model, start.data, effects, start)

    def scorers(self, fit: SegmentFit) -> list[Callable[[Names], float]]:
        """Return two functions that give the log evidence of any set in the linearisation of `fit`.

        The first uses the process disturbance fitted with every candidate, the second that of `fit`.
        """
        prior, candidates = self.prior, self.space.candidates
        saturated = evidence.fit_process(fit.lin, prior, candidates, fit.process)
        whites = [evidence.whitened(fit.lin, process, prior) for process in (saturated, fit.process)]
        return [
            lambda names, white=white: evidence.log_evidence(
                white.gram,
                white.log_det,
                fit.lin.theta_scaled,
                prior.precision(names),
                len(names),
                self.space.bounds,
            )
            for white in whites
        ]

    def beyond(self, fit: SegmentFit) -> list[Names]:
        """Return no set: segments start on the measured path, which already contains a payload's swing."""
        return []


def refit(
    segment_model: SegmentModel,
    data: Segments,
    effects: Sequence[str],
    start: SegmentFit | None,
    *,
    iterations: int = 6,
) -> SegmentFit:
    """Fit all parameters by Gauss-Newton under the prior of `effects`.

    Every step also fits the process disturbance. The first fit, without `start`, also determines the
    trajectories along which the basis is computed. Its columns are long vectors, so along a wrong trajectory
    a column of the basis would no longer be parallel to the column of an effect of the same shape.

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
    iterations
        Greatest number of Gauss-Newton steps.
    """
    space, prior = segment_model.space, segment_model.space.prior
    precision = prior.precision(effects)
    if start is None:
        theta_scaled, process = np.zeros(len(space.columns)), starting_process(data)
        local = np.zeros((int(data.flight.max()) + 1, LOCALS))
        data = data.with_w(linearise.measured_turn(segment_model, data))
        basis = linearise.basis(segment_model, data, theta_scaled, local)
    else:
        theta_scaled, local, process = start.lin.theta_scaled.copy(), start.lin.local, start.process
        for name in set(start.effects) - set(effects):
            theta_scaled[list(space.groups[name])] = 0.0
        basis = start.basis
    iteration = 0
    while True:
        if iteration == 0 and start is not None and (theta_scaled == start.lin.theta_scaled).all():
            lin = start.lin
        else:
            lin, data = _linearised(segment_model, data, theta_scaled, local, basis)
        process = evidence.fit_process(lin, prior, effects, process)
        white = evidence.whitened(lin, process, prior)
        step, covariance = evidence.bounded(white.gram, theta_scaled, precision, space.bounds)
        sigma = np.sqrt(np.diag(covariance))
        settled = iteration >= 1 and (np.abs(step) / sigma).max() < SEGMENTS_SETTLED
        done = np.abs(step).max() < 0.03 or settled or iteration == iterations - 1
        step = space.clipped(theta_scaled + np.clip(step, -4.0, 4.0)) - theta_scaled
        if done:
            break
        local_step = evidence.local_step(lin, white, prior, step)
        local = local + local_step
        data = data.with_w(evidence.disturbances(lin, process, step, local_step))
        theta_scaled = theta_scaled + step
        if start is None and iteration < 2:
            data = data.with_x0(linearise.fitted_x0(segment_model, data, theta_scaled, local, basis, 2))
            basis = linearise.basis(segment_model, data, theta_scaled, local)
        iteration += 1
    return SegmentFit(
        effects=tuple(sorted(effects)),
        log_evidence=evidence.log_evidence(
            white.gram, white.log_det, theta_scaled, precision, len(effects), space.bounds
        ),
        theta_scaled=theta_scaled + step,
        local=local + evidence.local_step(lin, white, prior, step),
        covariance=covariance,
        process=process,
        lin=lin,
        data=data,
        basis=basis,
    )


def _linearised(
    segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray, local: np.ndarray, basis: Basis
) -> tuple[Linearisation, Segments]:
    """Return the linearisation at a point, and the segments with the initial states fitted there."""
    grams = linearise.linearise(segment_model, data, theta_scaled, local, basis)
    data = data.with_x0(grams.x0)
    return linearise.project(grams, data, theta_scaled, local), data


def at_parameters(
    segment_model: SegmentModel,
    start: SegmentFit,
    effects: Names,
    theta_scaled: np.ndarray,
    covariance: np.ndarray,
    log_evidence: float,
) -> SegmentFit:
    """Return a segment fit at parameters that were fitted to whole flights.

    Only nuisances, disturbance and process are fitted to the segments of `start`.

    Parameters
    ----------
    segment_model
        Model of the segments.
    start
        Segment fit that gives segments, nuisances, process and basis.
    effects
        The selected set.
    theta_scaled, covariance
        Estimate (P,) and covariance (P, P), scaled, of the flight fit.
    log_evidence
        Log evidence of the flight fit, in nats.
    """
    prior, data, local, process = segment_model.space.prior, start.data, start.local, start.process
    for last in (False, True):
        grams = linearise.linearise(segment_model, data, theta_scaled, local, start.basis)
        data = data.with_x0(grams.x0)
        lin = linearise.project(grams, data, theta_scaled, local)
        process = evidence.fit_process(lin, prior, effects, process)
        local_step = evidence.local_step(
            lin, evidence.whitened(lin, process, prior), prior, np.zeros(len(theta_scaled))
        )
        local = local + local_step
        if not last:
            data = data.with_w(evidence.disturbances(lin, process, np.zeros(len(theta_scaled)), local_step))
    return SegmentFit(
        effects=effects,
        log_evidence=log_evidence,
        theta_scaled=theta_scaled,
        local=local,
        covariance=covariance,
        process=process,
        lin=lin,
        data=data,
        basis=start.basis,
    )


def disturbance_left(fit: SegmentFit, theta_scaled: np.ndarray) -> np.ndarray:
    """Return the unexplained disturbance (segments, bins, 6), FRD, at theta_scaled (P,).

    Specific force in m/s^2, then angular acceleration in rad/s^2, in the linearisation of `fit`.
    """
    return evidence.disturbances(
        fit.lin, fit.process, theta_scaled - fit.lin.theta_scaled, fit.local - fit.lin.local
    )


def unknowns_only(space: ParameterSpace, null_fit: SegmentFit) -> np.ndarray:
    """Return theta_scaled (P,) of the model without effects: 0, except for what the logs declare unknown.

    null_fit: segment fit without effects, which gives the values of the unknowns.
    """
    unknown = [i for i, column in enumerate(space.columns) if column.owner in space.unknown]
    theta_scaled = np.zeros(len(space.columns))
    theta_scaled[unknown] = null_fit.theta_scaled[unknown]
    return theta_scaled
