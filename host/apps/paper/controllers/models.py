"""A sealed world with the models learned from training flights in it, learned once for all its pieces."""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.controllers.table import CLOSED_FORM, Regressor, labels
from trimtab.host.apps.paper.planning.compare import training_flights
from trimtab.host.apps.paper.planning.courses import draw
from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.output import json_text
from trimtab.host.effects import Effect, load_effects
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, Settings, learn
from trimtab.host.learn.supervised import learn_supervised
from trimtab.host.log import Flight
from trimtab.host.models.file import SUFFIX, read_model, write_model
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout
from trimtab.host.vehicle import Vehicle

COMMAND = "trimtab study paper-controllers"
TRAINING_COURSES = 6
"""Each flown at two paces: about the 130 s of the paper's training set (section V-A)."""
PAPER_SETTINGS = Settings(
    hidden=(32, 32),
    epochs=120,
    batch=10,
    rate=1e-2,
    l2=0.0,
    patience=120,
    any_heading=False,
    free_start=False,
)
"""As in the paper (section V-A): Adam, batches of ten segments, starts as measured, headings as flown."""
WORLD_LAYOUT, BODY_LAYOUT = Layout(hidden=(32, 32), frame="world"), Layout(hidden=(32, 32), frame="body")
LABEL_SETTINGS: Mapping[Regressor, CondensedSettings] = {
    "paper": CondensedSettings(layout=WORLD_LAYOUT, any_heading=False),
    "ours": CondensedSettings(layout=BODY_LAYOUT),
}
"""Settings of the networks that are learned from labels."""
_DONE = "learned.json"


@dataclass(frozen=True, kw_only=True)
class Site:
    """A sealed world and its models by name. `selected`: what the default of `trimtab learn` selected."""

    field: Airfield
    models: Mapping[str, Model]
    effects: Mapping[str, Effect]
    selected: str


def airfield(vehicle: Vehicle, seed: int, world: str, place: str) -> Airfield:
    """Return the site of flights of a place, in a world of this name with a seed of the place's own."""
    return Airfield(
        vehicle=vehicle,
        world=world,
        world_seed=draw(seed, "controllers", place),
        session={"seed": str(seed), "command": COMMAND},
    )


def learned_site(folder: Path, vehicle: Vehicle, seed: int, world: str, place: str) -> Site:
    """Return the site of a place with its models; the first call learns them and leaves them in `folder`.

    Other processes that need the same models wait.
    """
    field, effects = airfield(vehicle, seed, world, place), load_effects()
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        if not (folder / _DONE).is_file():
            _learn(folder, field, seed, place, effects)
    record = json.loads((folder / _DONE).read_text("utf-8"))
    models = {
        name: read_model(folder / f"{name}{SUFFIX}", vehicle_id=vehicle.id) for name in record["models"]
    }
    return Site(field=field, models=models, effects=effects, selected=record["selected"])


def _learn(folder: Path, field: Airfield, seed: int, place: str, effects: Mapping[str, Effect]) -> None:
    """Fly the training courses of a place, learn its models and write them."""
    logs = folder / "training"
    shutil.rmtree(logs, ignore_errors=True)
    logs.mkdir()
    flights = training_flights(
        field, logs, seed, purpose=f"controllers-training-{place}", courses=TRAINING_COURSES
    )
    weights_seed = draw(seed, "controllers", place, "weights")
    models, selected = learn_models(flights, effects, weights_seed)
    for name, model in models.items():
        write_model(model, folder / f"{name}{SUFFIX}", force=True)
    write_atomic(folder / _DONE, json_text({"models": list(models), "selected": selected}), force=True)


def learn_models(
    flights: Sequence[Flight], effects: Mapping[str, Effect], seed: int
) -> tuple[dict[str, Model], str]:
    """Return the models by name, and what the default selected for "ours".

    paper: the network of the paper, in the world frame, with the paper's settings. ours: what `trimtab learn`
    selects by default with a network in the body frame. closed-form: the effects alone. The last two are
    learned from labels of the acceleration, with networks as in "paper" and "ours".
    """
    ours = learn(
        flights,
        effects=effects,
        settings=CondensedSettings(layout=BODY_LAYOUT),
        forms=DEFAULT_FORMS,
        hold_out=(),
        seed=seed,
    )
    learned = {
        "paper": learn(
            flights, effects=effects, settings=PAPER_SETTINGS, hold_out=(), seed=seed, as_asked=True
        ).model,
        "ours": ours.model,
        CLOSED_FORM: learn(
            flights,
            effects=effects,
            settings=CondensedSettings(layout=None),
            forms=DEFAULT_FORMS,
            hold_out=(),
            seed=seed,
            as_asked=True,
        ).model,
        **{
            labels(regressor): learn_supervised(flights, settings=settings, seed=seed)
            for regressor, settings in LABEL_SETTINGS.items()
        },
    }
    return learned, ours.selected.what
