"""`trimtab learn`: learn effects and a network for the residual of a vehicle's model, from its flights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from trimtab.host.api.learn import Frame, Method, learn, learning_settings
from trimtab.host.verbs.options import AcceptUndecided, Force, Json, Trust, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.learn import Judged, Learned

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
    frame: Frame = "world"
    effects: Annotated[list[str] | None, Parameter(name="--effects", consume_multiple=True)] = None
    method: Method = "condensed"
    log_latency: Annotated[bool, Parameter(negative="")] = False
    epochs: int | None = None
    any_heading: Annotated[bool, Parameter(negative="--no-any-heading")] = True
    as_asked: Annotated[bool, Parameter(negative="")] = False
    seed: int = 0
    jobs: int | None = None
    workspace: WorkspaceFolder = None
    trust: Trust = False
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

    from trimtab.host.base.parallel import check_jobs

    check_jobs(options.jobs)

    import sys

    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import GateMissed, UsageError
    from trimtab.host.base.output import emit, warn
    from trimtab.host.base.progress import Progress
    from trimtab.host.learn import CondensedSettings
    from trimtab.host.log import read_flight
    from trimtab.host.models.file import SUFFIX, write_model
    from trimtab.host.workspace import open_workspace

    if not logs:
        raise UsageError("no log given; name one or more flight logs")
    if options.hold_out is not None and not options.hold_out:
        raise UsageError("--hold-out names no log; give one or more or leave it out")
    forms = None if options.effects is None else [name for name in options.effects if name != "none"]
    choices: dict[str, Any] = {
        "hidden": (32, 32) if options.hidden is None else options.hidden,
        "network": options.network,
        "frame": options.frame,
        "forms": forms,
        "method": options.method,
        "log_latency": options.log_latency,
        "epochs": options.epochs,
        "any_heading": options.any_heading,
        "seed": options.seed,
    }
    settings = learning_settings(**choices)  # before any file is read
    rounds = (
        settings.iterations * settings.passes if isinstance(settings, CondensedSettings) else settings.epochs
    )
    if not options.output.name.endswith(SUFFIX):
        raise UsageError(f"{options.output}: give the model a name that ends in {SUFFIX}")
    artefacts.check_output(options.output, options.force)
    effects = open_workspace(options.workspace, trusted=options.trust).effects()
    began = monotonic()
    flights = [read_flight(path) for path in logs]
    held_out = [read_flight(path) for path in options.hold_out or ()]
    with Progress("learning") as bar:
        learned = learn(
            flights,
            held_out,
            model=options.model,
            accept_undecided=options.accept_undecided,
            as_asked=options.as_asked,
            jobs=options.jobs,
            effects=effects,
            command=sys.argv[1:],
            on_epoch=lambda turn, loss: bar.update(
                turn, detail=f"round {turn} of at most {rounds}, validation loss {loss:.3g}"
            ),
            **choices,
        )
    if learned.is_written:
        write_model(learned.model, options.output, force=options.force)
        _print(learned, options.output)
    for note in learned.notes:
        warn(note)
    emit({**learned.to_dict(path=options.output), "seconds": round(monotonic() - began, 3)}, options.json)
    if not learned.is_written:
        raise GateMissed(
            f"{options.output}: not written, the learned model predicts whole flights no better; "
            "give more flights, other --effects or --epochs, or --as-asked"
        )


def _print(learned: Learned, output: Path) -> None:
    """Print what was learned and written."""
    from trimtab.host.base.output import say

    rounds = f"{learned.trained.epochs} rounds over {learned.segments} segments"
    latency_s = learned.log_latency_s
    say(
        f"{output}  id {learned.model.id}  {rounds}",
        *(_numbers(name, values) for name, values in learned.learned_effects.items()),
        *([] if latency_s is None else [f"poses are {1e3 * latency_s:.1f} ms older than stamped"]),
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
