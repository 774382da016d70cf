"""One sealed world: fly the courses, learn, predict, and fly the pretzel and the other controllers.

The plant's effects are drawn from a seed; nobody opens their truth. The host knows the logs alone.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.flight import courses as vi_b
from trimtab.host.apps.paper.flight.controllers import (
    BASELINE,
    TABLE_III,
    Controller,
    on_board,
    on_host,
)
from trimtab.host.apps.paper.flight.models import (
    AHEAD,
    AHEAD_SAME_TORQUE,
    FLIGHTS,
    OURS,
    PAPER,
    SEGMENTS,
    learn_as_ours,
    learn_as_paper,
    predict,
    with_torque,
)
from trimtab.host.apps.paper.flight.pretzel import fly_pretzel
from trimtab.host.apps.paper.paths import Course, statistics
from trimtab.host.base.errors import FlightFailed
from trimtab.host.effects import Effect, load_effects
from trimtab.host.log import Flight, read_flight
from trimtab.host.models.correction import correction
from trimtab.host.models.model import Model
from trimtab.host.models.states import flight_states
from trimtab.host.plan import ResidualModel
from trimtab.host.vehicle import Vehicle

WORLD = "rich"
NOMINAL = "nominal"
SETS = ("train", "test", "ood")
TEST_FLIGHTS = 3
"""Of sixteen; the other thirteen are learned from: about the paper's 8:2."""
_PRETZEL_FIRST, _TRANSFER_FIRST = 101, 201
"""Flight indices of the first flight of the pretzel and of remark 1."""


@dataclass(frozen=True, kw_only=True)
class _Site:
    """Where a world is flown: `field`, and the folder for its logs."""

    field: Airfield
    folder: Path

    def fly(
        self, courses: Sequence[Course], first: int, controller: Controller
    ) -> tuple[dict[str, Flight], list[dict[str, str]]]:
        """Return the flights of the courses by name, from this flight index on, and those that failed."""
        flown, failed = {}, []
        for index, course in enumerate(courses, start=first):
            log = self.folder / f"{course.name}-{controller.name}.mcap"
            try:
                self.field.fly(
                    course.reference,
                    index,
                    log,
                    feedforward=controller.feedforward,
                    parameters=controller.parameters,
                    control=controller.control,
                    model_id=controller.model_id,
                )
                flown[course.name] = read_flight(log)
            except FlightFailed as error:
                failed.append({"flight": f"{course.name}, {controller.name}", "why": str(error)})
        return flown, failed


