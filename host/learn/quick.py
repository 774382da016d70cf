"""Learning on the condensed loss: condense, fit, and condense again about the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.learn.adjoint import loss_of
from trimtab.host.learn.condensed import DELAY_S, CondensedSettings, condense, knots, latency_s
from trimtab.host.learn.fit import Basis, Examples, Fitted, accelerations, fit, initial
from trimtab.host.learn.lanes import rollouts
from trimtab.host.learn.linear import effect_scales
from trimtab.host.learn.starts import start_sigma
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments

_COPIES = 4
"""Headings that every segment is turned to, for a network in the world's frame."""

_FIXED_START = 1e-6
"""Share of its sigma that a start may move where it is taken as measured."""

_SMALLEST = Layout(hidden=(1,))
"""Layout of roll-outs without a network."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CondensedTrained:
    """The learned network, parameters and delay, and the fit of each pass.

    before, after: validation loss of true roll-outs from the measured starts, without and with the result.
    """

    network: Network | None
    theta: Annotated[np.ndarray, "parameters"]
    delay_s: float
    fitted: tuple[Fitted, ...]
    before: float
    after: float

    @property
    def epochs(self) -> int:
        """Number of iterations of all passes."""
        return sum(each.iterations for each in self.fitted)


def train_condensed(  # noqa: PLR0913 (the data of one problem)
    phi: Phi,
    theta: Annotated[np.ndarray, "parameters"],
    segments: tuple[Segments, Segments],
    settings: CondensedSettings,
    rng: np.random.Generator,
    *,
    weight: Annotated[np.ndarray, "12"],
    free: Sequence[int] | None = None,
    jobs: int = 1,
    on_iteration: Callable[[int, float], None] | None = None,
) -> CondensedTrained:
    """Return the residual of phi learned from segments: parameters of its effects and a network.

    segments: to learn from, and for validation. theta: parameters to begin at; the measured states have the
    latency that it gives. weight: diagonal L of the loss. free: indices of theta that are learned; default
    all but the forms of effects. jobs: threads; the result does not depend on them. on_iteration: called with
    the number of iterations of all passes so far, and the validation loss.
    """
    train_on, validation = segments
    chosen = np.array(phi.learnable if free is None else free, dtype=int)
    scale = effect_scales(phi)[chosen]
    basis = Basis(layout=settings.layout, parameters=len(chosen), delay=settings.delay)
    start = np.zeros(basis.size)
    if settings.layout is not None:
        start[: basis.weights] = initial(settings.layout, rng)
    start[basis.weights : basis.weights + len(chosen)] = (theta - phi.theta_neutral)[chosen] / scale
    headings = random_headings(settings, train_on.count, rng)
    condenser = _Condenser(phi, theta, basis, chosen, settings, train_on.step_s, weight, jobs)
    fits: list[Fitted] = []
    network, learned, delay_s = np.zeros(basis.weights), theta.copy(), 0.0
    for turn in range(settings.passes):

        def report(iteration: int, loss: float, turn: int = turn) -> None:
            if on_iteration is not None:
                on_iteration(turn * settings.iterations + iteration, loss)

        fitted = fit(
            basis,
            condenser.examples(train_on, network, learned, delay_s),
            condenser.examples(validation, network, learned, delay_s),
            start,
            settings,
            headings=headings,
            jobs=jobs,
            on_iteration=report,
        )
        fits.append(fitted)
        network, delay_s = fitted.xi, fitted.delay_s
        learned[chosen] = phi.theta_neutral[chosen] + scale * fitted.eta
        start = np.concatenate([network, fitted.eta, [delay_s / DELAY_S] * settings.delay])
    whole = None if settings.layout is None else Network(layout=settings.layout, xi=network)
    return CondensedTrained(
        network=whole,
        theta=learned,
        delay_s=delay_s,
        fitted=tuple(fits),
        before=rolled_loss(phi, theta, None, validation, weight),
        after=rolled_loss(phi, learned, whole, validation, weight),
    )


def random_headings(
    settings: CondensedSettings, count: int, rng: np.random.Generator
) -> Annotated[np.ndarray, "copies segments"] | None:
    """Return the headings, rad, that segments are turned to; None where they are not turned."""
    layout = settings.layout
    if layout is None or layout.frame != "world" or not settings.any_heading:
        return None
    return rng.uniform(-np.pi, np.pi, (_COPIES, count))


class _Condenser:
    """Condenses the loss of segments about a model learned so far."""

    def __init__(
        self,
        phi: Phi,
        theta: np.ndarray,
        basis: Basis,
        free: np.ndarray,
        settings: CondensedSettings,
        step_s: float,
        weight: np.ndarray,
        jobs: int,
    ) -> None:
        self._phi, self._basis, self._free, self._jobs = phi, basis, free.tolist(), jobs
        self._engine = rollouts(phi, _SMALLEST, theta, batch=1, step_s=step_s, weight=weight)
        self._latency_s = latency_s(phi, theta)
        self._start_share = 1.0 if settings.free_start else _FIXED_START

    def examples(
        self, segments: Segments, network: np.ndarray, theta: np.ndarray, delay_s: float
    ) -> Examples:
        """Return the segments' condensed loss about these weights, parameters and delay."""
        states = segments.measured[:, knots(segments.steps + 1), 3:9]
        condensed = condense(
            self._engine,
            segments,
            start_sigma=start_sigma(self._phi, segments) * self._start_share,
            acceleration=accelerations(self._basis, network, states),
            theta=theta,
            free=self._free,
            delay_s=delay_s,
            taken_s=self._latency_s,
            jobs=self._jobs,
        )
        return Examples(condensed=condensed, states=states)


def rolled_loss(
    phi: Phi,
    theta: Annotated[np.ndarray, "parameters"],
    network: Network | None,
    segments: Segments,
    weight: Annotated[np.ndarray, "12"],
) -> float:
    """Return the mean loss of true roll-outs from the segments' measured starts; infinite if one diverges."""
    layout = _SMALLEST if network is None else network.layout
    xi = np.zeros(layout.size) if network is None else network.xi
    engine = rollouts(phi, layout, theta, batch=segments.count, step_s=segments.step_s, weight=weight)
    total = loss_of(segments, engine.roll_out(segments, segments.x0, xi), weight)
    return total / segments.count if np.isfinite(total) else float("inf")
