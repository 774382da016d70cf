"""The network on what no effect explains: it predicts, it names nothing."""

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
"""Smaller and shorter than `trimtab learn` takes by default: some ten seconds for four flights."""

DIRECTED = ("position", "time", "attitude", "constant")
"""Groups whose force has a direction in the world: a flight is then not as good in any heading."""


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """Errors of whole held-out flights with the model that is kept and with the network on it, and the
    network's model; None where it predicts no better.
    """

    before: Errors
    after: Errors
    model: Model | None

    def to_json(self, model_path: str | None) -> dict[str, Any]:
        """Return the value of `unexplained`."""
        return {"before": self.before.to_json(), "after": self.after.to_json(), "model": model_path}


def unexplained(
    flights: Sequence[Flight],
    held_out: Sequence[Flight],
    model: Model,
    effects: Mapping[str, Effect],
    description: Description,
    report: Callable[[str], None] = lambda _: None,
) -> Unexplained | None:
    """Return a network learned over `model` from the flights used, judged on those held out.

    None where nothing was held out, or where the logs are too little to learn from.
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
            on_epoch=lambda epoch, _: report(f"network on what is left, {epoch} of at most {epochs} epochs"),
        )
    except TooLittleData:
        return None
    assert learned.test is not None
    kept = learned.model if learned.improved else None
    return Unexplained(before=learned.test.base, after=learned.test.learned, model=kept)