def fly_world(
    folder: Path, vehicle: Vehicle, seed: int, *, world: int, pretzels: int, epochs: int
) -> dict[str, Any]:
    """Return what section VI measures in one world. Logs stay in `folder`.

    pretzels: flights of each plan by each controller. epochs: of the paper's learning. Raises FlightFailed if
    no flight of a set reached its end.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    field = Airfield(
        vehicle=vehicle,
        world=WORLD,
        world_seed=vi_b.draw(seed, "world", world),
        session={"seed": str(seed), "command": "trimtab study paper-flight"},
    )
    site, effects = _Site(field=field, folder=folder), load_effects()
    courses = vi_b.draw_courses(vehicle, vi_b.draw(seed, "courses", world))
    flown, failed = site.fly(courses, 1, on_board(vehicle)[0])
    sets = split(courses, flown, np.random.default_rng(vi_b.draw(seed, "split", world)))
    weights_seed = vi_b.draw(seed, "weights", world)
    ours, selected = learn_as_ours(sets["train"], effects, weights_seed)
    models: dict[str, Model | None] = {
        NOMINAL: None,
        PAPER: learn_as_paper(sets["train"], weights_seed, epochs=epochs),
        OURS: ours,
    }
    made = correction(ours, vehicle, effects)
    if made.excess is not None:
        failed.append({"flight": "feed-forward", "why": f"{made.excess.quantity} beyond its range"})
    laws = on_board(vehicle, made.feedforward if made.excess is None else None)
    others = [law for law in laws if law.name != BASELINE] + on_host(vehicle, ours, effects)
    tested = [c for c in courses if flown.get(c.name) in sets["test"]]
    by_controller, lost = _transfer(site, tested, others, models, effects)
    return {
        "world": world,
        "statistics": {
            name: statistics([c for c in courses if c.out_of_distribution == ood])
            for name, ood in (("known", False), ("ood", True))
        },
        "flights": {name: len(flights) for name, flights in sets.items()},
        "selected": selected,
        "network": ours.network is not None,
        "errors": {
            name: _errors(flights, models, effects, (FLIGHTS, SEGMENTS)) for name, flights in sets.items()
        },
        "controllers": {
            BASELINE: _of_controller(sets["test"], models, effects),
            **by_controller,
        },
        "pretzel": fly_pretzel(
            field,
            ResidualModel.of(ours, effects),
            [law for law in laws if law.name in TABLE_III],
            folder,
            flights=range(_PRETZEL_FIRST, _PRETZEL_FIRST + pretzels),
        ),
        "failed": failed + lost,
    }


def split(
    courses: Sequence[Course], flown: Mapping[str, Flight], rng: np.random.Generator
) -> dict[str, list[Flight]]:
    """Return flights by set: of those in distribution three drawn for the test, and those out of it.

    Raises FlightFailed if a set has none.
    """
    known = [c.name for c in courses if not c.out_of_distribution and c.name in flown]
    order = [known[i] for i in rng.permutation(len(known))]
    ood = [c.name for c in courses if c.out_of_distribution and c.name in flown]
    names = {"train": order[TEST_FLIGHTS:], "test": order[:TEST_FLIGHTS], "ood": ood}
    for name, chosen in names.items():
        if not chosen:
            raise FlightFailed(f"no flight of the set {name} reached its end; choose another --seed")
    return {name: [flown[each] for each in chosen] for name, chosen in names.items()}


def _errors(
    flights: Sequence[Flight],
    models: Mapping[str, Model | None],
    effects: Mapping[str, Effect],
    horizons: Sequence[str],
) -> dict[str, Any]:
    """Return the prediction errors of each model on the same flights, by horizon; None where it diverged."""
    states = flight_states(flights)
    return {
        name: {
            horizon: errors.to_json()
            for horizon, errors in predict(flights, model, effects, horizons=horizons, states=states).items()
        }
        for name, model in models.items()
    }


def _transfer(
    site: _Site,
    courses: Sequence[Course],
    others: Sequence[Controller],
    models: Mapping[str, Model | None],
    effects: Mapping[str, Effect],
) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Return errors of remark 1 on flights of the courses by other controllers, and the flights that failed.

    The models stay as learned from flights of the baseline.
    """
    by_controller: dict[str, Any] = {}
    failed: list[dict[str, str]] = []
    for number, law in enumerate(others):
        flights, lost = site.fly(courses, _TRANSFER_FIRST + number * TEST_FLIGHTS, law)
        failed += lost
        if flights:
            by_controller[law.name] = _of_controller(list(flights.values()), models, effects)
    return by_controller, failed


def _of_controller(
    flights: Sequence[Flight], models: Mapping[str, Model | None], effects: Mapping[str, Effect]
) -> dict[str, Any]:
    """Return the errors of remark 1 on flights of one controller, by model and horizon.

    The models know the law on board: flights by a controller on the host are not predicted as whole flights.
    """
    on_board = all(flight.host_control is None for flight in flights)
    errors = _errors(flights, models, effects, (FLIGHTS, AHEAD) if on_board else (AHEAD,))
    same = _errors(flights, with_torque(models, flights[0].vehicle), effects, (AHEAD,))
    return {name: {**each, AHEAD_SAME_TORQUE: same[name][AHEAD]} for name, each in errors.items()}
