"""`trimtab learn`: learn effects and a network for the residual of a vehicle's model, from its flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from trimtab.host.verbs.options import AcceptUndecided, Force, Json, WorkspaceFolder, accepted_model

if TYPE_CHECKING:
    from trimtab.host.effects import Effect
    from trimtab.host.learn import CondensedSettings, Judged, Settings
    from trimtab.host.learn.learn import Learned
    from trimtab.host.models.model import Model

DEFAULT_OUTPUT = "learned.model.toml"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LearnOptions:
    """Options of `trimtab learn`.

    Attributes
    ----------
    hold_out
        Flight logs to test on. Default: a part of the logs' references.
    output
        Model to write.
    model
        Model to start from. Its effects are kept, and the remaining residual is learned.
    hidden
        Widths of the hidden layers, at most three of 32.
    network
        Learn a network. Without it, learn the effects alone.
    frame
        Frame of the network's inputs and output. world: velocity and attitude, as in the paper. body:
        velocity in the body frame, which is the same for every heading.
    effects
        Effects of the library to learn beside the network; "none" for none. Default: linear-drag and
        com-offset; none with --model.
    method
        condensed: the trajectory loss, condensed about roll-outs. paper: the paper's mini-batches, network
        only.
    log_latency
        Also learn how much older the poses in the log are than their stamps. Use it if the vehicle itself got
        the poses in time. If it did not, learn the effect mocap-latency.
    epochs
        Greatest number of passes over the segments (paper, 120) or of iterations of each of two passes
        (condensed, 300).
    any_heading
        Also use every flight rotated to other headings. Turn it off if the world has a direction, such as
        wind.
    as_asked
        Write the model that the options describe, even if a smaller one or none predicts whole flights
        better.
    seed
        Seed of the first weights, the order and the split.
    jobs
        Threads of --method condensed. Default: the number of cores. The result does not depend on it.
    """

    hold_out: Annotated[list[Path] | None, Parameter(name="--hold-out", consume_multiple=True)] = None
    output: Annotated[Path, Parameter(name=["-o", "--output"])] = Path(DEFAULT_OUTPUT)
    model: Annotated[Path | None, Parameter(name="--model")] = None
    accept_undecided: AcceptUndecided = False
    hidden: Annotated[list[int] | None, Parameter(name="--hidden", consume_multiple=True)] = None
    network: Annotated[bool, Parameter(negative="--no-network")] = True
    frame: Literal["world", "body"] = "world"
    effects: Annotated[list[str] | None, Parameter(name="--effects", consume_multiple=True)] = None
    method: Literal["condensed", "paper"] = "condensed"
    log_latency: Annotated[bool, Parameter(negative="")] = False
    epochs: int | None = None
    any_heading: Annotated[bool, Parameter(negative="--no-any-heading")] = True
    as_asked: Annotated[bool, Parameter(negative="")] = False
    seed: int = 0
    jobs: int | None = None
    workspace: WorkspaceFolder = None
    json: Json = False
    force: Force = False


DEFAULTS = LearnOptions()


def command(*logs: Path, options: LearnOptions = DEFAULTS) -> None:
    """Learn effects and a residual network from flight logs. Keep what predicts whole flights best.

    Parameters
    ----------
    logs
        Flight logs to learn from. A part of their references is held out for the test.
    """
    from time import monotonic

    from trimtab.host.base.parallel import check_jobs, one_thread_of_algebra

    check_jobs(options.jobs)
    one_thread_of_algebra()

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import GateMissed
    from trimtab.host.base.output import emit, warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.effects import load_effects
    from trimtab.host.learn import learn
    from trimtab.host.log import log_parents, read_flight
    from trimtab.host.models.file import write_model
    from trimtab.host.workspace import open_workspace

    settings, rounds = _check(logs, options)
    began = monotonic()
    library = load_effects(open_workspace(options.workspace).root)
    flights = [read_flight(path) for path in logs]
    held_out = [read_flight(path) for path in options.hold_out or ()]
    base = None
    if options.model is not None:
        vehicle_id = flights[0].vehicle.id
        base = accepted_model(options.model, options.accept_undecided, vehicle_id=vehicle_id)
    parents = log_parents(flights, held_out)
    if base is not None:
        parents["model"] = base.id
    forms = _forms(options, library, base)
    with Progress("learning", total=rounds) as bar:
        learned = learn(
            flights,
            hold_out=held_out or None,
            base=base,
            effects=library,
            settings=settings,
            forms=forms,
            seed=options.seed,
            as_asked=options.as_asked,
            jobs=options.jobs,
            provenance=artefacts.provenance(seed=options.seed, parents=parents),
            on_epoch=lambda turn, loss: bar.update(turn, detail=f"validation loss {loss:.3g}"),
        )
    written = learned.selected.what != "nothing"
    named = {name: learned.model.effects[name] for name in forms if written}
    if written:
        write_model(learned.model, options.output, force=options.force)
        _print(learned, options.output, named, options.log_latency)
    for note in learned.notes:
        warn(note)
    answer = _answer(learned, options.output if written else None, named, options.log_latency)
    emit({**answer, "seconds": round(monotonic() - began, 3)}, options.json)
    if not written:
        raise GateMissed(
            f"{options.output}: not written, the learned model predicts whole flights no better; "
            "give more flights, other --effects or --epochs, or --as-asked"
        )


def _check(logs: Sequence[Path], options: LearnOptions) -> tuple[Settings | CondensedSettings, int]:
    """Return the settings and the number of rounds. Raises UsageError, before any file is read."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.models.file import SUFFIX

    paper = options.method == "paper"
    if not logs:
        raise UsageError("no log given; name one or more flight logs")
    if options.hold_out is not None and not options.hold_out:
        raise UsageError("--hold-out names no log; give one or more or leave it out")
    beyond_paper = options.effects or options.frame == "body" or not options.network or options.log_latency
    if paper and beyond_paper:
        raise UsageError(
            "--method paper learns only a network in the world frame; leave out --effects, --frame body, "
            "--no-network and --log-latency"
        )
    settings, rounds = _settings(options)
    if options.seed < 0:
        raise UsageError(f"--seed {options.seed}: give 0 or more")
    if not options.output.name.endswith(SUFFIX):
        raise UsageError(f"{options.output}: give the model a name that ends in {SUFFIX}")
    artefacts.check_output(options.output, options.force)
    return settings, rounds


