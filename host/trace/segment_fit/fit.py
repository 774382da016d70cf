"""Sets of effects fitted to command-driven segments, and the diagnosis: what a search over them ends with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.evidence import Linearisation, Prior, Process
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.search import Names
from trimtab.host.trace.segment_fit import linearise, model
from trimtab.host.trace.segment_fit.linearise import Basis
from trimtab.host.trace.segment_fit.model import SegmentModel

_CALM = float(np.log(0.05**2))
START = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.6**2)))
START_RATE_DRIVEN = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.02**2)))

SEGMENTS_SETTLED = 0.2
"""Greatest step, in standard deviations, after which a fit ends: what is left of a greater one makes the
evidence depend on where the fit began, by nats."""


@dataclass(frozen=True, kw_only=True)
class SegmentFit:
    """One set of effects refitted: its evidence, the point (z, local), covariance (P, P) scaled, and the
    linearisation it was found in, whose own point is up to a standard deviation away.
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
    """Where the search for the process noise of these segments begins."""
    return START_RATE_DRIVEN if data.rate_driven else START


@dataclass(frozen=True, kw_only=True)
class SegmentFitter:
    """Fits sets of effects to command-driven segments."""

    form: SegmentModel

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        return self.form.space

    @property
    def prior(self) -> Prior:
        """Their prior."""
        return self.form.space.prior

    def fit(self, effects: Sequence[str], start: SegmentFit) -> SegmentFit:
        """Return the set `effects` refitted from `start`."""
        return refit(self.form, start.data, effects, start)

    def scorers(self, fit: SegmentFit) -> list[Callable[[Names], float]]:
        """Log evidence of any set in the fit's linearisation: with the process noise that every candidate
        together leaves, and with the fit's own.
        """
        prior, candidates = self.prior, self.space.candidates
        saturated = evidence.fit_process(fit.lin, prior, candidates, fit.process)
        each = [evidence.whitened(fit.lin, process, prior) for process in (saturated, fit.process)]
        return [
            lambda names, white=white: evidence.log_evidence(
                white.gram,
                white.log_det,
                fit.lin.theta_scaled,
                prior.precision(names),
                len(names),
                self.space.bounds,
            )
            for white in each
        ]

    def beyond(self, fit: SegmentFit) -> list[Names]:
        """None: segments are begun from the measured path, which holds a swing already."""
        return []


def refit(
    form: SegmentModel,
    data: Segments,
    effects: Sequence[str],
    start: SegmentFit | None,
    *,
    iterations: int = 6,
) -> SegmentFit:
    """Gauss-Newton on all parameters under the prior of `effects`, the process noise fitted again at every
    step.

    The first fit, with no `start`, also finds the trajectories that the basis is taken along: its columns are
    long, and along the wrong trajectory they would no longer be parallel to an effect of the same shape.
    """
    space = form.space
    prior, groups = space.prior, space.groups
    flights = int(data.flight.max()) + 1
    if start is None:
        theta_scaled, local, process = (
            np.zeros(len(space.columns)),
            np.zeros((flights, model.LOCALS)),
            starting_process(data),
        )
    else:
        theta_scaled, local, process = start.lin.theta_scaled.copy(), start.lin.local, start.process
        for name in set(start.effects) - set(effects):
            theta_scaled[list(groups[name])] = 0.0
    precision = prior.precision(effects)
    if start is None:
        data = data.with_w(linearise.measured_turn(form, data))
        kept = linearise.basis(form, data, theta_scaled, local)
    else:
        kept = start.basis
    for iteration in range(iterations):
        if iteration == 0 and start is not None and np.array_equal(theta_scaled, start.lin.theta_scaled):
            lin = start.lin
        else:
            grams = linearise.linearise(form, data, theta_scaled, local, kept)
            data = data.with_x0(grams.x0)
            lin = linearise.project(grams, data, theta_scaled, local)
        process = evidence.fit_process(lin, prior, effects, process)
        white = evidence.whitened(lin, process, prior)
        step, covariance = evidence.bounded(white.gram, theta_scaled, precision, space.bounds)
        sigma = np.sqrt(np.diag(covariance))
        if np.abs(step).max() < 0.03 or (iteration >= 1 and (np.abs(step) / sigma).max() < SEGMENTS_SETTLED):
            break
        if iteration < iterations - 1:
            step = space.clipped(theta_scaled + np.clip(step, -4.0, 4.0)) - theta_scaled
            moved = evidence.local_step(lin, white, prior, step)
            local = local + moved
            data = data.with_w(evidence.disturbances(lin, process, step, moved))
            theta_scaled = theta_scaled + step
            if start is None and iteration < 2:
                data = data.with_x0(linearise.fitted_x0(form, data, theta_scaled, local, kept, 2))
                kept = linearise.basis(form, data, theta_scaled, local)
    step = space.clipped(theta_scaled + np.clip(step, -4.0, 4.0)) - theta_scaled
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
        basis=kept,
    )


def at_parameters(
    form: SegmentModel,
    start: SegmentFit,
    effects: Names,
    theta_scaled: np.ndarray,
    covariance: np.ndarray,
    log_evidence: float,
) -> SegmentFit:
    """Return the segments of `start` under `effects` with theta_scaled (P,) that was fitted otherwise.

    Only the flights' nuisances, the disturbance and its strength are fitted.
    """
    prior, data, local, process = form.space.prior, start.data, start.local, start.process
    for last in (False, True):
        grams = linearise.linearise(form, data, theta_scaled, local, start.basis)
        data = data.with_x0(grams.x0)
        lin = linearise.project(grams, data, theta_scaled, local)
        process = evidence.fit_process(lin, prior, effects, process)
        moved = evidence.local_step(
            lin, evidence.whitened(lin, process, prior), prior, np.zeros(len(theta_scaled))
        )
        local = local + moved
        if not last:
            data = data.with_w(evidence.disturbances(lin, process, np.zeros(len(theta_scaled)), moved))
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
    """Return the disturbance (segments, bins, 6) that the model leaves at theta_scaled (P,).

    In the linearisation of the fit.
    """
    return evidence.disturbances(
        fit.lin, fit.process, theta_scaled - fit.lin.theta_scaled, fit.local - fit.lin.local
    )


def unknowns_only(chosen: ParameterSpace, nothing: SegmentFit) -> np.ndarray:
    """Scaled values (P,) of a model that adds nothing: only what the logs declare unknown is fitted."""
    unknown = [i for i, column in enumerate(chosen.columns) if column.owner in chosen.unknown]
    theta_scaled = np.zeros(len(chosen.columns))
    theta_scaled[unknown] = nothing.theta_scaled[unknown]
    return theta_scaled
