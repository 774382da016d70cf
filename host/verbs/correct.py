"""`trimtab correct`: make a feed-forward that compensates a model on board."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import AcceptUndecided, Force, Json, Trust, WorkspaceFolder


def command(
    model: Path,
    *,
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    accept_undecided: AcceptUndecided = False,
    workspace: WorkspaceFolder = None,
    trust: Trust = False,
    json: Json = False,
    force: Force = False,
) -> None:
    """Make a feed-forward that compensates a model's effects and network on board.

    Parameters
    ----------
    model
        Model file that `trace` or `learn` wrote.
    output
        Feed-forward to write. Default: NAME.ff, with the name of the model file.
    vehicle
        Vehicle file, by name or path. Default: the one that the model names.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import GateMissed, UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.models.accepted import accepted_model
    from trimtab.host.models.correction import SUFFIX, check_name, correction, write_correction
    from trimtab.host.models.file import SUFFIX as MODEL_SUFFIX
    from trimtab.host.workspace import open_workspace

    space = open_workspace(workspace, trusted=trust)
    content = accepted_model(model, accept_undecided)
    airframe = space.vehicle(content.vehicle_name if vehicle is None else vehicle)
    if airframe.id != content.vehicle_id:
        raise UsageError(
            f"{model}: is of vehicle {content.vehicle_name} ({content.vehicle_id}), not of {airframe.name} "
            f"({airframe.id}); give its vehicle file with --vehicle"
        )
    target = check_name(output or Path(model.name.removesuffix(MODEL_SUFFIX) + SUFFIX), force)
    try:
        made = correction(content, airframe, space.effects())
    except ValueError as error:
        raise UsageError(f"{model}: {error}; give the folder with its effects with --workspace") from None
    named = {name: how for name, how in made.corrected.items() if name not in content.adjustments}
    lines = [f"{name}: corrected, {how}" for name, how in named.items()]
    lines += [f"{name}: not corrected, {why}" for name, why in made.uncorrected.items()]
    if adjusted := [name for name in made.corrected if name not in named]:
        lines.append(f"also corrected, though not named by a trace: {', '.join(adjusted)}")
    if made.feedforward is None:
        raise GateMissed("; ".join([f"{model}: nothing in it can be corrected on board", *lines]))
    if made.excess is not None:
        quantity, value, bound = made.excess
        raise GateMissed(
            f"{model}: {quantity} {value:.4g} is beyond {bound:g}, which vehicles refuse; "
            "give more flights, or correct the vehicle file"
        )
    parents = {"vehicle": airframe.id, "model": content.id}
    write_correction(
        made.feedforward,
        target,
        contents=made,
        provenance=artefacts.provenance(parents=parents),
        force=force,
    )
    say(f"{target}  id {made.feedforward.id}", *lines)
    assessment = content.assessment
    emit(
        {
            "feedforward": str(target),
            "feedforward_id": made.feedforward.id,
            "model_id": content.id,
            "verdict": None if assessment is None else assessment.verdict,
            **made.to_json(),
        },
        json,
    )
