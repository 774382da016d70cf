"""Choice of the next flight: separation of an effect from its alias, by the flights so far and a manoeuvre.

The separation is computed in the linearisation of command-driven segments, also if the search used whole
flights in closed loop. The motion of the vehicle determines how well a flight separates two effects, however
the flight is predicted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.next_flight.information import Instruments, information
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.segment_fit import linearise
from trimtab.host.trace.segment_fit.fit import SegmentFit
from trimtab.host.trace.segment_fit.model import SegmentModel

SIGMA_MAX = 100.0
"""Greatest separation that is reported. Beyond it a linearisation is inaccurate, but the flight decides."""


@dataclass(frozen=True, kw_only=True)
class NextFlight:
    """The flight that separates two effects best.

    Attributes
    ----------
    route
        Name of the route.
    total_time_s
        Duration of the plan; None if the vehicle can fly the route in the duration that it states.
    separates
        The effect and its alias.
    so_far_sigma
        Separation by the flights so far.
    expected_sigma
        Separation by the flights so far and this one, at most SIGMA_MAX.
    known_measurement
        Measurement that would decide between the two without a flight; None if none is known.
    """

    route: str
    total_time_s: float | None
    separates: tuple[str, str]
    so_far_sigma: float
    expected_sigma: float
    known_measurement: str | None = None

    @property
    def decides(self) -> bool:
        """Whether the flight is expected to separate the two effects by RULES.detectable_sigma."""
        return self.expected_sigma >= RULES.detectable_sigma

    @property
    def measurement(self) -> str | None:
        """Measurement that decides instead; None if the flight decides or no measurement is known."""
        return None if self.decides else self.known_measurement

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object `next_flight`."""
        return {
            "route": self.route,
            "total_time_s": self.total_time_s,
            "separates": list(self.separates),
            "so_far_sigma": self.so_far_sigma,
            "expected_sigma": self.expected_sigma,
            "decides": self.decides,
            "measurement": self.measurement,
        }


def separation(
    space: ParameterSpace,
    gram: Annotated[np.ndarray, "parameters parameters"],
    present: Iterable[str],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    effect: str,
    alias: str,
) -> float:
    """Return by how many sigma `effect` stands out if `alias` may take any size.

    lambda^2 = theta' S' (I - Q) S theta, with the information S' (I - Q) S of `information_of`.

    Parameters
    ----------
    space
        Parameter space.
    gram
        S' S.
    present
        Candidates that are present.
    theta_scaled
        Scaled parameters that give the size of `effect`.
    effect, alias
        Candidates to separate.
    """
    columns = list(space.groups[effect])
    information = information_of(space, gram, present, effect, alias, space.prior)
    return float(np.sqrt(max(theta_scaled[columns] @ information @ theta_scaled[columns], 0.0)))


def information_of(
    space: ParameterSpace,
    gram: Annotated[np.ndarray, "parameters parameters"],
    present: Iterable[str],
    effect: str,
    alias: str,
    prior: Prior,
) -> Annotated[np.ndarray, "columns columns"]:
    """Return the information S' (I - Q) S about the parameters of `effect` if `alias` may take any size.

    S holds the whitened slopes of all parameters. Q projects on the alias and the other present effects, free
    under the slab of the prior, and on all other parameters, under the spike. gram: S' S. present: candidates
    that are present.
    """
    columns = list(space.groups[effect])
    others = [i for i in range(len(space.columns)) if i not in columns]
    free = [name for name in present if name != effect]
    precision = prior.precision([*free, effect, alias])
    inner = gram[np.ix_(others, others)] + np.diag(precision[others])
    cross = gram[np.ix_(others, columns)]
    return gram[np.ix_(columns, columns)] - cross.T @ np.linalg.solve(inner, cross)


def propose(
    segment_model: SegmentModel, fit: SegmentFit, effect: str, alias: str, known: Sequence[Manoeuvre]
) -> NextFlight | None:
    """Return the manoeuvre that separates `effect` from `alias` best; None if there is no manoeuvre.

    The separation includes the information of the fitted flights, limited to RULES.undecided_sigma. If one of
    the two acts through an effect that was not selected, such as wind through a drag, that effect is assumed
    present and free, at typical size. So is `effect` itself if it was not selected.

    Parameters
    ----------
    segment_model
        Model of the segments.
    fit
        Fit of the selected set.
    effect, alias
        Candidates to separate.
    known
        Manoeuvres to choose from.
    """
    space = segment_model.space
    carriers = _carriers(space, fit.effects, (effect, alias))
    theta_scaled = fit.theta_scaled.copy()
    for name in (*carriers, *({effect} - set(fit.effects))):
        theta_scaled[list(space.groups[name])] = 1.0
    instruments = Instruments.of(fit)
    present = {*fit.effects, *carriers}

    def sigma(gram: np.ndarray) -> float:
        return separation(space, gram, present, theta_scaled, effect, alias)

    so_far = _flown_information(segment_model, fit, theta_scaled)
    # The search left the alias open, so the flights cannot separate the two by more than undecided_sigma.
    # Segments overestimate the separation, above all of timing effects, since commands contain noise.
    while (before := sigma(so_far)) > RULES.undecided_sigma:
        so_far *= 0.9 * (RULES.undecided_sigma / before) ** 2

    after = space.after_change()
    next_model = (
        segment_model
        if after is space
        else SegmentModel.of(segment_model.vehicle, after, fit.data, jobs=segment_model.jobs)
    )
    best, greatest = None, -1.0
    for candidate in known:
        added = information(next_model, candidate.flat, theta_scaled, instruments)
        if added is None:
            continue
        expected = sigma(so_far + added)
        if expected > greatest:
            best, greatest = candidate, expected
    if best is None:
        return None
    return NextFlight(
        route=best.route,
        total_time_s=best.total_time_s if best.slowed else None,
        separates=(effect, alias),
        so_far_sigma=before,
        expected_sigma=min(greatest, SIGMA_MAX),
        known_measurement=_measurement(space, effect, alias),
    )


def _measurement(space: ParameterSpace, effect: str, alias: str) -> str | None:
    """Return the measurement that separates the two without a flight; either effect may state it."""
    first, second = space.effect(effect), space.effect(alias)
    return first.separated_by.get(second.name) or second.separated_by.get(first.name)


def _flown_information(segment_model: SegmentModel, fit: SegmentFit, theta_scaled: np.ndarray) -> np.ndarray:
    """Return the information (parameters, parameters) of the fitted flights, at theta_scaled."""
    lin = fit.lin
    if not np.array_equal(theta_scaled, fit.theta_scaled):
        lin, _ = linearise.linearise(segment_model, fit.data, theta_scaled, fit.nuisances, fit.basis)
        lin = lin.with_variance_factor(fit.lin.variance_factor)
    return evidence.marginal_grams(lin, fit.process, segment_model.space.prior).gram[1:, 1:]


def _carriers(space: ParameterSpace, selected: Sequence[str], pair: Sequence[str]) -> list[str]:
    """Return the effects to assume present because an effect of `pair` acts through them.

    For each effect of the pair whose required effects are neither selected nor in the pair, that is the first
    required effect that the space holds.
    """
    carriers = []
    for name in pair:
        required = space.effect(name).requires_any
        if required and not set(required) & {*selected, *pair}:
            carriers += [other for other in required if other in space.groups][:1]
    return list(dict.fromkeys(carriers))
