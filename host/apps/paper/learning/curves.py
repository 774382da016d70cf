"""Section V-A: learning curves of Adam from random first weights, and the acceleration errors they end at."""

from __future__ import annotations

from typing import Any

import numpy as np

from trimtab.host.apps.paper.learning.flights import Flights
from trimtab.host.apps.paper.learning.measure import AccelerationError, Candidate, acceleration_error
from trimtab.host.apps.paper.learning.methods import (
    PAPER_EPOCHS,
    PAPER_MLP,
    WORLD,
    exact_segments,
    paper,
    phi_of,
)

SETS = ("train", "test", "ood")
PAPER_RMSE = {"train": (0.684, 0.260), "test": (0.603, 0.173)}
"""m/s^2, nominal and hybrid (section V-A.3)."""

IDENTITY, FIRST_SIX = "identity", "position and velocity"
WEIGHTS = {IDENTITY: np.ones(12), FIRST_SIX: np.repeat([1.0, 0.0], 6)}
"""L of the loss: the paper's, and without attitude and body rate."""


def nominal_errors(sets: dict[str, Flights]) -> dict[str, AccelerationError]:
    """Of the model without drag."""
    bare = phi_of(sets["train"], WORLD)
    candidate = Candidate(phi=bare, theta=bare.theta_neutral)
    return {name: acceleration_error(candidate, sets[name]) for name in SETS}


def trial(
    sets: dict[str, Flights], seed: int, *, weight: str, held: bool, epochs: int = PAPER_EPOCHS
) -> dict[str, Any]:
    """One training: loss by epoch, seconds, errors by set. held: the reference does not move in a step."""
    phi = phi_of(sets["train"], WORLD)
    found = paper(
        phi,
        exact_segments(phi, sets["train"], held=held),
        exact_segments(phi, sets["validation"], held=held),
        seed,
        layout=PAPER_MLP,
        weight=WEIGHTS[weight],
        epochs=epochs,
    )
    assert found.trained is not None
    return {
        "seed": seed,
        "weight": weight,
        "held": held,
        "seconds": found.seconds,
        "train_loss": found.trained.train_loss.tolist(),
        "validation_loss": found.trained.validation_loss.tolist(),
        "errors": {name: acceleration_error(found.candidate, sets[name]).to_json() for name in SETS},
    }
