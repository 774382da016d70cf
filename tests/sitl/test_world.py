"""World files and what seeds make of them."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.vehicle import ConfigurationError, Vehicle, load_vehicle
from trimtab.sitl.draw import draw_world
from trimtab.sitl.kinds import DRAG, KINDS, Kind
from trimtab.sitl.seeds import Purpose, flight_generator, session_uid, world_generator
from trimtab.sitl.world import WorldFile, list_worlds, load_world


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("research")


@pytest.mark.parametrize("name", list_worlds())
def test_shipped_world_loads_and_draws(name: str, vehicle: Vehicle) -> None:
    stem, file = load_world(name)
    assert stem == name
    world = draw_world(name, file, 5, vehicle)
    assert all(kind in KINDS for kind in world.effects)


def test_world_with_many_mistakes_is_told_all_of_them(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(
        "description = 3\nfoo = 1\n[effects.wind]\nwx = 1.0\nwz = 30.0\n[effects.linear-drags]\n"
        '[radio]\nloss = 2.0\n[draw]\ncount = [1]\nkinds = ["lineardrag"]\n'
    )
    with pytest.raises(ConfigurationError) as caught:
        load_world(path)
    assert caught.value.exit_code == 2
    told = "\n".join(caught.value.problems)
    for part in (
        "description: 3", "tolerances: missing", "effects.wind.wy: missing", "effects.wind.wz: unknown",
        "effects.linear-drags: unknown key; did you mean linear-drag?", "radio.loss: 2.0", "foo: unknown",
        "draw.kinds: unknown lineardrag",
    ):  # fmt: skip
        assert part in told


def test_wrong_keys_of_a_world_do_not_hide_contradictions_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(
        'description = "x"\ntolerances = 1\n[effects.wind]\nwx = 1.0\nwy = 0.0\n'
        '[draw]\ncount = [2, 3]\nkinds = ["motor-lag"]\nsize = [2.0, 1.0]\n'
        "[radio]\nloss = 0.9\nlatency_us = -1\n"
    )
    with pytest.raises(ConfigurationError) as caught:
        load_world(path)
    starts = [line.removeprefix(f"{path}: ").split(":")[0] for line in caught.value.problems]
    assert starts == [
        "tolerances", "effects", "draw.kinds", "draw.size", "radio.burst_frames", "radio.latency_us",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[effects.wind]\nwx = 1.0\nwy = 0.0", "acts only through drag"),
        ('[draw]\ncount = [1, 1]\nkinds = ["wind"]', "wind without a drag"),
        ('[draw]\ncount = [2, 3]\nkinds = ["motor-lag"]', "count"),
        ("[effects.motor-lag]\nextra_s = 0.01\n[draw]\ncount = [1, 1]", "both in effects and in draw.kinds"),
        ("[mocap]\nrate_hz = 160", "does not divide"),
        ("[mocap]\nrate_hz = 500", "rate_hz: 500 is out of range; give a value at most 250"),
        ("[radio]\nslot_us = 2500", "multiple of the tick"),
        ("[radio]\nslot_us = 4000", "radio.slot_us: 4000 is out of range; give a value at most 3000"),
        ("[radio]\nslot_us = 1000\nbit_rate = 850000", "a frame of 116 B takes 1711 us .* longer slot"),
        ("[radio]\nbit_rate = 1000", "radio.bit_rate: 1000 is not possible; choose 850000 or 6800000"),
        ("[radio]\nframe_bytes = 40", "radio.frame_bytes: 40 is out of range; give a value at least 64"),
        ("[radio]\nshort_risk = 2.0", "radio.short_risk"),
        ("[serial]\nbaud = 9600", "serial.baud: 9600 is not possible; choose 921600 or 3000000"),
        ("[serial]\nchunk_bytes = 0", "serial.chunk_bytes: 0 is out of range; give a value at least 1"),
        ("[timing]\noverrun_us = 900", "timing.overrun_us: 900 is out of range; give a value above 1000"),
        ("[timing]\noverrun = 0.9", "timing.overrun: 0.9 is out of range; give a value at most 0.5"),
        ("[radio]\nloss = 0.9", "burst_frames: bursts of 5 frames lose at most 0.8333 .* at least 9"),
        ("[radio]\nloss = 0.6\nburst_frames = 1.0", "burst_frames: bursts of 1 frames .* at least 1.5"),
        ("[effects.linear-drag]\ndx = -1.0\ndy = 0.1\ndz = 0.1", "effects.linear-drag.dx"),
    ],
)
def test_world_that_contradicts_itself_is_refused(tmp_path: Path, text: str, part: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(f'description = "x"\ntolerances = false\n{text}\n')
    with pytest.raises(ConfigurationError, match=part):
        load_world(path)


def test_unknown_world_names_the_known_ones() -> None:
    with pytest.raises(
        ConfigurationError, match="known: bad-link, canted, dead-zone, draughty, drawn-outside"
    ):
        load_world("nowhere")
    with pytest.raises(ConfigurationError, match="no such world file"):
        load_world("nowhere/at-all.toml")


@pytest.mark.parametrize("name", ["drawn", "drawn-pair", "drawn-outside"])
def test_drawn_world_depends_on_file_and_seed_alone(vehicle: Vehicle, name: str) -> None:
    file = load_world(name)[1]
    first, again, other = (draw_world(name, file, seed, vehicle) for seed in (7, 7, 8))
    assert dataclasses.asdict(first) == dataclasses.asdict(again)
    assert first.effects != other.effects
    assert first.deviations != other.deviations


def test_drawn_worlds_hold_as_many_kinds_as_asked_and_wind_never_alone(vehicle: Vehicle) -> None:
    draw = {"count": (2, 3)}
    file = WorldFile.model_validate({"description": "x", "tolerances": True, "draw": draw})
    seen: Counter[str] = Counter()
    for seed in range(400):
        effects = draw_world("x", file, seed, vehicle).effects
        assert 2 <= len(effects) <= 3
        assert "wind" not in effects or set(effects) & set(DRAG)
        seen.update(effects.keys())
    inside = {kind.name for kind in KINDS.values() if not kind.outside}
    assert set(seen) == inside
    assert min(seen.values()) > 8  # wind is there only beside a drag


def sizes_of(kind: Kind, values: Mapping[str, float]) -> list[float]:
    """Multiples of the typical size that a draw came to, one for each size drawn."""
    sizes = [(values[q.key] - q.neutral) / q.typical for q in kind.quantities if q.drawn is None]
    if kind.spread == "turned":
        return [math.hypot(*sizes[:2]), *(2.0 * size for size in sizes[2:])]
    return [size for size in sizes if size] if kind.spread == "one" else sizes


@pytest.mark.parametrize("name", KINDS)
def test_drawn_sizes_lie_between_half_and_twice_typical(vehicle: Vehicle, name: str) -> None:
    kind = KINDS[name]
    stated = {"linear-drag": {"dx": 0.4, "dy": 0.4, "dz": 0.2}} if name == "wind" else {}
    content = {"description": "x", "tolerances": True, "effects": stated}
    file = WorldFile.model_validate({**content, "draw": {"count": (1, 1), "kinds": (name,)}})
    drawn = [draw_world("x", file, seed, vehicle).effects for seed in range(40)]
    sizes = [size for effects in drawn for size in sizes_of(kind, effects[name])]
    assert set(drawn[0]) == {name, *stated}
    assert all(0.4999 <= abs(size) <= 2.0001 for size in sizes if size)
    assert max(map(abs, sizes)) > 1.5
    for q in kind.quantities:
        assert all(q.lower <= effects[name][q.key] <= q.upper for effects in drawn)
        if q.drawn is not None:
            assert all(q.drawn[0] <= effects[name][q.key] <= q.drawn[1] for effects in drawn)


def test_drawn_rotor_loss_is_of_one_rotor_and_each_in_turn(vehicle: Vehicle) -> None:
    draw = {"count": (1, 1), "kinds": ("rotor-loss",)}
    file = WorldFile.model_validate({"description": "x", "tolerances": True, "draw": draw})
    seen: Counter[str] = Counter()
    for seed in range(60):
        losses = draw_world("x", file, seed, vehicle).effects["rotor-loss"]
        lossy = [key for key, loss in losses.items() if loss]
        assert len(lossy) == 1
        seen.update(lossy)
    assert len(seen) == 4
    assert min(seen.values()) > 5


@pytest.mark.parametrize(
    ("count", "kinds"), [((1, 1), ("fan", "camera-slip")), ((2, 2), ("fan", "mass")), ((0, 0), ("mass",))]
)
def test_world_of_named_kinds_draws_as_many_of_them(
    vehicle: Vehicle, count: tuple[int, int], kinds: tuple[str, ...]
) -> None:
    draw = {"count": count, "kinds": kinds}
    file = WorldFile.model_validate({"description": "x", "tolerances": True, "draw": draw})
    for seed in range(20):
        effects = draw_world("x", file, seed, vehicle).effects
        assert len(effects) == count[0]
        assert set(effects) <= set(kinds)


def test_deviations_follow_the_vehicle_files_tolerances(vehicle: Vehicle) -> None:
    file = load_world("empty")[1]
    worlds = [draw_world("empty", file, seed, vehicle) for seed in range(400)]
    for kind, key in (("com-offset", "x"), ("mass", "factor"), ("motor-lag", "extra_s"), ("inertia", "z")):
        values = [world.deviations[kind, key] for world in worlds]
        assert np.std(values) == pytest.approx(vehicle.tolerances[f"{kind}.{key}"], rel=0.12)
    for kind, key in (("rotor-loss", "loss_3"), ("frame-tilt", "tilt_y"), ("torque-bias", "z")):
        quantity = next(q for q in KINDS[kind].quantities if q.key == key)
        values = [world.deviations[kind, key] for world in worlds]
        assert np.std(values) == pytest.approx(quantity.tolerance, rel=0.12)
    assert min(world.deviations["actuation-delay", "delay_s"] for world in worlds) >= 0.0
    assert all(KINDS[kind].deviates for world in worlds for kind, _ in world.deviations)
    drag = [world.value("linear-drag", "dx") for world in worlds]
    assert min(drag) >= 0.0
    assert np.sqrt(np.mean(np.square(drag))) == pytest.approx(vehicle.tolerances["linear-drag.dx"], rel=0.12)


def test_heavy_tailed_deviations_are_student_t_up_to_the_clip(vehicle: Vehicle) -> None:
    build = {"distribution": "student-t", "clip": 2.0}
    file = WorldFile.model_validate({"description": "x", "tolerances": True, "build": build})
    tolerance = vehicle.tolerances["mass.factor"]
    shares = [
        draw_world("x", file, seed, vehicle).deviations["mass", "factor"] / tolerance for seed in range(600)
    ]
    assert max(map(abs, shares)) == pytest.approx(2.0)
    # P(|t| > 2) with 3 degrees of freedom is 0.139, and P(|t| > 1) 0.391.
    assert np.mean([abs(share) > 1.9999 for share in shares]) == pytest.approx(0.139, abs=0.04)
    assert np.mean([abs(share) > 1.0 for share in shares]) == pytest.approx(0.391, abs=0.06)


def test_place_or_length_is_drawn_from_the_interval_of_the_file(vehicle: Vehicle) -> None:
    draw = {
        "count": (1, 1),
        "kinds": ("slung-payload",),
        "uniform": {"slung-payload.length_m": (0.8, 0.9)},
    }
    file = WorldFile.model_validate({"description": "x", "tolerances": True, "draw": draw})
    drawn = [draw_world("x", file, seed, vehicle).effects["slung-payload"] for seed in range(20)]
    assert all(0.8 <= values["length_m"] <= 0.9 for values in drawn)
    assert all(0.02 <= values["damping"] <= 0.06 for values in drawn)


def test_world_without_tolerances_is_neutral(vehicle: Vehicle) -> None:
    world = draw_world("quiet", load_world("quiet")[1], 3, vehicle)
    assert world.value("thrust-gain", "gain") == 1.0
    assert world.value("linear-drag", "dx") == 0.0
    assert world.value("mass", "factor") == 1.0


def test_kinds_have_the_names_keys_and_sizes_of_the_hosts_library() -> None:
    """Two tables written apart; the documentation fixes names and keys, and "typical" must mean the same."""
    library = load_effects()
    inside = {kind.name for kind in KINDS.values() if not kind.outside}
    assert set(library) == inside
    for name in inside:
        rows = [(p.key, p.typical, p.neutral) for p in library[name].parameters if not p.form]
        assert [(q.key, q.typical, q.neutral) for q in KINDS[name].quantities] == rows


def test_generators_of_different_purposes_do_not_repeat_each_other() -> None:
    draws = [world_generator(1, purpose).integers(2**62) for purpose in Purpose]
    draws += [
        flight_generator(1, flight, purpose).integers(2**62) for purpose in Purpose for flight in (0, 1)
    ]
    assert len(set(draws)) == len(draws)
    with pytest.raises(ValueError, match="must not be negative"):
        world_generator(-1, Purpose.KINDS)


def test_session_uid_names_seed_and_flight_and_fits_64_bits() -> None:
    flights = [(seed, flight) for seed in range(20) for flight in range(20)]
    uids = {session_uid(*each, at_port=at_port) for each in flights for at_port in (False, True)}
    assert len(uids) == 800
    assert all(0 < uid < 2**64 for uid in uids)


def test_world_file_read_from_text_is_frozen() -> None:
    file = WorldFile(description="x", tolerances=False)
    with pytest.raises(ValueError, match="frozen"):
        file.description = "y"
