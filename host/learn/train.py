"""Paper Algorithm 2: mini-batches of segments, gradients by roll-out and adjoint, Adam."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from trimtab.host.learn.adam import Adam
from trimtab.host.learn.adjoint import Rollouts, loss_of
from trimtab.host.learn.lanes import LaneRollouts, rollouts
from trimtab.host.learn.starts import free_starts
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments

LOSS_SIGMA = (5e-3, 5e-3, 5e-3, 0.02, 0.02, 0.02, 0.01, 0.01, 0.01, 0.1, 0.1, 0.1)
"""m, m/s, rad, rad/s: error of a roll-out of a second by turbulence and sensors. Weights are 1/sigma^2."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How to train. `rate` decays to a hundredth over `epochs`; `l2` penalises the weights, per segment."""

    hidden: tuple[int, ...] = (32, 32)
    epochs: int = 120
    batch: int = 16
    rate: float = 1e-2
    l2: float = 1e-3
    patience: int = 40
    """Epochs without a better validation loss before training ends."""
    any_heading: bool = True
    """Turn every segment about the vertical by a random angle at each use; flights have few headings."""
    free_start: bool = True
    """Move every segment's start to where it fits best; otherwise it is as measured, as in the paper."""

    def __post_init__(self) -> None:
        if min(self.epochs, self.batch, self.patience) < 1 or not (self.rate > 0.0 and self.l2 >= 0.0):
            raise ValueError(f"epochs, batch, patience and rate must be positive, l2 not negative: {self}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Trained:
    """The network of least validation loss, and the losses of training and validation by epoch.

    Validation's first loss is that without a residual.
    """

    network: Network
    epochs: int
    best_epoch: int
    train_loss: Annotated[np.ndarray, "epochs"]
    validation_loss: Annotated[np.ndarray, "checks"]


def train(
    phi: Phi,
    theta: Annotated[np.ndarray, "parameters"],
    segments: Segments,
    validation: Segments,
    settings: Settings,
    rng: np.random.Generator,
    *,
    weight: Annotated[np.ndarray, "12"],
    on_epoch: Callable[[int, float], None] | None = None,
) -> Trained:
    """Return the residual d(x, xi) for phi with its effects at `theta`, learned from `segments`.

    Each mini-batch first moves the starts of its segments to where they fit best, then takes the gradient
    there (starts at their optimum add nothing to it). Training stops early by the loss of `validation`, from
    its measured starts. weight: diagonal L of the loss.
    """
    layout = Layout(hidden=settings.hidden)
    batch = min(settings.batch, segments.count)
    engine = rollouts(phi, layout, theta, batch=batch, step_s=segments.step_s, weight=weight)
    starts = free_starts(engine, theta, segments, weight) if settings.free_start else None
    shift = np.zeros((segments.count, phi.size))
    batches = -(-segments.count // batch)
    adam = Adam(layout.initial(rng), rate=settings.rate, steps=settings.epochs * batches)

    best_xi, best_epoch = np.zeros(layout.size), 0
    losses, checks = [], [_loss(engine, batch, validation, best_xi)]
    for epoch in range(1, settings.epochs + 1):
        order = rng.permutation(segments.count)
        total = 0.0
        for first in range(0, segments.count, batch):
            chosen = order[first : first + batch]
            part = segments.take(chosen)
            if starts is not None:
                x0 = part.x0 + shift[chosen] * starts.sigma[chosen]
                states = engine.roll_out(part, x0, adam.x)[1:, :, :12].transpose(1, 0, 2)
                shift[chosen] = starts.refine(chosen, shift[chosen], part.measured[:, 1:] - states)
                part = replace(part, x0=part.x0 + shift[chosen] * starts.sigma[chosen])
            if settings.any_heading:
                part = part.turned(rng.uniform(-np.pi, np.pi, len(chosen)))
            gradient = engine.gradient(part, part.x0, adam.x)
            total += gradient.loss
            adam.step(gradient.xi / len(chosen) + 2.0 * settings.l2 * adam.x)
        losses.append(total / segments.count)
        checks.append(_loss(engine, batch, validation, adam.x))
        if checks[-1] < checks[best_epoch]:
            best_xi, best_epoch = adam.x.copy(), epoch
        if on_epoch is not None:
            on_epoch(epoch, checks[-1])
        if epoch - best_epoch >= settings.patience:
            break
    return Trained(
        network=Network(layout=layout, xi=best_xi),
        epochs=len(losses),
        best_epoch=best_epoch,
        train_loss=np.array(losses),
        validation_loss=np.array(checks),
    )


def _loss(engine: Rollouts | LaneRollouts, batch: int, segments: Segments, xi: np.ndarray) -> float:
    """Return the mean loss of segments from their measured starts; infinite where a roll-out diverges."""
    total = 0.0
    for first in range(0, segments.count, batch):
        part = segments.take(np.arange(first, min(first + batch, segments.count)))
        total += loss_of(part, engine.roll_out(part, part.x0, xi), engine.weight)
    return total / segments.count if np.isfinite(total) else float("inf")
