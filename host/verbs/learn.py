"""`trimtab learn`: a network for what the model of a vehicle leaves out, from its flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.effects import Effect
    from trimtab.host.learn import CondensedSettings, Judged, Settings
    from trimtab.host.learn.learn import Learned
    from trimtab.host.models.model import Model

DEFAULT_OUTPUT = "learned.model.toml"


def command(
    *logs: Path,
    hold_out: Annotated[list[Path] | None, Parameter(name="--hold-out", consume_multiple=True)] = None,
    output: Annotated[Path, Parameter(name=["-o", "--output"])] = Path(DEFAULT_OUTPUT),
    model: Annotated[Path | None, Parameter(name="--model")] = None,
    hidden: Annotated[list[int] | None, Parameter(name="--hidden", consume_multiple=True)] = None,
    network: Annotated[bool, Parameter(negative="--no-network")] = True,
    frame: Literal["world", "body"] = "world",
    effects: Annotated[list[str] | None, Parameter(name="--effects", consume_multiple=True)] = None,
    method: Literal["condensed", "paper"] = "condensed",
    log_latency: Annotated[bool, Parameter(negative="")] = False,
    epochs: int | None = None,
    any_heading: Annotated[bool, Parameter(negative="--no-any-heading")] = True,
    as_asked: Annotated[bool, Parameter(negative="")] = False,
    seed: int = 0,
    workspace: WorkspaceFolder = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Learn what a vehicle's model leaves out, from flight logs; keep what predicts whole flights best.

    Parameters
    ----------
    logs
        Flight logs to learn from; a part of their references is kept for the test.
    hold_out
        Flight logs to test on in place of that part.
    output
        Model to write.
    model
        Model whose effects stay; what they leave is learned.
    hidden
        Widths of the hidden layers, at most three of 32.
    network
        Learn a network; without, the effects alone.
    frame
        What the network sees and gives: velocity and attitude in the world, as in the paper, or the velocity
        in the body's axes, which is the same for every heading.
    effects
        Effects of the library that are learned beside the network; "none" for none. Default: linear-drag
        and com-offset, none on a model.
    method
        The trajectory loss condensed about roll-outs, or the paper's mini-batches, network only.
    log_latency
        Learn too how much older the poses of the log are than stamped, where the vehicle got them in time;
        where it did not, learn the effect mocap-latency.
    epochs
        At most so many passes over the segments (paper, 120) or iterations of each of two passes (condensed,
        300).
    any_heading
        Take every flight as good in any heading; not so where the world has a direction, as with wind.
    as_asked
        Write what was asked for even where less, or nothing, predicts whole flights better.
    seed
        Seed of the first weights, the order and the split.
    """
    from time import monotonic

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import GateMissed, UsageError
    from trimtab.host.base.output import emit, warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.effects import load_effects
    from trimtab.host.learn import DEFAULT_FORMS, learn
    from trimtab.host.log import read_flight
    from trimtab.host.models.file import SUFFIX, read_model, write_model
    from trimtab.host.workspace import open_workspace

    if not logs:
        raise UsageError("no log given, name one or more flight logs")
    if hold_out is not None and not hold_out:
        raise UsageError("--hold-out names no log, give one or more or leave it out")
    if method == "paper" and (effects or frame == "body" or not network or log_latency):
        raise UsageError("--method paper learns a network in the world's frame: leave the others out")
    settings, rounds = _settings(hidden, epochs, method, frame if network else None, any_heading, log_latency)
    if seed < 0:
        raise UsageError(f"--seed {seed}: give 0 or more")
    if not output.name.endswith(SUFFIX):
        raise UsageError(f"{output}: a model's name ends in {SUFFIX}")
    artefacts.check_output(output, force)
    began = monotonic()
    library = load_effects(open_workspace(workspace).root)
    flights = [read_flight(path) for path in logs]
    held_out = [read_flight(path) for path in hold_out or ()]
    base = None if model is None else read_model(model, vehicle_id=flights[0].vehicle.id)
    parents = {f"log {i}": flight.id for i, flight in enumerate(flights)}
    if base is not None:
        parents["model"] = base.id
    chosen = DEFAULT_FORMS if effects is None and base is None and method != "paper" else effects or []
    forms = tuple(name for name in chosen if name != "none")
    _check_forms(forms, library, base, model)
    if not (forms or network):
        raise UsageError("--no-network and no --effects: there is nothing to learn")
    with Progress("learning", total=rounds) as bar:
        learned = learn(
            flights,
            hold_out=held_out or None,
            base=base,
            effects=library,
            settings=settings,
            forms=forms,
            seed=seed,
            as_asked=as_asked,
            provenance=artefacts.provenance(seed=seed, parents=parents),
            on_epoch=lambda turn, loss: bar.update(turn, detail=f"validation loss {loss:.3g}"),
        )
    written = learned.selected.what != "nothing"
    named = {name: learned.model.effects[name] for name in forms if written}
    if written:
        write_model(learned.model, output, force=force)
        _tell(learned, output, named, log_latency)
    for note in learned.notes:
        warn(note)
    result = _answer(learned, output if written else None, named, log_latency)
    emit({**result, "seconds": round(monotonic() - began, 3)}, json)
    if not written:
        raise GateMissed(
            f"{output}: not written, whole flights are predicted no better than without; "
            "give more flights, other --effects or --epochs, or --as-asked"
        )


