"""`trimtab predict`: how well a model predicts flights."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.verbs.options import AcceptUndecided, Json, Trust, WorkspaceFolder

NOMINAL = "nominal"
"""Word for the nominal model in place of a model file."""


def command(
    model: Path,
    *logs: Path,
    accept_undecided: AcceptUndecided = False,
    workspace: WorkspaceFolder = None,
    trust: Trust = False,
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
    from trimtab.host.api.predict import predict
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say, warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.compare.prediction_words import lines, notes
    from trimtab.host.log import read_flight
    from trimtab.host.workspace import open_workspace

    if not logs:
        raise UsageError("no log given; name one or more flight logs after the model")
    effects = open_workspace(workspace, trusted=trust).effects()
    with Progress("predicting"):
        flights = [read_flight(path) for path in logs]
        chosen = None if str(model) == NOMINAL else model
        result = predict(chosen, flights, accept_undecided=accept_undecided, effects=effects)
    for note in notes(result):
        warn(note)
    say(*lines(result, str(model)))
    emit({"model_file": None if chosen is None else str(model), **result.to_dict()}, json)
