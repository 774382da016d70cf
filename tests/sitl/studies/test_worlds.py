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
from trimtab.sitl.studies.worlds import FULL, SAME_RATIO, THIN, PlannedWorld, plan_worlds, split
from trimtab.sitl.world import WorldFile


def test_split_of_full_size_is_the_full_study() -> None:
    assert sum(FULL[name] for name in ("single", "pair", "triple")) == 500
    assert FULL["none"] == 250
    assert split(918) == FULL


def test_split_of_thirty_keeps_proportions() -> None:
    # 30 / 918 of 250, 150, 100, 250, 120, 48 are 8.17, 4.90, 3.27, 8.17, 3.92, 1.57.
    assert split(30) == {"single": 8, "pair": 5, "triple": 3, "none": 8, "outside": 4, "thin": 2}


@pytest.mark.parametrize("count", range(6, 60))
def test_split_adds_up_with_one_of_each_at_least(count: int) -> None:
    parts = split(count)
    assert sum(parts.values()) == count
    assert min(parts.values()) >= 1


def test_split_of_fewer_than_classes_is_refused() -> None:
    with pytest.raises(StudyError, match="--worlds 5"):
        split(5)


def test_singles_and_outside_kinds_come_in_rotation() -> None:
    worlds = plan_worlds(5, 918, library())
    inside = {k.name for k in KINDS.values() if not k.outside and k.name in library()} - {"wind"}
    for kind_class, kinds in (
        ("single", inside),
        ("outside", {k.name for k in KINDS.values() if k.outside}),
    ):
        counts = Counter(w.kinds[0] for w in worlds if w.kind_class == kind_class)
        assert set(counts) == kinds
        assert max(counts.values()) - min(counts.values()) <= 1


def test_thin_worlds_hold_one_effect_and_lack_each_thing_as_often() -> None:
    worlds = plan_worlds(5, 918, library())
    thin = [w for w in worlds if w.kind_class == "thin"]
    assert Counter(w.case for w in thin) == dict.fromkeys(THIN, 6)
    assert {w.kinds for w in thin} == {w.kinds for w in worlds if w.kind_class == "single"}
    assert all(w.case is None for w in worlds if w.kind_class != "thin")
    # No kind meets the same case twice before it met others.
    assert max(Counter((w.case, w.kinds) for w in thin).values()) == 1


@pytest.mark.parametrize(("kind_class", "size"), [("pair", 2), ("triple", 3)])
def test_sets_are_apart_in_flight_and_wind_has_a_drag(kind_class: str, size: int) -> None:
    sets = [set(w.kinds) for w in plan_worlds(6, 918, library()) if w.kind_class == kind_class]
    assert all(len(each) == size for each in sets)
    assert not any(len(each & SAME_RATIO) > 1 for each in sets)
    windy = [each for each in sets if "wind" in each]
    assert windy
    assert all(each & set(DRAG) for each in windy)


def test_seed_makes_the_same_worlds_again_and_another_makes_others() -> None:
    assert plan_worlds(7, 30, library()) == plan_worlds(7, 30, library())
    assert plan_worlds(7, 30, library()) != plan_worlds(8, 30, library())
    seeds = {w.seed for s in (7, 8) for w in plan_worlds(s, 30, library())}
    assert len(seeds) == 60


def test_world_file_draws_exactly_the_planned_kinds_in_size() -> None:
    vehicle = load_vehicle("research")
    multiples: list[float] = []
    for world in plan_worlds(9, 300, library()):
        drawn = draw_world("w", read_strict(world.toml(), "w", WorldFile), world.seed, vehicle)
        assert set(drawn.effects) == set(world.kinds)
        assert 0.5 <= drawn.turbulence.force_m_s2 / 0.04 <= 2.0
        assert (drawn.turbulence.spectrum == "dryden") == world.dryden
        # Every battery moves, and every deviation is within two tolerances.
        assert drawn.battery.discharges
        assert {
            abs(value) <= 2.0001 * vehicle.tolerance(kind, key, default(kind, key))
            for (kind, key), value in drawn.deviations.items()
        } == {True}
        for kind, values in drawn.effects.items():
            (first, *_) = KINDS[kind].quantities
            if KINDS[kind].spread == "above":
                multiples.append((values[first.key] - first.neutral) / first.typical)
    assert min(multiples) >= 0.19
    assert max(multiples) <= 4.01
    assert min(multiples) < 0.3
    assert max(multiples) > 3.0


def default(kind: str, key: str) -> float:
    return next(q.tolerance for q in KINDS[kind].quantities if q.key == key)


def test_lines_of_a_study_may_drag_on_the_floor_and_half_its_gusts_are_drydens() -> None:
    vehicle = load_vehicle("research")
    worlds = plan_worlds(9, 918, library())
    lengths = [
        draw_world("w", read_strict(w.toml(), "w", WorldFile), w.seed, vehicle).effects["slung-payload"]
        for w in worlds
        if "slung-payload" in w.kinds
    ]
    assert max(values["length_m"] for values in lengths) > 0.6
    assert min(values["length_m"] for values in lengths) < 0.45
    assert 0.45 < sum(w.dryden for w in worlds) / len(worlds) < 0.55


def test_world_of_another_study_is_drawn_as_tracing_expects() -> None:
    world = PlannedWorld(name="0", kind_class="single", kinds=("slung-payload",), seed=1, turbulence=1.0)
    file = read_strict(world.toml(), "w", WorldFile)
    assert file.draw is not None
    assert (file.draw.size, file.draw.uniform, file.build.distribution) == ((0.5, 2.0), {}, "normal")
    assert not file.battery.discharges


def test_share_of_the_inside_worlds_is_also_traced_from_few_flights() -> None:
    def few(share: float) -> list[str]:
        return [w.kind_class for w in plan_worlds(5, 60, library(), share) if w.few]

    inside = [w for w in plan_worlds(5, 60, library()) if w.kind_class not in ("outside", "thin")]
    assert len(few(1.0)) == len(inside)
    assert not set(few(1.0)) & {"outside", "thin"}
    assert len(few(0.25)) == len(inside) // 4
    assert few(0.0) == []
    # What is traced does not change the worlds.
    assert [w.seed for w in plan_worlds(5, 60, library(), 0.5)] == [
        w.seed for w in plan_worlds(5, 60, library())
    ]
    with pytest.raises(StudyError, match="--few-flights"):
        plan_worlds(5, 60, library(), 1.5)