def _settings(
    hidden: list[int] | None,
    epochs: int | None,
    method: str,
    frame: Literal["world", "body"] | None,
    any_heading: bool,
    log_latency: bool,
) -> tuple[Settings | CondensedSettings, int]:
    """Return the settings and the number of rounds; `frame` is None without a network. Raises UsageError."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.learn import CondensedSettings, Settings
    from trimtab.host.models.network import Layout
    from trimtab.protocol.blobs import HIDDEN_MAX, WIDTH_MAX

    widths = (32, 32) if hidden is None else tuple(hidden)
    if not 1 <= len(widths) <= HIDDEN_MAX or not all(1 <= width <= WIDTH_MAX for width in widths):
        given = " ".join(map(str, widths))
        raise UsageError(f"--hidden {given}: give 1 to {HIDDEN_MAX} widths of 1 to {WIDTH_MAX} each")
    if epochs is not None and epochs < 1:
        raise UsageError(f"--epochs {epochs}: give 1 or more")
    if method == "paper":
        paper = Settings(hidden=widths, epochs=epochs or 120, any_heading=any_heading)
        return paper, paper.epochs
    condensed = CondensedSettings(
        layout=None if frame is None else Layout(hidden=widths, frame=frame),
        iterations=epochs or 300,
        any_heading=any_heading,
        delay=log_latency,
    )
    return condensed, condensed.iterations * condensed.passes


def _check_forms(
    forms: Sequence[str], library: Mapping[str, Effect], base: Model | None, model: Path | None
) -> None:
    """Raise UsageError for an effect that is not in the library, or that the base model has already."""
    from trimtab.host.base.errors import UsageError

    for name in forms:
        if name not in library:
            raise UsageError(f"--effects {name}: no such effect; there are {', '.join(library)}")
        if base is not None and name in base.effects:
            raise UsageError(f"--effects {name}: {model} has it already; leave one of them out")


def _answer(
    learned: Learned, output: Path | None, named: Mapping[str, Mapping[str, float]], log_latency: bool
) -> dict[str, Any]:
    """Return the JSON object, without the time; `output` is None where nothing was written."""
    return {
        "model": None if output is None else str(output),
        "model_id": None if output is None else learned.model.id,
        "train": learned.train.to_json(),
        "test": None if learned.test is None else learned.test.to_json(),
        "improved": learned.improved,
        "kept": learned.selected.what,
        "candidates": [trial.to_json() for trial in learned.trials],
        "effects": {name: dict(values) for name, values in named.items()},
        "epochs": learned.trained.epochs,
        "log_latency_s": learned.log_latency_s if log_latency and output is not None else None,
        "notes": list(learned.notes),
    }


def _tell(
    learned: Learned, output: Path, named: Mapping[str, Mapping[str, float]], log_latency: bool
) -> None:
    """Print what was learned and written."""
    from trimtab.host.base.output import say

    rounds = f"{learned.trained.epochs} rounds over {learned.segments} segments"
    say(
        f"{output}  id {learned.model.id}  {rounds}",
        *(_numbers(name, values) for name, values in named.items()),
        *([f"poses are {1e3 * learned.log_latency_s:.1f} ms older than stamped"] if log_latency else []),
        *(_line(name, judged) for name, judged in (("used", learned.train), ("held out", learned.test))),
    )


def _numbers(name: str, values: Mapping[str, float]) -> str:
    """Return an effect's parameters, in words."""
    return f"{name}: " + ", ".join(f"{key} {value:.4g}" for key, value in values.items())


def _line(name: str, judged: Judged | None) -> str:
    """Position error of whole flights before and after, in words."""
    if judged is None:
        return f"{name}: nothing; give flights of three references or more, or --hold-out"
    before, after = judged.base.position_rmse_m, judged.learned.position_rmse_m
    count = len(judged.flights)
    beyond = f"; {100.0 * judged.outside:.0f} % beyond the region learned in" if judged.outside else ""
    told = f"{1e3 * before:.1f} mm off before, {1e3 * after:.1f} mm after"
    return f"{name}: {count} flights predicted {told}{beyond}"
