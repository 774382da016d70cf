"""Forms of effects: they act only beside their effect, and their equations against numbers by hand."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from tests.host.effects.test_effects import COMMAND, EFFECTS, VEHICLE, level, rates, state
from tests.parts import part
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.codegen import CASADI
from trimtab.host.effects import Effect, Parameter, compose_feedforward, form
from trimtab.host.models import slots
from trimtab.host.models.dynamics import derivative, rigid_body, with_thrust_rates

FORMED = sorted(name for name, effect in EFFECTS.items() if any(p.form for p in effect.parameters))
FORMS = [(name, p.key) for name in FORMED for p in EFFECTS[name].parameters if p.form]
DISSIPATIVE = (
    "linear-drag",
    "quadratic-drag",
    "thrust-inflow",
    "translational-lift",
    "gyroscopic",
    "battery-sag",
    "ground-effect",
    "actuation-delay",
    "mocap-latency",
)
HOVER_N = VEHICLE.mass_kg * GRAVITY / 4.0


def theta_of(effect: Effect, **values: float) -> tuple[float, ...]:
    """Return neutral values but for `values`."""
    return tuple(values.get(p.key, p.neutral) for p in effect.parameters)


def fast(name: str, theta: tuple[float, ...], seed: int) -> np.ndarray:
    """Return the rates at several m/s, with more thrust than at hover, a low voltage and states that move."""
    x = state(seed)
    x[2] -= 3.0
    x[3:6] = [8.0 * speed for speed in x[3:6]]
    x[12:] = [1.5 * thrust for thrust in x[12:]]
    parts = [(EFFECTS[name], theta)]
    memory = [0.1 + value for value in slots.memory_at_rest(FLOAT, VEHICLE, parts, x)]
    body = rigid_body(FLOAT, VEHICLE, parts, x, 0.9, memory=memory)
    thrust_rates = rates(parts, x, voltage_ratio=0.9)[12:].tolist()
    return np.array([*with_thrust_rates(FLOAT, VEHICLE, parts, x, body, thrust_rates), *thrust_rates])


def change(
    x: list[float], *parts: tuple[Effect, tuple[float, ...]], voltage_ratio: float = 1.0
) -> np.ndarray:
    """Return what the parts add to the rates of a state."""
    return rates(parts, x, voltage_ratio=voltage_ratio) - rates([], x, voltage_ratio=voltage_ratio)


def test_effects_with_a_form_are_listed():
    assert {"linear-drag", "quadratic-drag", "thrust-gain", "rotor-loss"} <= set(FORMED)


@pytest.mark.parametrize("name", FORMED)
def test_form_of_an_absent_effect_changes_nothing(name: str) -> None:
    effect = EFFECTS[name]
    neutral = [fast(name, effect.neutral, seed) for seed in range(3)]
    for pick in ("lower", "upper"):
        theta = tuple(getattr(p, pick) if p.form else p.neutral for p in effect.parameters)
        for seed, expected in enumerate(neutral):
            np.testing.assert_array_equal(fast(name, theta, seed), expected)
        parts = [(effect, theta)]
        assert slots.motor_lag_s(FLOAT, VEHICLE, parts) == VEHICLE.motor_lag_s
        assert slots.mocap_latency_s(FLOAT, parts) == slots.command_delay_s(FLOAT, parts) == 0.0


@pytest.mark.parametrize(("name", "key"), FORMS)
def test_form_of_a_present_effect_changes_something(name: str, key: str) -> None:
    effect = EFFECTS[name]
    typical = {p.key: p.neutral + p.typical for p in effect.parameters if not p.form}
    formed = {**typical, key: next(p.neutral + p.typical for p in effect.parameters if p.key == key)}
    moved = [
        fast(name, theta_of(effect, **formed), seed) - fast(name, theta_of(effect, **typical), seed)
        for seed in range(3)
    ]
    assert np.abs(moved).max() > 1e-3


@pytest.mark.parametrize(("name", "key"), FORMS)
def test_form_is_no_strength_and_holds_its_neutral_value_within_its_range(name: str, key: str) -> None:
    parameter = next(p for p in EFFECTS[name].parameters if p.key == key)
    assert parameter.lower <= parameter.neutral < parameter.upper
    assert parameter.tolerance == parameter.typical
    assert not parameter.strength


@pytest.mark.parametrize("name", FORMED)
def test_effect_with_a_form_has_finite_slopes_without_thrust(name: str) -> None:
    effect = EFFECTS[name]
    typical = np.array([p.neutral + p.typical for p in effect.parameters])
    x, theta = ca.SX.sym("x", 16), ca.SX.sym("theta", len(typical))
    parts = [(effect, ca.vertsplit(theta))]
    command = [ca.SX(value) for value in COMMAND]
    rate = ca.vertcat(*derivative(CASADI, VEHICLE, parts, ca.vertsplit(x), command, voltage_ratio=0.9))
    slopes = ca.Function("slopes", [x, theta], [ca.jacobian(rate, ca.vertcat(x, theta))])
    assert np.isfinite(np.array(slopes(level((1.0, -1.0, 0.5), thrust=0.0), typical))).all()


@pytest.mark.parametrize("name", DISSIPATIVE)
def test_effect_that_only_dissipates_or_delays_has_no_negative_values(name: str) -> None:
    strengths = [p for p in EFFECTS[name].parameters if not p.form]
    assert [p.key for p in strengths if p.lower < 0.0] == []
    assert all(p.neutral == 0.0 for p in strengths)


@pytest.mark.parametrize("forms", [("f", "k"), ("f",)], ids=["before-another", "alone"])
def test_effect_whose_form_follows_no_other_parameter_is_refused(forms: tuple[str, ...]) -> None:
    k = Parameter(
        key="k", unit="1", neutral=0.0, typical=1.0, tolerance=0.1, lower=0.0, upper=5.0, description="d"
    )
    made = {"k": k, "f": form("f", 0.2, -1.0, 1.0, "a form")}
    replace(EFFECTS["mass"], parameters=(made["k"], made["f"]))
    with pytest.raises(ValueError, match="effect mass: form parameters must follow"):
        replace(EFFECTS["mass"], parameters=tuple(made[key] for key in forms))


def test_form_with_a_neutral_value_outside_its_range_is_refused() -> None:
    with pytest.raises(ValueError, match="parameter f: neutral"):
        form("f", 0.2, 0.5, 1.0, "a form")


def test_linear_drag_across_the_rotors_grows_with_rotor_speed() -> None:
    # Four times the thrust is twice the speed: the share of a half grows the drag by a half.
    added = change(level((2.0, -1.0, 0.5), thrust=4.0 * HOVER_N), part("linear-drag", 0.4, 0.3, 0.2, 0.5))
    np.testing.assert_allclose(added[3:6], (-1.2, 0.45, -0.1), atol=1e-8)


def test_linear_drag_above_the_centre_of_mass_turns_the_vehicle_backwards() -> None:
    added = change(level((2.0, -1.0, 0.5), thrust=HOVER_N), part("linear-drag", 0.4, 0.3, 0.2, 0.0, 0.05))
    # Forces of 0.752 kg times -0.8 and 0.3 m/s^2, at an arm of 0.05 m: nose up, and to the right.
    np.testing.assert_allclose(added[9:12], (0.01128 / 2.5e-3, 0.03008 / 2.1e-3, 0.0), atol=1e-8)
    np.testing.assert_allclose(added[3:6], (-0.8, 0.3, -0.1), atol=1e-8)


def test_quadratic_drag_differs_from_the_side_and_from_above() -> None:
    added = change(level((2.0, -1.0, 2.0)), part("quadratic-drag", 0.03, 0.2, 0.5))
    np.testing.assert_allclose(added[3:6], (-0.144, 0.108, -0.27), atol=1e-9)
    block = compose_feedforward([part("quadratic-drag", 0.03, 0.2, 0.5)])
    assert block["quadratic_drag"] == pytest.approx((0.024, 0.036, 0.045))


def test_thrust_inflow_saturates_at_high_axial_speed() -> None:
    # sqrt(1 + (v / 5 m/s)^2) = 2: the share of 0.6 loses half of itself.
    fall = 5.0 * np.sqrt(3.0)
    added = change(level((0.0, 0.0, fall), thrust=HOVER_N), part("thrust-inflow", 0.5, 0.6))
    np.testing.assert_allclose(added[3:6], (0.0, 0.0, -0.5 * 0.7 * fall), atol=1e-8)


def test_thrust_inflow_damps_a_roll_by_more_than_the_equation() -> None:
    x = level(thrust=HOVER_N)
    x[9] = 2.0
    # Four rotors at y = 0.088 m: 0.5 / 4 * 0.752 kg * 2 rad/s * 4 * 0.088^2 m^2 = 5.82349e-3 N m.
    for damping, excess in ((0.0, 1.0), (0.2, 1.2)):
        added = change(x, part("thrust-inflow", 0.5, 0.0, damping))
        np.testing.assert_allclose(added[9:12], (-excess * 5.823488e-3 / 2.5e-3, 0.0, 0.0), atol=1e-6)


def test_translational_lift_saturates_and_grows_with_rotor_speed() -> None:
    v = (6.0, 8.0, 0.0)
    saturated = change(level(v, thrust=HOVER_N), part("translational-lift", 0.015, 0.0, 0.5))
    np.testing.assert_allclose(saturated[3:6], (0.0, 0.0, -1.0), atol=1e-8)
    grown = change(level(v, thrust=4.0 * HOVER_N), part("translational-lift", 0.015, 0.4, 0.5))
    np.testing.assert_allclose(grown[3:6], (0.0, 0.0, -1.4), atol=1e-8)


@pytest.mark.parametrize("ratio", [1.0, 1.5, 0.0])
def test_rotor_loss_takes_its_own_share_of_the_drag_torque(ratio: float) -> None:
    added = change(level(thrust=2.0), part("rotor-loss", 0.1, 0.0, 0.0, 0.0, 0.0, ratio))
    # Rotor 1 turns counter-clockwise and so yaws the vehicle to the right with 0.022 m * 2 N.
    np.testing.assert_allclose(added[11], -ratio * 0.1 * 0.044 / 4.3e-3, atol=1e-12)
    np.testing.assert_allclose(added[5], 0.2 / 0.752, atol=1e-12)


def test_rotor_loss_grows_with_the_speed_of_its_rotor() -> None:
    added = change(level(thrust=4.0 * HOVER_N), part("rotor-loss", 0.1, 0.0, 0.0, 0.0, 0.5))
    np.testing.assert_allclose(added[5], 0.15 * GRAVITY, atol=1e-8)


def test_torque_bias_grows_with_the_thrust() -> None:
    added = change(level(thrust=2.0 * HOVER_N), part("torque-bias", 2.0, -1.0, 0.5, 0.5))
    np.testing.assert_allclose(added[9:12], (3.0, -1.5, 0.75), atol=1e-12)


@pytest.mark.parametrize(("height_m", "k"), [(1.7, 0.02), (0.7, 0.04), (0.5, 0.044), (3.0, 0.0)])
def test_ground_effect_fades_with_height(height_m: float, k: float) -> None:
    x = level(thrust=HOVER_N)
    x[2] = -height_m
    added = change(x, part("ground-effect", 0.04, 0.5))
    np.testing.assert_allclose(added[5], -GRAVITY * (1.0 / (1.0 - k / height_m**2) - 1.0), atol=1e-12)


def test_battery_sag_of_a_loaded_motor_has_a_greater_exponent() -> None:
    added = change(level(thrust=4.0 * HOVER_N), part("battery-sag", 2.0, 0.5), voltage_ratio=0.9)
    np.testing.assert_allclose(added[5], 4.0 * GRAVITY * (1.0 - 0.729), atol=1e-8)


def test_thrust_gain_error_grows_with_rotor_speed() -> None:
    added = change(level(thrust=4.0 * HOVER_N), part("thrust-gain", 0.9, 0.5))
    np.testing.assert_allclose(added[5], 4.0 * GRAVITY * 0.15, atol=1e-8)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_offset_of_the_centre_of_mass_adds_the_inertia_of_the_mass_that_moved(share: float) -> None:
    """Two point masses, one moved: their moments about the new centre, by hand."""
    mass, moved = VEHICLE.mass_kg, np.array([0.03, -0.02, 0.0])
    centre = share * moved
    masses, places = (share * mass, (1.0 - share) * mass), (moved - centre, -centre)
    expected = np.zeros((3, 3))
    for m, r in zip(masses, places, strict=True):
        expected += m * (r @ r * np.eye(3) - np.outer(r, r))
    offset = part("com-offset", centre[0], centre[1], 1.0 / share - 1.0)
    found = slots.inertia(FLOAT, VEHICLE, [offset], mass)
    moments, product = np.subtract(found[:3], VEHICLE.inertia_kg_m2), found[3]
    np.testing.assert_allclose(moments, np.diag(expected), rtol=1e-12)
    assert product == pytest.approx(expected[0, 1], rel=1e-12)
    assert expected[0, 2] == expected[1, 2] == 0.0
    scaled = slots.inertia(FLOAT, VEHICLE, [offset, part("inertia", 1.2, 1.0, 1.0)], mass)
    assert scaled[0] == pytest.approx(1.2 * VEHICLE.inertia_kg_m2[0] + expected[0, 0])


@pytest.mark.parametrize("seed", [1, 2])
def test_displaced_mass_couples_roll_and_pitch_by_eulers_equation(seed: int) -> None:
    """The angular acceleration with the whole inertia matrix, by numpy."""
    effect = EFFECTS["com-offset"]
    theta = theta_of(effect, x=0.03, y=-0.02, spread=3.0)
    x = state(seed)
    jx, jy, jz, jxy = slots.inertia(FLOAT, VEHICLE, [(effect, theta)], VEHICLE.mass_kg)
    J = np.array([[jx, jxy, 0.0], [jxy, jy, 0.0], [0.0, 0.0, jz]])
    point_mass = replace(effect, added_inertia_kg_m2=None)
    rate = np.array(x[9:12])
    J0 = np.diag(VEHICLE.inertia_kg_m2)
    torque = J0 @ rates([(point_mass, theta)], x)[9:12] + np.cross(rate, J0 @ rate)
    expected = np.linalg.solve(J, torque - np.cross(rate, J @ rate))
    np.testing.assert_allclose(rates([(effect, theta)], x)[9:12], expected, rtol=1e-9)
