"""Learning on the condensed loss: condense, fit, and condense again about what was learned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from trimtab.host.learn.adjoint import loss_of
from trimtab.host.learn.condensed import DELAY_S, condense, latency_s
from trimtab.host.learn.fit import Basis, Examples, Fitted, accelerations, fit
from trimtab.host.learn.lanes import rollouts
from trimtab.host.learn.linear import effect_scales
from trimtab.host.learn.starts import start_sigma
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments

_COPIES = 4
"""Headings that every segment counts in, where a network sees the world's frame."""

_HELD = 1e-6
"""Of its sigma is what a start moves that is taken as measured."""

_SMALLEST = Layout(hidden=(1,))
"""Of roll-outs without a network."""


@dataclass(frozen=True, kw_only=True)
class CondensedSettings:
    """How to learn. layout None: effects alone. l2 is on the weights, for a loss of unit mean diagonal.

    A pass condenses about what the last one learned; `patience` iterations without a better validation loss
    end it. free_start: segments start where they fit best, not as measured. delay: estimate how much
    later the poses are than stamped.
    """

    layout: Layout | None = field(default_factory=lambda: Layout(hidden=(32, 32)))
    iterations: int = 300
    patience: int = 40
    passes: int = 2
    l2: float = 1e-5
    any_heading: bool = True
    free_start: bool = True
    delay: bool = False

    def __post_init__(self) -> None:
        if min(self.iterations, self.patience, self.passes) < 1 or self.l2 < 0.0:
            raise ValueError(f"iterations, patience and passes must be positive, l2 not negative: {self}")


@dataclass(frozen=True, kw_only=True, eq=False)
class CondensedTrained:
    """What was learned, the last pass, and true roll-outs' loss of validation before and after, from free
    starts in neither.
    """

    network: Network | None
    theta: np.ndarray
    delay_s: float
    fitted: tuple[Fitted, ...]
    before: float
    after: float

    @property
    def epochs(self) -> int:
        """Iterations of all passes."""
        return sum(each.iterations for each in self.fitted)


def train_condensed(
    phi: Phi,
    theta: np.ndarray,
    segments: Segments,
    validation: Segments,
    settings: CondensedSettings,
    rng: np.random.Generator,
    *,
    weight: np.ndarray,
    free: Sequence[int] | None = None,
    on_iteration: Callable[[int, float], None] | None = None,
) -> CondensedTrained:
    """Return the residual of phi learned from `segments`: its effects' parameters, begun at theta (P,), a
    network.

    The measured states were taken to be as late as theta has it.

    weight (12,): diagonal L of the loss. free: which of theta are learned; default all. `on_iteration` hears
    how many iterations of all passes were made, and the validation loss.
    """
    chosen = np.arange(len(theta)) if free is None else np.array(free, dtype=int)
    scale = effect_scales(phi)[chosen]
    basis = Basis(layout=settings.layout, parameters=len(chosen), delay=settings.delay)
    engine = rollouts(phi, _SMALLEST, theta, batch=1, step_s=segments.step_s, weight=weight)
    start = np.zeros(basis.size)
    if settings.layout is not None:
        start[: basis.weights] = settings.layout.initial(rng)
    begun = (theta - phi.theta_neutral)[chosen] / scale
    start[basis.weights : basis.weights + len(chosen)] = begun
    turned = settings.layout is not None and settings.layout.frame == "world" and settings.any_heading
    headings = rng.uniform(-np.pi, np.pi, (_COPIES, segments.count)) if turned else None
    found: list[Fitted] = []
    network, learned, delay_s = np.zeros(basis.weights), theta.copy(), 0.0
    for turn in range(settings.passes):

        def heard(iteration: int, loss: float, turn: int = turn) -> None:
            if on_iteration is not None:
                on_iteration(turn * settings.iterations + iteration, loss)

        fitted_on, checked_on = (
            Examples(
                condensed=condense(
                    engine,
                    part,
                    weight=weight,
                    start_sigma=start_sigma(phi, part) * (1.0 if settings.free_start else _HELD),
                    acceleration=accelerations(basis, network, part.measured[:, :, 3:9]),
                    theta=learned,
                    free=chosen.tolist(),
                    delay_s=delay_s,
                    taken_s=latency_s(phi, theta),
                ),
                states=part.measured[:, :, 3:9],
            )
            for part in (segments, validation)
        )
        found.append(
            fit(
                basis,
                fitted_on,
                checked_on,
                start,
                iterations=settings.iterations,
                patience=settings.patience,
                l2=settings.l2,
                headings=headings,
                on_iteration=heard,
            )
        )
        network, delay_s = found[-1].xi, found[-1].delay_s
        learned[chosen] = phi.theta_neutral[chosen] + scale * found[-1].eta
        start = np.concatenate([network, found[-1].eta, [delay_s / DELAY_S] * settings.delay])
    whole = None if settings.layout is None else Network(layout=settings.layout, xi=network)
    return CondensedTrained(
        network=whole,
        theta=learned,
        delay_s=delay_s,
        fitted=tuple(found),
        before=rolled_loss(phi, theta, None, validation, weight),
        after=rolled_loss(phi, learned, whole, validation, weight),
    )


def rolled_loss(
    phi: Phi, theta: np.ndarray, network: Network | None, segments: Segments, weight: np.ndarray
) -> float:
    """Mean loss of true roll-outs from the segments' measured starts; infinite where one diverges."""
    layout = _SMALLEST if network is None else network.layout
    xi = np.zeros(layout.size) if network is None else network.xi
    engine = rollouts(phi, layout, theta, batch=segments.count, step_s=segments.step_s, weight=weight)
    total = loss_of(segments, engine.roll_out(segments, segments.x0, xi), weight)
    return total / segments.count if np.isfinite(total) else float("inf")
