"""The equation of each effect against numbers computed by hand; neutral values change nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.parts import part
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.effects import compose_feedforward, load_effects
from trimtab.host.models import dynamics, slots

EFFECTS = load_effects()
S = 0.088


@dataclass(frozen=True, kw_only=True)
class MadeUpRotor:
    position_m: tuple[float, float, float]
    spin: str


@dataclass(frozen=True, kw_only=True)
class MadeUpAirframe:
    mass_kg: float
    inertia_kg_m2: tuple[float, float, float]
    rotors: tuple[MadeUpRotor, ...]
    thrust_max_n: float
    thrust_curve: tuple[float, float]
    torque_per_thrust_m: float
    motor_lag_s: float


VEHICLE = MadeUpAirframe(
    mass_kg=0.752,
    inertia_kg_m2=(2.5e-3, 2.1e-3, 4.3e-3),
    rotors=tuple(
        MadeUpRotor(position_m=(x, y, 0.0), spin=spin)
        for x, y, spin in ((S, S, "ccw"), (-S, -S, "ccw"), (S, -S, "cw"), (-S, S, "cw"))
    ),
    thrust_max_n=8.5,
    thrust_curve=(0.0, 1.0),
    torque_per_thrust_m=0.022,
    motor_lag_s=0.033,
)
COMMAND = (2.0, 1.9, 1.8, 2.1)


def state(seed: int = 0) -> list[float]:
    rng = np.random.default_rng(seed)
    x = 0.5 * rng.standard_normal(16)
    x[2] -= 2.5
    x[12:] = 1.8 + 0.2 * rng.standard_normal(4)
    return [float(value) for value in x]


def level(v=(0.0, 0.0, 0.0), thrust=1.8) -> list[float]:
    return [0.0, 0.0, -1.0, *v, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *(thrust,) * 4]


def rates(effects, x, **kwargs):
    return np.array(dynamics.derivative(FLOAT, VEHICLE, effects, x, COMMAND, **kwargs))


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_effect_neutral_changes_nothing(name):
    effect = EFFECTS[name]
    x = state(3)
    np.testing.assert_allclose(
        rates([(effect, effect.neutral)], x, voltage_ratio=0.9), rates([], x), rtol=0, atol=1e-13
    )


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - {"wind", "mocap-latency", "actuation-delay"}))
def test_effect_typical_changes_something(name):
    effect = EFFECTS[name]
    theta = [parameter.neutral + parameter.typical for parameter in effect.parameters]
    x = state(4)
    assert np.abs(rates([(effect, theta)], x, voltage_ratio=0.9) - rates([], x)).max() > 1e-3


def test_linear_drag_level_flight_opposes_each_axis():
    change = rates([part("linear-drag", 0.4, 0.3, 0.2)], level((2.0, -1.0, 0.5))) - rates(
        [], level((2.0, -1.0, 0.5))
    )
    np.testing.assert_allclose(change[3:6], (-0.8, 0.3, -0.1), atol=1e-14)


def test_quadratic_drag_level_flight_grows_with_speed_times_velocity():
    v = (3.0, 4.0, 0.0)
    change = rates([part("quadratic-drag", 0.03)], level(v)) - rates([], level(v))
    np.testing.assert_allclose(change[3:6], (-0.45, -0.6, 0.0), atol=1e-9)


def test_wind_at_rest_acts_through_the_drag():
    parts = [part("linear-drag", 0.4, 0.3, 0.2), part("wind", 1.0, -2.0)]
    np.testing.assert_allclose(
        (rates(parts, level()) - rates([], level()))[3:6], (0.4, -0.6, 0.0), atol=1e-14
    )
    np.testing.assert_array_equal(rates(parts[1:], level()), rates([], level()))


def test_thrust_gain_and_inverse_mass_accelerate_alike():
    x = state(5)
    gain = rates([part("thrust-gain", 0.9)], x)
    mass = rates([part("mass", 1.0 / 0.9)], x)
    np.testing.assert_allclose(gain[3:6], mass[3:6], rtol=1e-13)


def test_battery_sag_scales_thrust_by_a_power_of_the_voltage_ratio():
    change = rates([part("battery-sag", 2.0)], level(), voltage_ratio=0.9)
    np.testing.assert_allclose(change[5], 9.81 - 0.81 * 7.2 / 0.752, rtol=1e-13)


def test_motor_lag_slows_the_rotor_thrusts():
    x = level()
    fast, slow = rates([], x), rates([part("motor-lag", 0.033)], x)
    np.testing.assert_allclose(slow[12:], 0.5 * fast[12:], rtol=1e-13)


@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_uneven_lag_slows_falling_thrust_and_hastens_rising_thrust(ratio):
    rising, falling = level(thrust=1.0), level(thrust=3.0)
    theta = [(EFFECTS["uneven-lag"], (ratio, 0.0))]
    up, down = rates(theta, rising)[12:], rates(theta, falling)[12:]
    np.testing.assert_allclose(up, 0.5 * (1.0 + ratio) * rates([], rising)[12:], rtol=1e-13)
    np.testing.assert_allclose(down, 0.5 * (1.0 + ratio) / ratio * rates([], falling)[12:], rtol=1e-13)


@pytest.mark.parametrize("ratio", [0.6, 1.0, 3.0])
@pytest.mark.parametrize("lacking", [-4.0, -1.0, -0.2, 0.0, 0.2, 1.0, 4.0])
def test_uneven_lag_of_noisy_commands_is_the_mean_over_the_noise(ratio, lacking):
    """Commands are 2 N with normal noise; their mean is `lacking` standard deviations above the thrust."""
    noise_n = 0.01 * 2.0
    thrust_n = 2.0 - lacking * noise_n
    parts = [(EFFECTS["uneven-lag"], (ratio, 0.01))]
    (driven_n,) = slots.driven_thrusts_n(FLOAT, VEHICLE, parts, [2.0])
    (lag_s,) = slots.rotor_lags_s(FLOAT, parts, 1.0, [driven_n], [thrust_n])
    points, weights = np.polynomial.hermite_e.hermegauss(200)
    command_n = 2.0 + noise_n * points - thrust_n
    over_lag = np.where(command_n > 0.0, 0.5 * (1.0 + ratio), 0.5 * (1.0 + ratio) / ratio)
    mean = float(np.average(command_n * over_lag, weights=weights))
    assert (driven_n - thrust_n) / lag_s == pytest.approx(mean, abs=0.08 * abs(ratio - 1.0) * noise_n + 1e-9)


def test_dead_zone_holds_the_thrust_of_its_middle():
    hover = 0.752 * 9.81 / 4.0
    command = [hover * (1.05 + off) for off in (0.0, 0.02, -0.05, 0.2)]
    driven = slots.driven_thrusts_n(FLOAT, VEHICLE, [(EFFECTS["dead-zone"], (0.08, 1.05))], command)
    np.testing.assert_allclose(driven[:3], [1.05 * hover] * 3, atol=2e-4 * hover)
    np.testing.assert_allclose(driven[3], command[3], atol=1e-4 * hover)


def test_com_offset_moves_the_lever_of_every_rotor():
    x, y = 0.004, -0.003
    rotors = (
        MadeUpRotor(position_m=(r.position_m[0] - x, r.position_m[1] - y, 0.0), spin=r.spin)
        for r in VEHICLE.rotors
    )
    moved = replace(VEHICLE, rotors=tuple(rotors))
    s = state(6)
    expected = dynamics.derivative(FLOAT, moved, [], s, COMMAND)
    np.testing.assert_allclose(rates([part("com-offset", x, y, 0.0)], s), expected, atol=1e-12)


def test_mocap_latency_adds_to_the_pose_path_only():
    parts = [part("mocap-latency", 0.012)]
    assert slots.mocap_latency_s(FLOAT, parts) == 0.012
    np.testing.assert_array_equal(rates(parts, state(7)), rates([], state(7)))


def test_compose_feedforward_gain_and_mass_multiply_and_drag_adds():
    block = compose_feedforward(
        [
            part("thrust-gain", 0.9),
            part("mass", 1.25),
            part("linear-drag", 0.4, 0.3, 0.2),
            part("wind", 2.0, 0.0),
            part("motor-lag", 0.01),
            part("mocap-latency", 0.015),
        ]
    )
    assert block["gain"] == pytest.approx(0.72)
    assert block["linear_drag"] == (0.4, 0.3, 0.2)
    assert block["wind_ned"] == (2.0, 0.0, 0.0)
    assert block["prediction_time_s"] == 0.015


def test_compose_feedforward_leaves_the_sag_to_the_voltage_on_board():
    parts = [part("thrust-gain", 1.1), part("battery-sag", 2.0)]
    block = compose_feedforward(parts)
    assert (block["gain"], block["voltage_exponent"]) == (1.1, 2.0)


def test_compose_feedforward_of_an_unknown_entry_names_effect_and_entry():
    wrong = replace(EFFECTS["mass"], to_feedforward=lambda theta: {"lift": 1.0})
    with pytest.raises(ValueError, match="effect mass: the feed-forward block has no 'lift'"):
        compose_feedforward([(wrong, (1.1,))])


def test_compose_feedforward_nothing_is_the_neutral_block():
    assert compose_feedforward([]) == {
        "gain": 1.0,
        "bias_ned": (0.0, 0.0, 0.0),
        "linear_drag": (0.0, 0.0, 0.0),
        "quadratic_drag": (0.0, 0.0, 0.0),
        "attitude_offset": (0.0, 0.0),
        "prediction_time_s": 0.0,
        "wind_ned": (0.0, 0.0, 0.0),
        "voltage_exponent": 0.0,
    }
