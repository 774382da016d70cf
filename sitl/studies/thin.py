"""Thin data: worlds with few flights or incomplete logs, each with one thing missing."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies import cut
from trimtab.sitl.studies.files import write_whole
from trimtab.sitl.studies.flights import Programme, plan_references, plan_route

ROUTES = Path(str(files("trimtab.sitl.studies"))) / "thin_routes"
HOVER, SHORT, OTHER = "thin-hover", "thin-short", "thin-other"
OTHER_MASS = 1.1
"""Mass of the second vehicle over that of the first: another build of the same model."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One kind of thin data.

    `codes` are findings or refusals; the answer must hold one of them. `programme` changes the flights of the
    study. `copy` makes the traced log from the flown one.
    """

    codes: tuple[str, ...]
    programme: Callable[[Programme], Programme] = lambda whole: whole
    copy: Callable[[Path, Path], object] = shutil.copyfile


def _one_flight(whole: Programme) -> Programme:
    return replace(whole, learning=whole.learning[:1], held_out=(), repeats=1)


def _no_repeat_flights(whole: Programme) -> Programme:
    return replace(whole, repeats=1)


def _two_vehicles(whole: Programme) -> Programme:
    return replace(whole, learning=(whole.learning[0], OTHER), held_out=(), repeats=1)


def _three_seconds(whole: Programme) -> Programme:
    return replace(whole, learning=(SHORT,), held_out=(), repeats=1)


def _hover(whole: Programme) -> Programme:
    return replace(whole, learning=(HOVER,), held_out=())


CASES: dict[str, Case] = {
    "one flight": Case(codes=("no-twin",), programme=_one_flight),
    "no twins": Case(codes=("no-twin",), programme=_no_repeat_flights),
    "no gyro": Case(codes=("no-gyro",), copy=cut.without_gyro),
    "sampled telemetry": Case(codes=("sampled-commands",), copy=cut.sampled),
    "no reference": Case(codes=("no-reference",), copy=cut.without_reference),
    "two vehicles": Case(codes=("mixed-vehicles",), programme=_two_vehicles),
    "three seconds": Case(codes=("tracking-too-short", "too-few-segments"), programme=_three_seconds),
    "constant hover": Case(codes=("hover-only",), programme=_hover),
}
"""Kinds of thin data, by the names in `worlds.THIN`."""


def programme_of(case: str | None, whole: Programme) -> Programme:
    """Return the flights in a world of this case, or the study's own for None."""
    return whole if case is None else CASES[case].programme(whole)


def copier_of(case: str | None) -> Callable[[Path, Path], object]:
    """Return the function that makes a traced log from a flown one."""
    return shutil.copyfile if case is None else CASES[case].copy


def plan_thin_references(folder: Path, vehicle: str, whole: Programme) -> None:
    """Plan the additional references of thin worlds.

    The second vehicle's file lies beside its reference. Raises StudyError if one cannot be planned.
    """
    routes = Programme(routes=ROUTES, learning=(HOVER, SHORT), held_out=())
    target = plan_references(folder, vehicle, routes)
    first = load_vehicle(vehicle)
    other = first.replace(mass_kg=OTHER_MASS * first.mass_kg)
    file = target / f"{OTHER}.toml"
    write_whole(file, other.to_toml().encode())
    plan_route(target, OTHER, whole.route(whole.learning[0]), str(file))
