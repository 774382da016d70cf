"""Sets of effects fitted to command-driven segments, and the diagnosis: what a search over them ends with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trimtab.host.trace import evidence, segments
from trimtab.host.trace.evidence import Linearisation, Prior, Process
from trimtab.host.trace.form import Form
from trimtab.host.trace.parameters import Space
from trimtab.host.trace.search import Names, none_of
from trimtab.host.trace.segments import Basis, Segments
from trimtab.host.trace.twins import FlightRepeat

_CALM = float(np.log(0.05**2))
START = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.6**2)))
START_RATE_DRIVEN = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.02**2)))

SEGMENTS_SETTLED = 0.2
"""Greatest step, in standard deviations, after which a fit ends: what is left of a greater one makes the
evidence depend on where the fit began, by nats."""

Method = Literal["segments", "closed-loop"]


@dataclass(frozen=True, kw_only=True)
class Fit:
    """One set of effects refitted: its evidence, the point (z, local), covariance (P, P) scaled, and the
    linearisation it was found in, whose own point is up to a standard deviation away.
    """

    effects: Names
    log_evidence: float
    z: np.ndarray
    local: np.ndarray
    covariance: np.ndarray
    process: Process
    lin: Linearisation
    data: Segments
    basis: Basis


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The missing effects and how sure they are.

    best: the segments under the kept set, nothing: without any effect. method: what the set and its
    parameters were found by. inclusion: each candidate's posterior probability. weights: the relative
    posterior weight of every set considered. sets: the evidence of every fitted one. stands_out: by how many
    sigma each effect of typical size would show in these flights. repeats: of whole flights, where twins were
    flown, beside what was found and of a model without any effect.
    """

    best: Fit
    nothing: Fit
    method: Method
    inclusion: Mapping[str, float]
    weights: Mapping[Names, float]
    sets: Mapping[Names, float]
    stands_out: Mapping[str, float]
    repeats: tuple[FlightRepeat | None, FlightRepeat | None] = (None, None)

    @property
    def none(self) -> float:
        """Posterior probability that no effect is missing."""
        return none_of(self.weights)


def stands_out(space: Space, gram: np.ndarray, precision: np.ndarray) -> dict[str, float]:
    """By how many sigma each effect of typical size would show in flights of this whitened `gram`
    (1 + P, 1 + P) of [residual | slopes], everything else moving under the prior `precision` (P,).

    sqrt(theta' S' (I - P) S theta), of all parameters a typical step away, the strongest where one of several
    is. An effect that acts through another one stands out as far as that one was found.
    """
    whole = gram[1:, 1:] + np.diag(precision)
    found: dict[str, float] = {}
    for candidate in space.candidates:
        mine = np.array(space.groups[candidate])
        rest = np.setdiff1d(np.arange(len(precision)), mine)
        cross = whole[np.ix_(rest, mine)]
        own = gram[np.ix_(1 + mine, 1 + mine)] - cross.T @ np.linalg.solve(whole[np.ix_(rest, rest)], cross)
        name = space.effect(candidate).name
        found[name] = max(found.get(name, 0.0), float(np.sqrt(max(own.sum(), 0.0))))
    return found


def starting_process(data: Segments) -> Process:
    """Where the search for the process noise of these segments begins."""
    return START_RATE_DRIVEN if data.rate_driven else START


@dataclass(frozen=True, kw_only=True)
class SegmentFitter:
    """Fits sets of effects to command-driven segments."""

    form: Form

    @property
    def space(self) -> Space:
        """The parameters."""
        return self.form.space

    @property
    def prior(self) -> Prior:
        """Their prior."""
        return self.form.space.prior

    def fit(self, effects: Sequence[str], start: Fit) -> Fit:
        """The set `effects` refitted from `start`."""
        return refit(self.form, start.data, effects, start)

    def scorers(self, fit: Fit) -> list[Callable[[Names], float]]:
        """Log evidence of any set in the fit's linearisation: with the process noise that every candidate
        together leaves, and with the fit's own.
        """
        prior, candidates = self.prior, self.space.candidates
        saturated = evidence.fit_process(fit.lin, prior, candidates, fit.process)
        each = [evidence.whitened(fit.lin, process, prior) for process in (saturated, fit.process)]
        return [
            lambda names, white=white: evidence.log_evidence(
                white.gram, white.log_det, fit.lin.z, prior.precision(names), len(names), self.space.bounds
            )
            for white in each
        ]

    def beyond(self, fit: Fit) -> list[Names]:
        """None: segments are begun from the measured path, which holds a swing already."""
        return []


