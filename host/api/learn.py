"""Learn effects and a residual network from flights, with the effects of a workspace."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from trimtab.host.base.errors import UsageError
from trimtab.host.workspace import Workspace, open_workspace

if TYPE_CHECKING:
    from trimtab.host.effects import Effect
    from trimtab.host.learn import CondensedSettings, Learned, Settings
    from trimtab.host.log import Flight
    from trimtab.host.models.model import Model

Method = Literal["condensed", "paper"]
Frame = Literal["world", "body"]


def learn(  # noqa: PLR0913 (one keyword for each choice)
    flights: Sequence[Flight],
    held_out: Sequence[Flight] = (),
    *,
    model: Model | str | Path | None = None,
    accept_undecided: bool = False,
    hidden: Sequence[int] = (32, 32),
    network: bool = True,
    frame: Frame = "world",
    forms: Sequence[str] | None = None,
    effects: Mapping[str, Effect] | None = None,
    method: Method = "condensed",
    log_latency: bool = False,
    epochs: int | None = None,
    any_heading: bool = True,
    as_asked: bool = False,
    seed: int = 0,
    jobs: int | None = None,
    workspace: str | Path | Workspace | None = None,
    command: Sequence[str] = (),
    on_epoch: Callable[[int, float], None] | None = None,
) -> Learned:
    """Learn effects and a residual network from flights of one vehicle, as `trimtab learn` does.

    The model is the one that predicts whole flights best. `write_model` writes it.

    Parameters
    ----------
    flights
        Flights to learn from.
    held_out
        Flights to test on. Default: a part of the flights' references, of three or more.
    model
        Model to start from, or its file. Its effects are kept, and the remaining residual is learned.
    accept_undecided
        Also start from a model whose verdict is undecided.
    hidden
        Widths of the network's hidden layers, at most three of 32.
    network
        Learn a network. Without it, learn the effects alone.
    frame
        Frame of the network's inputs and output: "world", or "body", which is the same for every heading.
    forms
        Names of effects to learn beside the network; empty for none. Default: linear-drag and com-offset;
        none with `model`.
    effects
        Library of effects by name. Default: the shipped ones and those of the workspace.
    method
        "condensed": the trajectory loss, condensed about roll-outs. "paper": the paper's mini-batches,
        network only.
    log_latency
        Also learn how much older the poses in the log are than their stamps.
    epochs
        Greatest number of passes over the segments (paper, 120) or of iterations of each of two passes
        (condensed, 300).
    any_heading
        Also use every flight rotated to other headings.
    as_asked
        Return the model that the arguments describe, even if a smaller one or none predicts better.
    seed
        Seed of the first weights, the order and the split.
    jobs
        Threads of the condensed method. Default: the number of cores. The result does not depend on it.
    workspace
        Folder with effects of yours. Default: the current folder.
    command
        Words of the command line, recorded in the model.
    on_epoch
        Called with the number of the epoch and its validation loss.

    Returns
    -------
    Learned
        The model, and its errors on the flights used and held out: position in m, velocity in m/s.

    Raises
    ------
    TooLittleData
        If the flights are too few or too short, or of two vehicles.
    UsageError, ConfigurationError, EffectError
        If arguments do not go together, or a file cannot be used.
    """
    from trimtab.host.base.parallel import check_jobs

    check_jobs(jobs)
    from trimtab.host.base import artefacts
    from trimtab.host.learn import learn as learn_model
    from trimtab.host.log import log_parents
    from trimtab.host.models.accepted import accepted_model

    if not flights:
        raise UsageError("no flight given; give one or more")
    settings = learning_settings(
        hidden=hidden,
        network=network,
        frame=frame,
        forms=forms,
        method=method,
        log_latency=log_latency,
        epochs=epochs,
        any_heading=any_heading,
        seed=seed,
    )
    library = open_workspace(workspace).effects() if effects is None else effects
    base, parents = None, log_parents(flights, held_out)
    if model is not None:
        base = accepted_model(model, accept_undecided, vehicle_id=flights[0].vehicle.id)
        parents["model"] = base.id
    name = model if isinstance(model, str | Path) else "the model"
    return learn_model(
        flights,
        hold_out=held_out or None,
        base=base,
        effects=library,
        settings=settings,
        forms=_forms(forms, method, network, library, base, str(name)),
        seed=seed,
        as_asked=as_asked,
        jobs=jobs,
        provenance=artefacts.provenance(seed=seed, parents=parents, argv=command),
        on_epoch=on_epoch,
    )


def learning_settings(  # noqa: PLR0913 (one keyword for each choice)
    *,
    hidden: Sequence[int],
    network: bool,
    frame: Frame,
    forms: Sequence[str] | None,
    method: Method,
    log_latency: bool,
    epochs: int | None,
    any_heading: bool,
    seed: int,
) -> Settings | CondensedSettings:
    """Return the method's settings. See `learn`. Raises UsageError."""
    from trimtab.host.learn import CondensedSettings, Settings
    from trimtab.host.models.network import Layout
    from trimtab.protocol.blobs import HIDDEN_MAX, WIDTH_MAX

    paper, widths = method == "paper", tuple(hidden)
    if paper and (forms or frame == "body" or not network or log_latency):
        raise UsageError(
            "--method paper learns only a network in the world frame; leave out --effects, --frame body, "
            "--no-network and --log-latency"
        )
    if not 1 <= len(widths) <= HIDDEN_MAX or not all(1 <= width <= WIDTH_MAX for width in widths):
        given = " ".join(map(str, widths))
        raise UsageError(f"--hidden {given}: give 1 to {HIDDEN_MAX} widths of 1 to {WIDTH_MAX} each")
    if epochs is not None and epochs < 1:
        raise UsageError(f"--epochs {epochs}: give 1 or more")
    if seed < 0:
        raise UsageError(f"--seed {seed}: give 0 or more")
    if paper:
        return Settings(hidden=widths, epochs=epochs or 120, any_heading=any_heading)
    return CondensedSettings(
        layout=Layout(hidden=widths, frame=frame) if network else None,
        iterations=epochs or 300,
        any_heading=any_heading,
        delay=log_latency,
    )


def _forms(
    given: Sequence[str] | None,
    method: Method,
    network: bool,
    library: Mapping[str, Effect],
    base: Model | None,
    base_name: str,
) -> tuple[str, ...]:
    """Return the effects to learn. Raises UsageError if one is unknown or in the base model already."""
    from trimtab.host.learn import DEFAULT_FORMS

    by_default = given is None and base is None and method != "paper"
    forms = DEFAULT_FORMS if by_default else tuple(given or ())
    for name in forms:
        if name not in library:
            raise UsageError(f"--effects {name}: no such effect; available are {', '.join(library)}")
        if base is not None and name in base.effects:
            raise UsageError(f"--effects {name}: already in {base_name}; leave one of them out")
    if not (forms or network):
        raise UsageError("nothing to learn; leave out --no-network or give --effects")
    return forms
