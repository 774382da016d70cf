"""`trimtab learn`: a network for what the model of a vehicle leaves out, from its flights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from host.verbs.options import Force, Json, WorkspaceFolder

if TYPE_CHECKING:
    from host.learn import Judged

DEFAULT_OUTPUT = "learned.model.toml"


def command(
    *logs: Path,
    hold_out: Annotated[list[Path] | None, Parameter(name="--hold-out", consume_multiple=True)] = None,
    output: Annotated[Path, Parameter(name=["-o", "--output"])] = Path(DEFAULT_OUTPUT),
    model: Annotated[Path | None, Parameter(name="--model")] = None,
    hidden: Annotated[list[int] | None, Parameter(name="--hidden", consume_multiple=True)] = None,
    epochs: int = 120,
    any_heading: Annotated[bool, Parameter(negative="--no-any-heading")] = True,
    seed: int = 0,
    workspace: WorkspaceFolder = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Learn what a vehicle's model leaves out, from flight logs.

    Parameters
    ----------
    logs
        Flight logs to learn from; a part of their references is kept for the test.
    hold_out
        Flight logs to test on in place of that part.
    output
        Model to write.
    model
        Model whose effects stay; the network learns what they leave.
    hidden
        Widths of the hidden layers, at most three of 32.
    epochs
        Passes over the segments, at most.
    any_heading
        Take every flight as good in any heading; not so where the world has a direction, as with wind.
    seed
        Seed of the first weights, the order and the split.
    """
    from time import monotonic

    from host import artefacts
    from host.effects import load_effects
    from host.errors import UsageError
    from host.learn import Settings, learn
    from host.log import read_flight
    from host.models.file import SUFFIX, read_model, write_model
    from host.output import emit, say, warn
    from host.progress import Progress
    from host.workspace import open_workspace
    from protocol.blobs import HIDDEN_MAX, WIDTH_MAX

    if not logs:
        raise UsageError("no log given, name one or more flight logs")
    if hold_out is not None and not hold_out:
        raise UsageError("--hold-out names no log, give one or more or leave it out")
    widths = (32, 32) if hidden is None else tuple(hidden)
    if not 1 <= len(widths) <= HIDDEN_MAX or not all(1 <= width <= WIDTH_MAX for width in widths):
        told = " ".join(map(str, widths))
        raise UsageError(f"--hidden {told}: give 1 to {HIDDEN_MAX} widths of 1 to {WIDTH_MAX} each")
    if epochs < 1:
        raise UsageError(f"--epochs {epochs}: give 1 or more")
    if seed < 0:
        raise UsageError(f"--seed {seed}: give 0 or more")
    if not output.name.endswith(SUFFIX):
        raise UsageError(f"{output}: a model's name ends in {SUFFIX}")
    artefacts.check_output(output, force)
    settings = Settings(hidden=widths, epochs=epochs, any_heading=any_heading)
    began = monotonic()
    effects = load_effects(open_workspace(workspace).root)
    flights = [read_flight(path) for path in logs]
    held_out = [read_flight(path) for path in hold_out or ()]
    base = None if model is None else read_model(model, vehicle_id=flights[0].vehicle.id)
    parents = {f"log {i}": flight.id for i, flight in enumerate(flights)}
    if base is not None:
        parents["model"] = base.id
    with Progress("learning", total=epochs) as bar:
        learned = learn(
            flights,
            hold_out=held_out,
            base=base,
            effects=effects,
            settings=settings,
            seed=seed,
            provenance=artefacts.provenance(seed=seed, parents=parents),
            on_epoch=lambda epoch, loss: bar.update(epoch, detail=f"validation loss {loss:.3g}"),
        )
    write_model(learned.model, output, force=force)
    result: dict[str, Any] = {
        "model": str(output),
        "model_id": learned.model.id,
        "train": learned.train.to_json(),
        "test": None if learned.test is None else learned.test.to_json(),
        "improved": learned.improved,
        "epochs": learned.trained.epochs,
        "seconds": round(monotonic() - began, 3),
    }
    say(
        f"{output}  id {learned.model.id}  {learned.trained.epochs} epochs over {learned.segments} segments",
        *(_line(name, judged) for name, judged in (("used", learned.train), ("held out", learned.test))),
    )
    if not learned.improved:
        warn(f"{output}: predicts no better than without its network; learn from more flights or --epochs")
    emit(result, json)


def _line(name: str, judged: Judged | None) -> str:
    """Position error of whole flights before and after, in words."""
    if judged is None:
        return f"{name}: nothing; give flights of three references or more, or --hold-out"
    before, after = judged.base.position_rmse_m, judged.learned.position_rmse_m
    count = len(judged.flights)
    return f"{name}: {count} flights predicted {1e3 * before:.1f} mm off before, {1e3 * after:.1f} mm after"
