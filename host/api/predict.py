"""Predict flights with a model, as `trimtab predict` does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trimtab.host.compare.prediction import Prediction
    from trimtab.host.effects import Effect
    from trimtab.host.log import Flight
    from trimtab.host.models.model import Model
    from trimtab.host.workspace import Workspace


def predict(
    model: Model | Path | str | None,
    flights: Sequence[Flight],
    *,
    accept_undecided: bool = False,
    effects: Mapping[str, Effect] | None = None,
    jobs: int | None = None,
    workspace: str | Path | Workspace | None = None,
) -> Prediction:
    """Say how well a model predicts flights, beside the nominal model of the same vehicle.

    Parameters
    ----------
    model
        Model, or the path of its file. None: the nominal model alone.
    flights
        Flights of the model's vehicle, at least one.
    accept_undecided
        Accept a model whose verdict is undecided.
    effects
        Effects by name. Default: the shipped ones and those of the workspace.
    jobs
        Threads that work on flights. Default: the number of cores. The result does not depend on it.
    workspace
        Folder with effects of yours. Default: the current folder.

    Returns
    -------
    Prediction
        Position error (m) of each flight and of all together, with the model and without it, and the paired
        difference with its interval.

    Raises
    ------
    LogsRefused
        If the flights cannot be used together.
    TooLittleData
        If a flight is too short to predict.
    UsageError
        If no flight is given; if the model is undecided, of another vehicle, or has an effect that is not
        known; if it has a network and a log lacks what the network needs.
    """
    from trimtab.host.api.load import load_effects
    from trimtab.host.compare.prediction import predict as errors_of
    from trimtab.host.models.accepted import accepted_model

    chosen = None
    if model is not None and flights:
        chosen = accepted_model(model, accept_undecided, vehicle_id=flights[0].vehicle.id)
    effects = load_effects(workspace) if effects is None else effects
    return errors_of(chosen, flights, effects, jobs=jobs)
