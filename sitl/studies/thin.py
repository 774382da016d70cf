"""Thin data: worlds of which little is flown or little is logged, one thing missing in each."""

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
"""The second vehicle's mass over the first one's: another build of the same make."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One way in which data are thin.

    codes: findings or refusals, one of which the answer to such data has to hold. programme: what is flown,
    from the study's own. copy: makes the log that is traced from the one that was flown.
    """

    codes: tuple[str, ...]
    programme: Callable[[Programme], Programme] = lambda whole: whole
    copy: Callable[[Path, Path], object] = shutil.copyfile


def _one_flight(whole: Programme) -> Programme:
    return replace(whole, learning=whole.learning[:1], held_out=(), repeats=1)


def _no_twins(whole: Programme) -> Programme:
    return replace(whole, repeats=1)


def _two_vehicles(whole: Programme) -> Programme:
    return replace(whole, learning=(whole.learning[0], OTHER), held_out=(), repeats=1)


def _three_seconds(whole: Programme) -> Programme:
    return replace(whole, learning=(SHORT,), held_out=(), repeats=1)


def _hover(whole: Programme) -> Programme:
    return replace(whole, learning=(HOVER,), held_out=())


CASES: dict[str, Case] = {
    "one flight": Case(codes=("no-twin",), programme=_one_flight),
    "no twins": Case(codes=("no-twin",), programme=_no_twins),
    "no gyro": Case(codes=("no-gyro",), copy=cut.without_gyro),
    "sampled telemetry": Case(codes=("sampled-commands",), copy=cut.sampled),
    "no reference": Case(codes=("no-reference",), copy=cut.without_reference),
    "two vehicles": Case(codes=("mixed-vehicles",), programme=_two_vehicles),
    "three seconds": Case(codes=("tracking-too-short", "too-few-segments"), programme=_three_seconds),
    "constant hover": Case(codes=("hover-only", "tracking-too-short"), programme=_hover),
}
"""By name, as worlds are drawn."""


def programme_of(case: str | None, whole: Programme) -> Programme:
    """Return what is flown in a world of this case; the study's own programme where it is none."""
    return whole if case is None else CASES[case].programme(whole)


def copier_of(case: str | None) -> Callable[[Path, Path], object]:
    """Return what makes a traced log from a flown one."""
    return shutil.copyfile if case is None else CASES[case].copy


def plan_thin_references(folder: Path, vehicle: str, whole: Programme) -> None:
    """Plan the references that only thin worlds fly, beside the study's own.

    Those of the second vehicle have its vehicle file beside them. Raises StudyError where one cannot be
    planned.
    """
    routes = Programme(routes=ROUTES, learning=(HOVER, SHORT), held_out=())
    target = plan_references(folder, vehicle, routes)
    first = load_vehicle(vehicle)
    other = first.replace(mass_kg=OTHER_MASS * first.mass_kg)
    file = target / f"{OTHER}.toml"
    write_whole(file, other.to_toml().encode())
    plan_route(target, OTHER, whole.route(whole.learning[0]), str(file))
