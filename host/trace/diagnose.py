"""The search for the missing effects: linearise, screen by evidence, refit the finalists, keep the smallest
set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from host.trace import evidence, segments
from host.trace.evidence import Linearisation, Process
from host.trace.form import Form
from host.trace.parameters import Space
from host.trace.segments import Basis, Segments

_CALM = float(np.log(0.05**2))
START = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.6**2)))
START_RATE_DRIVEN = Process(log_lateral=_CALM, log_axial=_CALM, log_torque=float(np.log(0.02**2)))
MAX_EFFECTS = 6
BEAM = 25
WITHIN_NATS = float(np.log(20.0))
"""The smallest set whose evidence is this close to the best one is kept."""

BEARS = 4.0
"""Tolerances beyond which an effect is there for another to act through it."""

ALIAS_PROBABILITY = 0.05

Report = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Fit:
    """One set of effects refitted: its evidence, the point (z, local), covariance (P, P) scaled, and
    linearisation.
    """

    effects: tuple[str, ...]
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
    """What the search ends with.

    `best` is the kept set, `nothing` the fit without any effect, `inclusion` each candidate's posterior
    probability, `weights` the relative posterior weight of every set considered, `sets` the evidence of every
    refitted one.
    """

    best: Fit
    nothing: Fit
    inclusion: dict[str, float]
    weights: dict[tuple[str, ...], float]
    sets: dict[tuple[str, ...], float]


def starting_process(data: Segments) -> Process:
    """Where the search for the process noise of these segments begins."""
    return START_RATE_DRIVEN if data.rate_driven else START


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
        z, local, process = start.z.copy(), start.local, start.process
        for name in set(start.effects) - set(effects):
            z[list(groups[name])] = 0.0
    precision = prior.precision(effects)
    if start is None:
        data = data.with_w(segments.measured_turn(form, data))
        kept = segments.basis(form, data, z, local)
    else:
        kept = start.basis
    for iteration in range(iterations):
        if iteration == 0 and start is not None and np.array_equal(z, start.z):
            lin = start.lin
        else:
            grams = segments.linearise(form, data, z, local, kept)
            data = data.with_x0(grams.x0)
            lin = segments.project(grams, data, z, local)
        process = evidence.fit_process(lin, prior, effects, process)
        white = evidence.whitened(lin, process, prior)
        step, covariance = evidence.posterior(white.gram, z, precision)
        sigma = np.sqrt(np.diag(covariance))
        if np.abs(step).max() < 0.03 or (iteration >= 1 and (np.abs(step) / sigma).max() < 1.0):
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
    return Fit(
        effects=tuple(sorted(effects)),
        log_evidence=evidence.log_evidence(white, z, precision, len(effects)),
        z=z,
        local=local,
        covariance=covariance,
        process=process,
        lin=lin,
        data=data,
        basis=kept,
    )


def screen(space: Space, fit: Fit, process: Process, depth: int) -> dict[tuple[str, ...], float]:
    """Evidence of every admissible set up to `depth` effects that a beam search visits, in `fit`'s
    linearisation.
    """
    white = evidence.whitened(fit.lin, process, space.prior)

    def score(names: tuple[str, ...]) -> float:
        return evidence.log_evidence(white, fit.z, space.prior.precision(names), len(names))

    scores: dict[tuple[str, ...], float] = {(): score(())}
    frontier: list[tuple[str, ...]] = [()]
    for _ in range(depth):
        fresh: dict[tuple[str, ...], float] = {}
        for names in frontier:
            for extra in _extensions(space, names):
                grown = tuple(sorted((*names, *extra)))
                if len(grown) <= depth and grown not in scores and grown not in fresh:
                    fresh[grown] = score(grown)
        scores.update(fresh)
        frontier = sorted(fresh, key=lambda names: (-fresh[names], names))[:BEAM]
    return scores


def _extensions(space: Space, names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """What may be added in one step: an effect, or an effect together with one that it requires."""
    free = [name for name in space.candidates if name not in names]
    out: list[tuple[str, ...]] = [(name,) for name in free if space.admissible((*names, name))]
    pairs = [pair for pair in combinations(free, 2) if not all(space.admissible((*names, n)) for n in pair)]
    return out + [pair for pair in pairs if space.admissible((*names, *pair))]


def diagnose(form: Form, data: Segments, report: Report = lambda _: None) -> Diagnosis:
    """The missing effects of the segments: forward steps, swaps and drops, each screened, then refitted."""
    space = form.space
    nothing = refit(form, data, (), None, iterations=3)
    fits: dict[tuple[str, ...], Fit] = {(): nothing}
    current = nothing
    report("no effect fitted")
    for _ in range(2 * MAX_EFFECTS):
        saturated = evidence.fit_process(current.lin, space.prior, space.candidates, current.process)
        trials: list[tuple[str, ...]] = []
        for process in (saturated, current.process):
            scores = screen(space, current, process, min(MAX_EFFECTS, len(current.effects) + 2))
            trials += _proposals(scores, current.effects)
        for names in dict.fromkeys(trials):
            if names not in fits:
                fits[names] = refit(form, current.data, names, current)
                report(f"{', '.join(names) or 'no effect'} fitted")
        best = max(fits.values(), key=lambda fit: (fit.log_evidence, fit.effects))
        if best.effects == current.effects:
            break
        current = best
    borne = {names: fit for names, fit in fits.items() if _borne(space, fit)}
    kept = _smallest(borne)
    weights = _weights(space, kept, borne, frozenset(fits) - frozenset(borne))
    total = sum(weights.values())
    return Diagnosis(
        best=kept,
        nothing=nothing,
        inclusion={
            name: sum(w for names, w in weights.items() if name in names) / total for name in space.candidates
        },
        weights=weights,
        sets={names: fit.log_evidence for names, fit in fits.items()},
    )


def _proposals(scores: dict[tuple[str, ...], float], current: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The best set overall, the best with one more, the best with one swapped, and every set with one
    fewer.
    """
    order = sorted(scores, key=lambda names: (-scores[names], names))
    have = set(current)
    more = [n for n in order if len(n) > len(have) and have <= set(n)][:1]
    swapped = (
        [n for n in order if len(n) == len(have) and len(set(n) & have) == len(have) - 1][:1] if have else []
    )
    fewer = [n for n in order if len(n) == len(have) - 1 and set(n) <= have]
    return [*order[:1], *more, *swapped, *fewer]


