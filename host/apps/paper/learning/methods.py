"""The learners that the study compares, each from segments to a candidate, timed."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from trimtab.host.apps.paper.learning.flights import Flights
from trimtab.host.apps.paper.learning.measure import Candidate
from trimtab.host.learn.condensed import CondensedSettings
from trimtab.host.learn.quick import train_condensed
from trimtab.host.learn.train import Settings, Trained, train
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments

WEIGHT = 1.0 / np.square(np.repeat([1e-3, 0.02, 5e-3, 0.02], 3))
"""Of the loss on exact data: 1/sigma^2 of a motion capture, m, m/s, rad, rad/s."""

EXACT = np.full(12, 1e-6)
"""Sigma of exact data: starts stay where they are."""

PAPER_EPOCHS, PAPER_BATCH, PAPER_RATE = 100, 10, 1e-2
LONG, SHORT = 1000, 300
"""Iterations of L-BFGS."""


@dataclass(frozen=True, kw_only=True)
class Regressor:
    """What is learned: a network of this layout (None: none), and linear drag's three numbers or not."""

    name: str
    layout: Layout | None
    closed_form: bool


PAPER_MLP = Layout(hidden=(32, 32))
"""Of section V-A."""

WORLD = Regressor(name="MLP 2 x 32 of the paper", layout=PAPER_MLP, closed_form=False)
DEEP = Regressor(name="MLP 3 x 32 of the paper", layout=Layout(hidden=(32, 32, 32)), closed_form=False)
BODY = Regressor(
    name="MLP 2 x 32 on body velocity", layout=Layout(hidden=(32, 32), frame="body"), closed_form=False
)
CLOSED = Regressor(name="closed form, 3 parameters", layout=None, closed_form=True)
BOTH = Regressor(
    name="closed form + MLP on body velocity",
    layout=Layout(hidden=(32, 32), frame="body"),
    closed_form=True,
)
REGRESSORS = (WORLD, DEEP, BODY, CLOSED, BOTH)


@dataclass(frozen=True, kw_only=True, eq=False)
class Timed:
    """A candidate, how long its learning took, and the paper's training where that was the method."""

    candidate: Candidate
    seconds: float
    trained: Trained | None = None


def phi_of(flights: Flights, regressor: Regressor) -> Phi:
    """Return the model that learns: that of the flights, with its drag to be found, or without."""
    known = flights.phi
    return Phi(
        vehicle=known.vehicle,
        effects=known.effects if regressor.closed_form else (),
        estimator=False,
        parameters=known.parameters,
    )


def exact_segments(phi: Phi, flights: Flights, *, held: bool = False) -> Segments:
    """Segments of the flights' own states."""
    return flights.segments(phi, measured=flights.x[..., :12], sigma=EXACT, held=held)


def patience_of(iterations: int) -> int:
    """Return the iterations without a better validation loss that end one pass of so many."""
    return max(40, iterations // 5)


def paper(
    phi: Phi,
    train_on: Segments,
    validation: Segments,
    seed: int,
    *,
    layout: Layout,
    weight: np.ndarray,
    epochs: int = PAPER_EPOCHS,
) -> Timed:
    """Algorithms 1 and 2 with Adam, as set up in section V-A; measured starts, headings as flown."""
    settings = Settings(
        hidden=layout.hidden,
        epochs=epochs,
        patience=epochs,
        batch=PAPER_BATCH,
        rate=PAPER_RATE,
        l2=0.0,
        any_heading=False,
        free_start=False,
    )
    rng = np.random.default_rng(seed)
    began = perf_counter()
    trained = train(phi, phi.theta_neutral, train_on, validation, settings, rng, weight=weight)
    seconds = perf_counter() - began
    candidate = Candidate(phi=phi, theta=phi.theta_neutral, network=trained.network)
    return Timed(candidate=candidate, seconds=seconds, trained=trained)


def condensed_settings(
    layout: Layout | None,
    iterations: int = SHORT,
    *,
    l2: float = 1e-6,
    free_start: bool = True,
    passes: int = 2,
) -> CondensedSettings:
    """Return the settings of the condensed loss: headings as flown, patience by the iterations."""
    return CondensedSettings(
        layout=layout,
        passes=passes,
        iterations=iterations,
        patience=patience_of(iterations),
        l2=l2,
        any_heading=False,
        free_start=free_start,
    )


def condensed(
    phi: Phi,
    train_on: Segments,
    validation: Segments,
    seed: int,
    settings: CondensedSettings,
    *,
    weight: np.ndarray,
) -> Timed:
    """Return what the condensed loss with L-BFGS learns."""
    rng = np.random.default_rng(seed)
    began = perf_counter()
    found = train_condensed(phi, phi.theta_neutral, (train_on, validation), settings, rng, weight=weight)
    seconds = perf_counter() - began
    candidate = Candidate(phi=phi, theta=found.theta, network=found.network)
    return Timed(candidate=candidate, seconds=seconds)


def learn_exact(
    train_on: Flights,
    validation: Flights,
    regressor: Regressor,
    seed: int,
    *,
    iterations: int,
    l2: float = 1e-6,
) -> Timed:
    """Return a regressor learned by the condensed loss from the flights' own states."""
    phi = phi_of(train_on, regressor)
    return condensed(
        phi,
        exact_segments(phi, train_on),
        exact_segments(phi, validation),
        seed,
        condensed_settings(regressor.layout, iterations, l2=l2),
        weight=WEIGHT,
    )
