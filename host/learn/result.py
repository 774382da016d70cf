"""The result of learning as typed data, and its JSON object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from trimtab.host.base.card import card, simulated_badge, table
from trimtab.host.learn.candidates import Trial
from trimtab.host.learn.evaluate import Errors
from trimtab.host.learn.quick import CondensedTrained
from trimtab.host.learn.train import Trained
from trimtab.host.models.model import Model


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Errors on one set of flights: of whole flights, or over AHEAD_S if `drive` is "inputs".

    nominal: of the vehicle file alone. base: with the effects of the model learned upon; equal to nominal
    without one. learned: of the selected model. outside: share of samples outside the model's region.
    """

    flights: tuple[str, ...]
    references: tuple[str, ...]
    nominal: Errors
    base: Errors
    learned: Errors
    outside: float
    drive: Literal["reference", "inputs"] = "reference"

    @property
    def ratio(self) -> float:
        """Position error with the learned model over that without it."""
        return self.learned.position_rmse_m / self.base.position_rmse_m

    def to_json(self) -> dict[str, Any]:
        """Return all the errors, and which flights they are of."""
        return {
            **self.learned.to_json(),
            "nominal": self.nominal.to_json(),
            "base": self.base.to_json(),
            "drive": self.drive,
            "outside_region": self.outside,
            "flights": list(self.flights),
            "references": list(self.references),
        }


@dataclass(frozen=True, kw_only=True)
class Learned:
    """The selected model and its errors.

    Attributes
    ----------
    model
        The selected model: that of `selected`.
    train, test
        Errors on the flights used and on those held out: position in m, velocity in m/s. `test` is None where
        nothing was held out.
    trials
        The candidates, from nothing learned to everything asked for, with the errors that decide.
    selected
        The trial of the model.
    trained
        The training of everything asked for.
    segments
        Number of segments that were fitted.
    forms
        Names of the effects that were to be learned beside the network.
    log_latency_s
        How much older poses are than stamped in the log, s; None where that was not learned.
    notes
        Why less was selected than was asked for, and what was left out of the logs.
    flights, simulated_flights
        Number of flights, used and held out, and how many of them are known to be simulated.
    """

    model: Model
    train: Judged
    test: Judged | None
    trials: tuple[Trial, ...]
    selected: Trial
    trained: Trained | CondensedTrained
    segments: int
    forms: tuple[str, ...] = ()
    log_latency_s: float | None = None
    notes: tuple[str, ...] = ()
    flights: int = 0
    simulated_flights: int = 0

    @property
    def is_written(self) -> bool:
        """Whether the model holds more than it began with, so that it is worth writing."""
        return self.selected.what != "nothing"

    @property
    def learned_effects(self) -> dict[str, Mapping[str, float]]:
        """Values of the effects that were learned, by name and key, in the units of their parameters."""
        return {name: self.model.effects[name] for name in self.forms if self.is_written}

    def to_dict(self, *, path: Path | str | None = None) -> dict[str, Any]:
        """Return the object that `trimtab learn --json` prints, without its `seconds`, as plain data.

        path: file of the model; None if it was not written. If nothing was learned, model and verdict are
        None.
        """
        assessment = self.model.assessment
        assert assessment is not None
        return {
            "model": str(path) if path is not None and self.is_written else None,
            "model_id": self.model.id if self.is_written else None,
            "verdict": assessment.verdict if self.is_written else None,
            "train": self.train.to_json(),
            "test": None if self.test is None else self.test.to_json(),
            "improved": self.improved,
            "kept": self.selected.what,
            "candidates": [trial.to_json() for trial in self.trials],
            "effects": {name: dict(values) for name, values in self.learned_effects.items()},
            "epochs": self.trained.epochs,
            "log_latency_s": self.log_latency_s if self.is_written else None,
            "notes": list(self.notes),
        }

    def __repr__(self) -> str:
        return f"<Learned {self.selected.what}, model {self.model.id}>"

    def _repr_html_(self) -> str:
        judged = [("used", self.train), *([] if self.test is None else [("held out", self.test)])]
        return card(
            f"Learned: {self.selected.what}",
            [
                ("vehicle", self.model.vehicle_name),
                ("model", self.model.id),
                *(("note", note) for note in self.notes),
            ],
            table(
                ("flights", "number", "position error before, m", "after, m", "outside the region"),
                [
                    (name, len(of.flights), of.base.position_rmse_m, of.learned.position_rmse_m, of.outside)
                    for name, of in judged
                ],
            ),
            table(
                ("effect", "parameter", "value"),
                [
                    (name, key, value)
                    for name, values in self.learned_effects.items()
                    for key, value in values.items()
                ],
            ),
            badge=simulated_badge(self.simulated_flights, self.flights),
        )

    @property
    def improved(self) -> bool:
        """Whether the model improves the prediction, both of the flights used and of those held out."""
        return improves(self.train, self.test)


def improves(train_errors: Judged, test: Judged | None) -> bool:
    """Return whether a model predicts both better than what it began with."""
    return all(judged.ratio < 1.0 for judged in (train_errors, test) if judged is not None)