def refit(
    form: Form,
    data: Segments,
    effects: Sequence[str],
    start: Fit | None,
    *,
    iterations: int = 6,
) -> Fit:
    """Gauss-Newton on all parameters under the prior of `effects`, the process noise fitted again at every
    step.

    The first fit, with no `start`, also finds the trajectories that the basis is taken along: its columns are
    long, and along the wrong trajectory they would no longer be parallel to an effect of the same shape.
    """
    space = form.space
    prior, groups = space.prior, space.groups
    flights = int(data.flight.max()) + 1
    if start is None:
        z, local, process = (
            np.zeros(len(space.columns)),
            np.zeros((flights, segments.LOCALS)),
            starting_process(data),
        )
    else:
        z, local, process = start.lin.z.copy(), start.lin.local, start.process
        for name in set(start.effects) - set(effects):
            z[list(groups[name])] = 0.0
    precision = prior.precision(effects)
    if start is None:
        data = data.with_w(segments.measured_turn(form, data))
        kept = segments.basis(form, data, z, local)
    else:
        kept = start.basis
    for iteration in range(iterations):
        if iteration == 0 and start is not None and np.array_equal(z, start.lin.z):
            lin = start.lin
        else:
            grams = segments.linearise(form, data, z, local, kept)
            data = data.with_x0(grams.x0)
            lin = segments.project(grams, data, z, local)
        process = evidence.fit_process(lin, prior, effects, process)
        white = evidence.whitened(lin, process, prior)
        step, covariance = evidence.bounded(white.gram, z, precision, space.bounds)
        sigma = np.sqrt(np.diag(covariance))
        if np.abs(step).max() < 0.03 or (iteration >= 1 and (np.abs(step) / sigma).max() < SEGMENTS_SETTLED):
            break
        if iteration < iterations - 1:
            step = space.clipped(z + np.clip(step, -4.0, 4.0)) - z
            moved = evidence.local_step(lin, white, prior, step)
            local = local + moved
            data = data.with_w(evidence.disturbances(lin, process, step, moved))
            z = z + step
            if start is None and iteration < 2:
                data = data.with_x0(segments.fitted_x0(form, data, z, local, kept, 2))
                kept = segments.basis(form, data, z, local)
    step = space.clipped(z + np.clip(step, -4.0, 4.0)) - z
    return Fit(
        effects=tuple(sorted(effects)),
        log_evidence=evidence.log_evidence(
            white.gram, white.log_det, z, precision, len(effects), space.bounds
        ),
        z=z + step,
        local=local + evidence.local_step(lin, white, prior, step),
        covariance=covariance,
        process=process,
        lin=lin,
        data=data,
        basis=kept,
    )


def at_parameters(
    form: Form, start: Fit, effects: Names, z: np.ndarray, covariance: np.ndarray, log_evidence: float
) -> Fit:
    """The segments of `start` under `effects` with scaled parameters z (P,) that were found otherwise.

    Only the flights' nuisances, the disturbance and its strength are fitted.
    """
    prior, data, local, process = form.space.prior, start.data, start.local, start.process
    for last in (False, True):
        grams = segments.linearise(form, data, z, local, start.basis)
        data = data.with_x0(grams.x0)
        lin = segments.project(grams, data, z, local)
        process = evidence.fit_process(lin, prior, effects, process)
        moved = evidence.local_step(lin, evidence.whitened(lin, process, prior), prior, np.zeros(len(z)))
        local = local + moved
        if not last:
            data = data.with_w(evidence.disturbances(lin, process, np.zeros(len(z)), moved))
    return Fit(
        effects=effects,
        log_evidence=log_evidence,
        z=z,
        local=local,
        covariance=covariance,
        process=process,
        lin=lin,
        data=data,
        basis=start.basis,
    )
