"""Detectability of effects outside the library, in worlds whose effect is known to be inside or outside."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.effects import load_effects
from trimtab.host.log import Flight, read_flight
from trimtab.host.trace.parameters import space
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.files import read_json
from trimtab.sitl.studies.flights import (
    FLIGHTS,
    PLAIN,
    STILL,
    TRUTH,
    Programme,
    fly_and_seal,
    plan_references,
)
from trimtab.sitl.studies.scoring import outside
from trimtab.sitl.studies.scoring.outside import outside_sigma
from trimtab.sitl.studies.worlds import PlannedWorld

VEHICLE = load_vehicle("research")
SPACE = space(VEHICLE, load_effects())


def flown(folder: Path, kind: str, programme: Programme) -> tuple[dict[str, float], list[list[Flight]]]:
    """Deviations of a world, and its flights: in still air, without the effect, and the traced ones."""
    world = PlannedWorld(name="w", kind_class="outside", kinds=(kind,), seed=11, turbulence=1.0)
    fly_and_seal(world, folder, plan_references(folder, "research", programme), "research", programme)
    names = (STILL, PLAIN, FLIGHTS)
    logs = [[read_flight(log) for log in sorted((folder / n).glob("one*.mcap"))] for n in names]
    return read_json(folder / TRUTH)["deviations"], logs


@pytest.mark.parametrize(("kind", "inside"), [("linear-drag", True), ("blade-flapping", False)])
def test_models_of_the_library_take_their_share_of_an_effect(
    tmp_path: Path,
    short_programme: Programme,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    inside: bool,
) -> None:
    """Measured with the library's effects: 6 of 29 sigma are left of a drag, and 109 of 120 of flapping."""
    deviations, (still, plain, flights) = flown(tmp_path, kind, short_programme)
    rest = outside_sigma(VEHICLE, SPACE, deviations, still, plain, flights)
    monkeypatch.setattr(outside, "MOST_EFFECTS", 0)
    whole = outside_sigma(VEHICLE, SPACE, deviations, still, plain, flights)
    assert whole > 20.0
    assert (rest < 0.35 * whole) if inside else (rest > 0.7 * whole)
    assert outside_sigma(VEHICLE, SPACE, deviations, plain, plain, flights) == pytest.approx(0.0, abs=1e-3)