def _borne(space: Space, fit: Fit) -> bool:
    """Whether what an effect acts through was itself found: beyond BEARS times its tolerance.

    Wind on a drag within tolerance is a force of some 0.01 m/s^2, as the slow part of turbulence is.
    """
    beyond = np.abs(fit.z) > BEARS * space.prior.spike
    found = {name for name in fit.effects if beyond[list(space.groups[name])].any()}
    needs = (space.effect(name).requires_any for name in fit.effects)
    return all(not any_of or found & set(any_of) for any_of in needs)


def _smallest(fits: dict[tuple[str, ...], Fit]) -> Fit:
    """The smallest set within WITHIN_NATS of the greatest evidence; of several, the most probable."""
    top = max(fit.log_evidence for fit in fits.values())
    close = [fit for fit in fits.values() if fit.log_evidence > top - WITHIN_NATS]
    return min(close, key=lambda fit: (len(fit.effects), -fit.log_evidence, fit.effects))


def _weights(
    space: Space, kept: Fit, fits: dict[tuple[str, ...], Fit], left_out: frozenset[tuple[str, ...]]
) -> dict[tuple[str, ...], float]:
    """Posterior weights, greatest 1, of the refitted sets and of the kept fit's linearised neighbours."""
    scores = screen(space, kept, kept.process, min(MAX_EFFECTS, len(kept.effects) + 1))
    scores.update({names: fit.log_evidence for names, fit in fits.items()})
    scores = {names: score for names, score in scores.items() if names not in left_out}
    top = max(scores.values())
    return {names: float(np.exp(value - top)) for names, value in scores.items()}
