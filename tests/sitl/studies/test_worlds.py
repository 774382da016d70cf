"""Which worlds a study draws: proportions, rotation, pairs, and that a seed makes them again."""

from __future__ import annotations

from collections import Counter

import pytest

from trimtab.host.vehicle import load_vehicle
from trimtab.host.vehicle.strict_toml import read_strict
from trimtab.sitl.draw import draw_world
from trimtab.sitl.kinds import DRAG, KINDS
from trimtab.sitl.studies.files import StudyError
from trimtab.sitl.studies.scoring.world import library
from trimtab.sitl.studies.worlds import FULL, SAME_RATIO, THIN, plan_worlds, split
from trimtab.sitl.world import WorldFile


def test_split_of_full_size_is_the_full_study() -> None:
    assert split(538) == FULL == {"single": 150, "pair": 60, "none": 200, "outside": 80, "thin": 48}


def test_split_of_thirty_keeps_proportions() -> None:
    # 30 / 538 of 150, 60, 200, 80, 48 are 8.36, 3.35, 11.15, 4.46, 2.68.
    assert split(30) == {"single": 8, "pair": 3, "none": 11, "outside": 5, "thin": 3}


@pytest.mark.parametrize("count", range(5, 60))
def test_split_adds_up_with_one_of_each_at_least(count: int) -> None:
    parts = split(count)
    assert sum(parts.values()) == count
    assert min(parts.values()) >= 1


def test_split_of_fewer_than_classes_is_refused() -> None:
    with pytest.raises(StudyError, match="--worlds 4"):
        split(4)


def test_singles_and_outside_kinds_come_in_rotation() -> None:
    worlds = plan_worlds(5, 538, library())
    inside = {k.name for k in KINDS.values() if not k.outside and k.name in library()} - {"wind"}
    for kind_class, kinds in (
        ("single", inside),
        ("outside", {k.name for k in KINDS.values() if k.outside}),
    ):
        counts = Counter(w.kinds[0] for w in worlds if w.kind_class == kind_class)
        assert set(counts) == kinds
        assert max(counts.values()) - min(counts.values()) <= 1


def test_thin_worlds_hold_one_effect_and_lack_each_thing_as_often() -> None:
    worlds = plan_worlds(5, 538, library())
    thin = [w for w in worlds if w.kind_class == "thin"]
    assert Counter(w.case for w in thin) == dict.fromkeys(THIN, 6)
    assert {w.kinds for w in thin} == {w.kinds for w in worlds if w.kind_class == "single"}
    assert all(w.case is None for w in worlds if w.kind_class != "thin")
    # No kind meets the same case twice before it met others.
    assert max(Counter((w.case, w.kinds) for w in thin).values()) == 1


def test_pairs_are_apart_in_flight_and_wind_has_a_drag() -> None:
    pairs = [set(w.kinds) for w in plan_worlds(6, 538, library()) if w.kind_class == "pair"]
    assert all(len(pair) == 2 for pair in pairs)
    assert not any(pair <= SAME_RATIO for pair in pairs)
    windy = [pair for pair in pairs if "wind" in pair]
    assert windy
    assert all(pair & set(DRAG) for pair in windy)


def test_seed_makes_the_same_worlds_again_and_another_makes_others() -> None:
    assert plan_worlds(7, 30, library()) == plan_worlds(7, 30, library())
    assert plan_worlds(7, 30, library()) != plan_worlds(8, 30, library())
    seeds = {w.seed for s in (7, 8) for w in plan_worlds(s, 30, library())}
    assert len(seeds) == 60


def test_world_file_draws_exactly_the_planned_kinds_in_size() -> None:
    vehicle = load_vehicle("research")
    for world in plan_worlds(9, 60, library()):
        drawn = draw_world("w", read_strict(world.toml(), "w", WorldFile), world.seed, vehicle)
        assert set(drawn.effects) == set(world.kinds)
        assert drawn.deviations
        assert 0.5 <= drawn.turbulence.force_m_s2 / 0.04 <= 2.0
        for kind, values in drawn.effects.items():
            (first, *_) = KINDS[kind].quantities
            if KINDS[kind].spread == "above":
                assert 0.49 <= (values[first.key] - first.neutral) / first.typical <= 2.01
