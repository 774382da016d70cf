"""Flights that score a point of the search: a controller with its parameters at certain factors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.tuning.table import WORLD, Leg, Parameter, legs, settings_at
from trimtab.host.link.controllers import flown_by
from trimtab.host.plan import Plan, plan
from trimtab.host.plan.flown import fly_plan
from trimtab.host.route import load_route
from trimtab.host.vehicle import Vehicle

NAME = "controller-tuning"
_REPEAT_STRIDE = 100
"""Distance of the flight indices of a repetition."""
_WORSE = 3.0
"""Increase of a flight's log error, in spreads, with which a point is not chosen."""


def fly_point(
    folder: Path,
    vehicle: Vehicle,
    seed: int,
    *,
    controller: str,
    parameters: tuple[Parameter, ...],
    factors: Mapping[str, float],
    repetition: int,
    quick: bool,
) -> dict[str, Any]:
    """Fly every leg and return `errors_m` by leg, the mean error or None, and why flights failed.

    repetition: chooses noise, turbulence and radio. quick: fly the first leg alone. The logs are removed.
    """
    settings = settings_at(controller, parameters, factors)
    by = flown_by(controller, settings, vehicle, feedforward=False)
    errors: list[float | None] = []
    failed = []
    with TemporaryDirectory(dir=folder) as logs:
        for k, leg in enumerate(legs()[:1] if quick else legs()):
            field = Airfield(
                vehicle=vehicle,
                world=WORLD,
                world_seed=leg.world_seed,
                session={"seed": str(seed), "command": f"trimtab study {NAME}"},
            )
            index = 1 + k + _REPEAT_STRIDE * (2 * seed + repetition)
            flown = fly_plan(
                planned(leg, vehicle), field, flight=index, log=Path(logs) / f"{k}.mcap", flown_by=by
            )
            errors.append(flown.error_mean_m)
            if flown.failure is not None:
                failed.append({"course": leg.course, "pace": leg.pace, "why": flown.failure})
    return {"errors_m": errors, "failed": failed}


def planned(leg: Leg, vehicle: Vehicle) -> Plan:
    """Return the min-snap plan of a leg's course at its pace."""
    route = load_route(leg.course, None, vehicle)
    return plan(route, vehicle, kind="min-snap", total_time_s=route.duration_s / leg.pace)


def log_error(errors_m: Sequence[float | None]) -> float | None:
    """Return the mean of the logarithms of the errors; None if a flight failed."""
    flown = [error for error in errors_m if error is not None]
    return float(np.log(flown).mean()) if len(flown) == len(errors_m) else None


def score(errors_m: Sequence[float | None], start_m: Sequence[float | None], spread: float) -> float:
    """Return the mean log error of a point; infinite if a flight failed or is much worse than at the start.

    A single flight that gets worse while the others improve shows that the loop is near its stability limit.
    """
    changes = [
        np.log(a / b) for a, b in zip(errors_m, start_m, strict=True) if a is not None and b is not None
    ]
    mean = log_error(errors_m)
    return math.inf if mean is None or max(changes) > _WORSE * spread else mean


def flight_spread(
    pairs: Sequence[tuple[Sequence[float | None], Sequence[float | None]]],
) -> float:
    """Return the standard deviation of a flight's log error from flights that differ in noise alone.

    Raises ValueError if no pair of flights reached its end.
    """
    differences = [
        np.log(a / b)
        for first, second in pairs
        for a, b in zip(first, second, strict=True)
        if a is not None and b is not None
    ]
    if not differences:
        raise ValueError("no pair of flights reached its end")
    return float(np.sqrt(np.mean(np.square(differences)) / 2.0))
