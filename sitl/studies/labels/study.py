"""The study of labels: Neural-C learned from smoothed logs, and from the acceleration of the plant itself.

    trimtab study labels --seed 1

The paper's Neural-C (section V-B) learned from true labels; `trimtab study paper-controllers` gives it the
labels of smoothed logs. This study learns both from the same flights, with the same settings and seed, and
flies both on the same plans, beside the MPC of the nominal vehicle and that of the learned residual.

The truth does not leave `sitl.studies`: the host's functions receive accelerations as plain arrays. A network
that was learned from them says so in its file's name and provenance. No other study uses it.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from trimtab.host.apps.paper.controllers.fly import Course, Row, fly_controller
from trimtab.host.apps.paper.controllers.models import (
    LABEL_SETTINGS,
    TRAINING_COURSES,
    Site,
    learn_models,
)
from trimtab.host.apps.paper.controllers.table import (
    CONTROLLERS,
    MIN_RESIDUAL,
    MIN_SNAP,
    REGRESSORS,
    Controller,
    Regressor,
    labels,
)
from trimtab.host.apps.paper.planning.compare import training_flights
from trimtab.host.apps.paper.planning.courses import draw, draw_course
from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import OnProgress, Piece, run_pieces
from trimtab.host.base.shards import Shard
from trimtab.host.effects import load_effects
from trimtab.host.learn.supervised import learn_supervised, residual_labels
from trimtab.host.log import Flight
from trimtab.host.log.prepare import Prepared, prepare
from trimtab.host.models.airframe import THETA, V
from trimtab.host.models.file import SUFFIX, write_model
from trimtab.host.models.model import Model
from trimtab.host.models.states import states_of
from trimtab.host.plan import Settings
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.sitl.studies.labels.summary import NEURAL, NOMINAL, SMOOTHED, TRUTH, summary
from trimtab.sitl.studies.labels.witness import WitnessedField, vehicle_s

NAME = "labels"
WORLD = "paper-drag"
WORLDS = 5
FIRST_FLIGHT = 201
"""Index of the flights of the first held-out course; training flights have lower ones."""


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Size of a study: held-out courses of each world, and the trajectories that are planned on each."""

    courses: int
    trajectories: tuple[str, ...]


FULL = Scope(courses=2, trajectories=(MIN_SNAP, MIN_RESIDUAL))
QUICK = Scope(courses=1, trajectories=(MIN_SNAP,))

_BY_NAME = {each.name: each for each in CONTROLLERS}
FLOWN: Mapping[str, Controller] = {
    **{name: _BY_NAME[name] for name in (NOMINAL, NEURAL, SMOOTHED)},
    TRUTH: replace(_BY_NAME[SMOOTHED], name=TRUTH),
}
"""Controllers by name. That of TRUTH is Neural-C, with other models."""


@dataclass(frozen=True, kw_only=True)
class Learned:
    """A world's models from training flights.

    truth: networks learned from true labels, by regressor. figures: sizes of the labels' errors.
    """

    site: Site
    truth: Mapping[Regressor, Model]
    figures: Mapping[str, Any]


def run(
    *,
    folder: Path,
    seed: int,
    vehicle: str,
    jobs: int,
    worlds: int = WORLDS,
    quick: bool = False,
    shard: Shard | None = None,
    on_progress: OnProgress = lambda done, total, detail: None,
) -> dict[str, Any]:
    """Learn, fly and compare, and return the outcome: `answer`, `lines`, `tables` and `scores`.

    Parameters
    ----------
    folder
        State and results; an interrupted study resumes.
    worlds
        Number of worlds.
    quick
        One world, one held-out course, and one trajectory.

    Raises
    ------
    UsageError
        No world, or the folder holds another study.
    """
    if worlds < 1:
        raise UsageError(f"--worlds {worlds}: give 1 or more")
    worlds, scope = (1, QUICK) if quick else (worlds, FULL)
    folder = folder.absolute()
    results = run_pieces(
        [Piece(name=_place(world), kind="world", arguments={"world": world}) for world in range(worlds)],
        partial(_work, seed=seed, vehicle=vehicle, scope=scope),
        folder=folder,
        config={"study": NAME, "seed": seed, "vehicle": load_vehicle(vehicle).id, "quick": quick},
        jobs=jobs,
        shard=shard,
        on_progress=on_progress,
    )
    answer = {"study": NAME, "seed": seed, "worlds": worlds, "quick": quick, "folder": str(folder)}
    return {**summary(answer, [piece["result"] for piece in results.values()]), "scores": results}


def _place(world: int) -> str:
    return f"world-{world:02d}"


def _work(piece: Piece, folder: str, *, seed: int, vehicle: str, scope: Scope) -> dict[str, Any]:
    """Learn the models of a world and fly its held-out courses; return what the summary needs."""
    world, craft = piece.arguments["world"], load_vehicle(vehicle)
    place = Path(folder) / "worlds" / piece.name
    shutil.rmtree(place, ignore_errors=True)
    found = learn_world(place, craft, seed, world)
    rows = [
        row | {"course": index}
        for index in range(scope.courses)
        for row in fly_course(found, place / "flown", seed, world, index, scope.trajectories)
    ]
    return {"world": world, "selected": found.site.selected, "labels": found.figures, "rows": rows}


