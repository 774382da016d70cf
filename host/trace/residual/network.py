"""The network trained on the unexplained residual: it predicts the residual but names no cause."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trimtab.host.effects import Effect
from trimtab.host.learn import Settings, learn
from trimtab.host.learn.evaluate import Errors
from trimtab.host.log import Flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.model import Model
from trimtab.host.trace.residual.description import Description

SETTINGS = {"hidden": (16,), "epochs": 40, "patience": 20}
"""Smaller than the defaults of `trimtab learn`, so that training takes about 10 s for four flights."""

DIRECTED = ("position", "time", "attitude", "constant")
"""Groups whose force has a direction in the world. Flights then must not be rotated to other headings."""


@dataclass(frozen=True, kw_only=True)
class NetworkResult:
    """Result of training a network on the unexplained residual.

    before, after: errors on whole held-out flights with the traced model, and with the network added to it.
    model: traced model with the network; None if it predicts no better.
    """

    before: Errors
    after: Errors
    model: Model | None

    def to_json(self, model_path: str | None) -> dict[str, Any]:
        """Return the JSON object `unexplained`; model_path: file of the model, None if none was written."""
        return {"before": self.before.to_json(), "after": self.after.to_json(), "model": model_path}


def train_network(
    flights: Sequence[Flight],
    held_out: Sequence[Flight],
    model: Model,
    effects: Mapping[str, Effect],
    description: Description,
    on_progress: Callable[[str], None] = lambda _: None,
) -> NetworkResult | None:
    """Train a network on the residual of `model` and judge it on held-out flights.

    Returns None if no flight is held out or the logs are too short to learn from.

    Parameters
    ----------
    flights, held_out
        Logs for training and for judging.
    model
        Traced model that the network is added to.
    effects
        Effects of that model by name.
    description
        Description of the residual. It decides whether training may rotate flights to other headings.
    on_progress
        Called with a text after each epoch.
    """
    if not held_out:
        return None
    epochs = SETTINGS["epochs"]
    settings = Settings(**SETTINGS, any_heading=description.force.group not in DIRECTED)
    try:
        learned = learn(
            flights,
            hold_out=held_out,
            base=model,
            effects=effects,
            settings=settings,
            as_asked=True,
            provenance=model.provenance,
            on_epoch=lambda epoch, _: on_progress(f"network: epoch {epoch} of at most {epochs}"),
        )
    except TooLittleData:
        return None
    assert learned.test is not None
    improved = learned.model if learned.improved else None
    return NetworkResult(before=learned.test.base, after=learned.test.learned, model=improved)
