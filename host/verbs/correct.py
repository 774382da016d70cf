"""`trimtab correct`: make a feed-forward that compensates a model on board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.models.model import Model


def command(
    model: Path,
    *,
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    accept_undecided: Annotated[bool, Parameter(name="--accept-undecided", negative="")] = False,
    workspace: WorkspaceFolder = None,
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
    accept_undecided
        Also correct a model whose verdict is undecided.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import GateMissed, UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.effects import load_effects
    from trimtab.host.models.correction import SUFFIX, check_name, correction, write_correction
    from trimtab.host.models.file import SUFFIX as MODEL_SUFFIX
    from trimtab.host.models.file import read_model
    from trimtab.host.workspace import open_workspace

    space = open_workspace(workspace)
    content = read_model(model)
    airframe = space.vehicle(content.vehicle_name if vehicle is None else vehicle)
    if airframe.id != content.vehicle_id:
        raise UsageError(
            f"{model}: is of vehicle {content.vehicle_name} ({content.vehicle_id}), not of {airframe.name} "
            f"({airframe.id}); give its vehicle file with --vehicle"
        )
    _check_verdict(model, content, accept_undecided)
    target = check_name(output or Path(model.name.removesuffix(MODEL_SUFFIX) + SUFFIX), force)
    try:
        made = correction(content, airframe, load_effects(space.root))
    except ValueError as error:
        raise UsageError(f"{model}: {error}; give the folder with its effects with --workspace") from None
    named = {name: how for name, how in made.corrected.items() if name not in content.adjustments}
    lines = [f"{name}: corrected, {how}" for name, how in named.items()]
    lines += [f"{name}: not corrected, {why}" for name, why in made.uncorrected.items()]
    if adjusted := [name for name in made.corrected if name not in named]:
        lines.append(f"also corrected, within tolerance: {', '.join(adjusted)}")
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


def _check_verdict(path: Path, model: Model, accept_undecided: bool) -> None:
    """Raise UsageError for an undecided model that was not accepted; warn where no verdict is stated."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import warn

    if model.assessment is None:
        warn(f"{path}: states no verdict; nothing shows whether the data supports it")
        return
    if model.assessment.verdict == "undecided" and not accept_undecided:
        shares = ", ".join(f"{name} {p:.2f}" for name, p in model.assessment.probabilities.items())
        raise UsageError(
            f"{path}: its verdict is undecided{f' ({shares})' if shares else ''}; fly "
            "what trace proposes and trace again, or add --accept-undecided"
        )
    if model.assessment.verdict == "outside-library":
        warn(f"{path}: a part of the residual has a cause outside the library, and stays uncorrected")