def _settings(options: LearnOptions) -> tuple[Settings | CondensedSettings, int]:
    """Return the method's settings and the number of rounds. Raises UsageError."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.learn import CondensedSettings, Settings
    from trimtab.host.models.network import Layout
    from trimtab.protocol.blobs import HIDDEN_MAX, WIDTH_MAX

    widths = (32, 32) if options.hidden is None else tuple(options.hidden)
    if not 1 <= len(widths) <= HIDDEN_MAX or not all(1 <= width <= WIDTH_MAX for width in widths):
        given = " ".join(map(str, widths))
        raise UsageError(f"--hidden {given}: give 1 to {HIDDEN_MAX} widths of 1 to {WIDTH_MAX} each")
    epochs = options.epochs
    if epochs is not None and epochs < 1:
        raise UsageError(f"--epochs {epochs}: give 1 or more")
    if options.method == "paper":
        paper = Settings(hidden=widths, epochs=epochs or 120, any_heading=options.any_heading)
        return paper, paper.epochs
    condensed = CondensedSettings(
        layout=Layout(hidden=widths, frame=options.frame) if options.network else None,
        iterations=epochs or 300,
        any_heading=options.any_heading,
        delay=options.log_latency,
    )
    return condensed, condensed.iterations * condensed.passes


def _forms(options: LearnOptions, library: Mapping[str, Effect], base: Model | None) -> tuple[str, ...]:
    """Return the effects to learn. Raises UsageError for one that is unknown or in the base model already."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.learn import DEFAULT_FORMS

    by_default = options.effects is None and base is None and options.method != "paper"
    forms = tuple(name for name in (DEFAULT_FORMS if by_default else options.effects or ()) if name != "none")
    for name in forms:
        if name not in library:
            raise UsageError(f"--effects {name}: no such effect; available are {', '.join(library)}")
        if base is not None and name in base.effects:
            raise UsageError(f"--effects {name}: already in {options.model}; leave one of them out")
    if not (forms or options.network):
        raise UsageError("nothing to learn; leave out --no-network or give --effects")
    return forms


def _answer(
    learned: Learned, output: Path | None, named: Mapping[str, Mapping[str, float]], log_latency: bool
) -> dict[str, Any]:
    """Return the JSON object, without the time. `output` is None if nothing was written."""
    assessment = learned.model.assessment
    assert assessment is not None
    return {
        "model": None if output is None else str(output),
        "model_id": None if output is None else learned.model.id,
        "verdict": None if output is None else assessment.verdict,
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


def _print(
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
    """Return an effect's parameters as text."""
    return f"{name}: " + ", ".join(f"{key} {value:.4g}" for key, value in values.items())


def _line(name: str, judged: Judged | None) -> str:
    """Return the position error of predictions before and after as text."""
    from trimtab.host.learn.ahead import AHEAD_S

    if judged is None:
        return f"{name}: no flights; give flights of three references or more, or --hold-out"
    before, after = judged.base.position_rmse_m, judged.learned.position_rmse_m
    count = len(judged.flights)
    beyond = f"; {100.0 * judged.outside:.0f} % outside the trained region" if judged.outside else ""
    errors = f"{1e3 * before:.1f} mm before, {1e3 * after:.1f} mm after"
    if judged.drive == "inputs":
        return f"{name}: position error of {count} flights, predicted {AHEAD_S:g} s ahead, {errors}{beyond}"
    return f"{name}: position error of {count} predicted flights {errors}{beyond}"
