"""Vehicle files of `trimtab vehicle new`: valid, near published vehicles, and open about their guesses."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from trimtab.host.base.errors import UsageError
from trimtab.host.vehicle import Vehicle, load_vehicle, parse_vehicle
from trimtab.host.vehicle.typical import (
    HOVER_SHARE_MOST,
    RANGES,
    Facts,
    arm_length,
    check_range,
    parse_propeller,
    square_rotors,
    typical_file,
)

CASES = {
    "nano": (0.027, 0.046, "1.8x1.2", None, None),
    "small": (0.25, 0.075, "3x3", 4000.0, 3),
    "middle": (0.75, 0.125, "5x4.3", 2400.0, 4),
    "large": (2.5, 0.25, "10x4.7", 920.0, 4),
}


def facts_of(
    mass_kg: float, arm_m: float, propeller: str, kv: float | None = None, cells: int | None = None
) -> Facts:
    rotors = square_rotors(arm_m)
    return Facts(
        mass_kg=mass_kg, propeller=parse_propeller(propeller), rotors=rotors, kv_rpm_v=kv, cells=cells
    )


def typical(name: str) -> Vehicle:
    return parse_vehicle(typical_file(name, facts_of(*CASES[name])), name)


def within(value: float, published: float, factor: float) -> bool:
    return 1.0 / factor <= value / published <= factor


@pytest.mark.parametrize("name", CASES)
def test_file_is_valid_and_keeps_what_was_given(name: str) -> None:
    mass_kg, arm_m, _, _, cells = CASES[name]
    vehicle = typical(name)
    assert vehicle.mass_kg == mass_kg
    assert arm_length(vehicle.rotors) == pytest.approx(arm_m, abs=1e-5)
    if cells is not None:
        assert vehicle.battery.cells == cells
    hover = mass_kg * 9.81 / (4.0 * vehicle.thrust_max_n)
    low, high = vehicle.limits.thrust_headroom
    assert 2.0 * low < hover < 0.77 * high


# The factors are those that docs/guide/vehicle.md states.
def test_nano_is_near_published_crazyflies() -> None:
    vehicle, shipped = typical("nano"), load_vehicle("nano")
    x, y, z = vehicle.inertia_kg_m2
    # Crazyflie 2: 1.4e-5 to 1.7e-5 (Landry 2015, Foerster 2015); 1.03e-5, 1.95e-5 about z (ARPL).
    for published in (1.03e-5, 1.4e-5, 1.7e-5):
        assert within(x, published, 1.5)
        assert within(y, published, 1.5)
    assert within(z, 1.95e-5, 1.5)
    assert within(z, 2.9e-5, 1.5)
    assert within(vehicle.thrust_max_n, shipped.thrust_max_n, 1.5)
    assert within(vehicle.torque_per_thrust_m, shipped.torque_per_thrust_m, 1.5)
    assert within(vehicle.motor_lag_s, shipped.motor_lag_s, 1.5)
    assert within(vehicle.battery.capacity_ah, shipped.battery.capacity_ah, 1.5)


def test_middle_is_near_published_five_inch_quadrotors() -> None:
    vehicle, shipped = typical("middle"), load_vehicle("research")
    x, y, _ = vehicle.inertia_kg_m2
    for published in (0.0025, 0.0021):  # of 0.75 kg: Foehn et al. 2022; racers reach 5e-3
        assert within(x, published, 1.5)
        assert within(y, published, 1.5)
    assert within(x, 5e-3, 2.1)
    for ours, theirs in zip(vehicle.inertia_kg_m2, shipped.inertia_kg_m2, strict=True):
        assert within(ours, theirs, 1.5)
    assert within(vehicle.thrust_max_n, shipped.thrust_max_n, 1.5)
    assert within(vehicle.torque_per_thrust_m, shipped.torque_per_thrust_m, 1.5)
    assert within(vehicle.motor_lag_s, shipped.motor_lag_s, 1.5)
    assert within(vehicle.battery.capacity_ah, shipped.battery.capacity_ah, 1.5)


def test_rules_hold_for_other_published_inertias() -> None:
    # AscTec Hummingbird, as RotorPy has it (0.5 kg, 0.17 m). PX4's x500 model (2 kg, 0.25 m).
    for mass_kg, arm_m, x, z in ((0.5, 0.17, 3.65e-3, 7.03e-3), (2.0, 0.25, 0.0217, 0.04)):
        vehicle = parse_vehicle(typical_file("other", facts_of(mass_kg, arm_m, "8x4.5")), "other")
        assert within(vehicle.inertia_kg_m2[0], x, 1.5)
        assert within(vehicle.inertia_kg_m2[2], z, 1.5)


@pytest.mark.parametrize("name", CASES)
def test_guesses_are_marked_and_their_tolerances_are_wide(name: str) -> None:
    text = typical_file(name, facts_of(*CASES[name]))
    lines = {line.split(" = ")[0]: line for line in text.splitlines() if " = " in line}
    for key in ("inertia_kg_m2", "thrust_max_n", "torque_per_thrust_m", "motor_lag_s", "capacity_ah"):
        assert "# guess" in lines[key]
    assert "# given" in lines["mass_kg"]
    vehicle, measured = typical(name), load_vehicle("research")
    for effect, parameter in (("inertia", "x"), ("thrust-gain", "gain"), ("motor-lag", "extra_s")):
        assert vehicle.tolerance(effect, parameter, 0.0) > 3.0 * measured.tolerance(effect, parameter, 1.0)


def test_hover_thrust_and_curve_replace_the_guesses() -> None:
    known = facts_of(*CASES["middle"])
    facts = Facts(
        mass_kg=known.mass_kg,
        propeller=known.propeller,
        rotors=known.rotors,
        hover_share=0.25,
        thrust_curve=(0.4, 0.6),
    )
    vehicle = parse_vehicle(typical_file("known", facts), "known")
    assert vehicle.thrust_max_n == pytest.approx(0.75 * 9.80665, rel=0.01)
    assert vehicle.thrust_curve == (0.4, 0.6)
    assert vehicle.tolerance("thrust-gain", "gain", 1.0) < typical("middle").tolerance(
        "thrust-gain", "gain", 0
    )


@pytest.mark.parametrize(
    "text", ["", "5cm", "5x", "x4", "5 x 4", "5x4.3x3", "-5x4", "1e3x4", "0x4", "5x0", "٥x4"]
)
def test_propeller_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        parse_propeller(text)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 0.0, 1e9])
def test_fact_outside_its_range_is_refused(value: float) -> None:
    for key in RANGES:
        with pytest.raises(UsageError):
            check_range(key, value, key)


@pytest.mark.parametrize(
    "case",
    [(0.75, 0.05, "5x4.3", None, None), (2.5, 0.125, "5x4.3", 1000.0, 4), (0.027, 0.046, "1.8x1", 500.0, 1)],
)
def test_facts_that_contradict_each_other_are_refused(
    case: tuple[float, float, str, float | None, int | None],
) -> None:
    with pytest.raises(UsageError) as caught:
        typical_file("odd", facts_of(*case))
    assert "\n" not in str(caught.value)


def ranged(key: str) -> st.SearchStrategy[float]:
    low, high = RANGES[key]
    return st.floats(math.log(low), math.log(high)).map(lambda x: min(max(math.exp(x), low), high))


@settings(max_examples=300)
@given(
    mass_kg=ranged("mass_kg"),
    arm_m=ranged("arm_m"),
    diameter=st.integers(10, 400),
    pitch=st.integers(3, 300),
    kv=st.none() | ranged("kv"),
    cells=st.none() | st.integers(1, 24),
    hover=st.none() | st.floats(0.05, 0.9),
)
@example(mass_kg=10.0, arm_m=0.02, diameter=10, pitch=3, kv=None, cells=None, hover=None)
@example(mass_kg=0.015, arm_m=1.0, diameter=400, pitch=300, kv=30000.0, cells=24, hover=None)
@example(mass_kg=10.0, arm_m=1.0, diameter=400, pitch=300, kv=None, cells=1, hover=0.05)
def test_any_facts_in_range_give_a_valid_file_or_one_line(
    mass_kg: float,
    arm_m: float,
    diameter: int,
    pitch: int,
    kv: float | None,
    cells: int | None,
    hover: float | None,
) -> None:
    facts = Facts(
        mass_kg=mass_kg,
        propeller=parse_propeller(f"{diameter / 10}x{pitch / 10}"),
        rotors=square_rotors(arm_m),
        kv_rpm_v=kv,
        cells=cells,
        hover_share=hover,
    )
    try:
        vehicle = parse_vehicle(typical_file("any", facts), "any")
    except UsageError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert mass_kg * 9.80665 <= HOVER_SHARE_MOST * 4.0 * vehicle.thrust_max_n * 1.01


def test_greatest_thrust_that_is_given_is_kept_with_its_tolerance() -> None:
    facts = Facts(
        mass_kg=0.752, propeller=parse_propeller("5"), rotors=square_rotors(0.125), thrust_max_n=8.5
    )
    vehicle = parse_vehicle(typical_file("mine", facts), "mine")
    assert vehicle.thrust_max_n == 8.5
    assert vehicle.tolerances["thrust-gain.gain"] == 0.05
    assert vehicle.tolerances["mass.factor"] < 0.005


@pytest.mark.parametrize(("text", "diameter_m"), [("5", 0.127), ("127mm", 0.127), ("45mm", 0.045)])
def test_propeller_without_pitch_has_a_guessed_one(text: str, diameter_m: float) -> None:
    found = parse_propeller(text)
    assert found.diameter_m == pytest.approx(diameter_m)
    assert found.pitch_m == pytest.approx(0.7 * diameter_m)
    assert not found.known_pitch
