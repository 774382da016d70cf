"""`trimtab predict`: how well a model predicts flights."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.verbs.options import AcceptUndecided, Json, WorkspaceFolder, accepted_model

NOMINAL = "nominal"
"""Word for the nominal model in place of a model file."""


def command(
    model: Path,
    *logs: Path,
    accept_undecided: AcceptUndecided = False,
    workspace: WorkspaceFolder = None,
    json: Json = False,
) -> None:
    """Tell how well a model predicts flights, beside the nominal model of the same vehicle.

    Parameters
    ----------
    model
        Model file that `trace` or `learn` wrote, or the word `nominal`: the vehicle file alone.
    logs
        Flight logs of the model's vehicle.
    """
    from trimtab.host.base.parallel import one_thread_of_algebra

    one_thread_of_algebra()

    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say, warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.compare.prediction import predict
    from trimtab.host.compare.prediction_words import lines, notes
    from trimtab.host.effects import load_effects
    from trimtab.host.log import read_flight
    from trimtab.host.workspace import open_workspace

    if not logs:
        raise UsageError("no log given; name one or more flight logs after the model")
    space = open_workspace(workspace)
    with Progress("predicting"):
        flights = [read_flight(path) for path in logs]
        chosen = None
        if str(model) != NOMINAL:
            chosen = accepted_model(model, accept_undecided, vehicle_id=flights[0].vehicle.id)
        result = predict(chosen, flights, load_effects(space.root))
    for note in notes(result):
        warn(note)
    say(*lines(result, str(model)))
    emit({"model_file": None if chosen is None else str(model), **result.to_dict()}, json)