def learn_world(folder: Path, vehicle: Vehicle, seed: int, world: int) -> Learned:
    """Fly the training courses of a world, and learn and write its models."""
    place, logs = _place(world), folder / "training"
    logs.mkdir(parents=True)
    field = WitnessedField(
        vehicle=vehicle,
        world=WORLD,
        world_seed=draw(seed, NAME, place),
        session={"seed": str(seed), "command": f"trimtab study {NAME}"},
    )
    flights = training_flights(
        field, logs, seed, purpose=f"{NAME}-training-{place}", courses=TRAINING_COURSES
    )
    prepared = prepare(flights)
    true = true_accelerations(field, prepared)
    effects, weights_seed = load_effects(), draw(seed, NAME, place, "weights")
    models, selected = learn_models(flights, effects, weights_seed)
    truth = learn_from_truth(flights, true, weights_seed)
    named = {**models, **{f"{labels(regressor)}-truth": model for regressor, model in truth.items()}}
    for name, model in named.items():
        write_model(model, folder / f"{name}{SUFFIX}", force=True)
    return Learned(
        site=Site(field=field, models=models, effects=effects, selected=selected),
        truth=truth,
        figures=label_figures(
            prepared, true, {regressor: (models[labels(regressor)], truth[regressor]) for regressor in truth}
        ),
    )


def true_accelerations(
    field: WitnessedField, prepared: Sequence[Prepared]
) -> list[Annotated[np.ndarray, "samples 3"]]:
    """Return the plant's acceleration, m/s^2, NED, at the samples of the field's flights, in their order."""
    vehicles = [field.vehicles[flight] for flight in sorted(field.vehicles)]
    return [
        simulated.plant.motion().accelerations(vehicle_s(each))
        for simulated, each in zip(vehicles, prepared, strict=True)
    ]


def learn_from_truth(
    flights: Sequence[Flight], accelerations: Sequence[np.ndarray], seed: int
) -> dict[Regressor, Model]:
    """Return the twins of the networks from labels, learned from true accelerations, by regressor."""
    return {
        regressor: learn_supervised(
            flights,
            settings=settings,
            accelerations=accelerations,
            seed=seed,
            provenance={"labels": "true acceleration of the simulated plant", "study": NAME},
        )
        for regressor, settings in LABEL_SETTINGS.items()
    }


def label_figures(
    prepared: Sequence[Prepared],
    true: Sequence[np.ndarray],
    twins: Mapping[Regressor, tuple[Model, Model]],
) -> dict[str, Any]:
    """Return root mean squares over samples and axes, m/s^2.

    label: smoothed less true acceleration. residual: true acceleration less that of the nominal vehicle.
    networks: difference of the two networks of a regressor, at the states of the samples.
    """
    states = [states_of(each) for each in prepared]
    seen = np.concatenate([each.seen for each in prepared])
    errors = np.concatenate([each.a - a for each, a in zip(prepared, true, strict=True)])
    residual = np.concatenate([residual_labels(s, a) for s, a in zip(states, true, strict=True)])
    x = np.concatenate([each.x for each in states])[seen]
    networks = {}
    for regressor, pair in twins.items():
        smoothed, truth = (_network_acceleration(model, x) for model in pair)
        networks[regressor] = _rms(truth - smoothed)
    return {
        "samples": int(seen.sum()),
        "label_rms_m_s2": _rms(errors[seen]),
        "residual_rms_m_s2": _rms(residual[seen]),
        "networks_rms_m_s2": networks,
    }


def _network_acceleration(
    model: Model, x: Annotated[np.ndarray, "samples 12"]
) -> Annotated[np.ndarray, "samples 3"]:
    assert model.network is not None
    return model.network.acceleration_ned(x[:, V].T, x[:, THETA].T).T


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def fly_course(
    found: Learned, logs: Path, seed: int, world: int, index: int, trajectories: Sequence[str]
) -> list[Row]:
    """Return a row for each regressor, controller and trajectory on a held-out course of a world.

    The route has the least time in which min-snap keeps the limits. Plans use the residual of the regressor.
    All flights share noise, turbulence and battery.
    """
    logs.mkdir(parents=True, exist_ok=True)
    site = found.site
    field = found.site.field
    drawn = draw_course(field.vehicle, seed, index, f"{NAME}-flown-{_place(world)}")
    course = Course(route=drawn.route, flight=FIRST_FLIGHT + index, settings=Settings())
    rows: list[Row] = []
    for regressor in REGRESSORS:
        plans = course.plans(field.vehicle, site.models[regressor], trajectories)
        for name, controller in FLOWN.items():
            flies = site
            if name == TRUTH:
                flies = replace(site, models={**site.models, labels(regressor): found.truth[regressor]})
            rows += fly_controller(flies, course, controller, regressor, plans, logs)
    return rows
