"""The table of rules: the value of every threshold, and the values derived from them."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from types import ModuleType

import pytest

from trimtab.host.effects import load_effects
from trimtab.host.trace import search
from trimtab.host.trace.decision import rules
from trimtab.host.trace.decision.rules import CHOSEN, MEASURED, RULES, Rules
from trimtab.host.trace.flight_fit import fit as flight_fit
from trimtab.host.trace.flight_fit import recording, whitening
from trimtab.host.trace.next_flight import separation
from trimtab.host.trace.segment_fit import fit as segment_fit

EXPECTED: Mapping[str, float | tuple[float, ...]] = {
    # Evidence.
    "odds": 20.0,
    "prior_odds_against": 40.0,
    "slab_sigma": 2.0,
    "slab_halvings": 3,
    "disturbance_correlation": 0.75,
    "max_effects": 6,
    "worth_fitting_nats": 12.0,
    "hopeless_nats": 30.0,
    "noise_dependent_spikes": 2.5,
    "usual_variance_factor": 1.5,
    "form_share": 0.1,
    "swap_share": 0.5,
    "present_spikes": 1.0,
    "present_sigma": 2.0,
    "far_tolerances": 2.0,
    "carrier_spikes": 4.0,
    "far_error_m": 0.05,
    "worse_fit_ratio": 1.5,
    "least_gain_beside_memory": 0.1,
    "memory_form_share": 0.01,
    "unsupported_share": 0.25,
    "detectable_sigma": 4.2,
    "majority": 0.5,
    "open_probability": 0.5,
    # Unexplained residual.
    "repeat_z": 3.0,
    "force_floor_m_s2": 0.06,
    "torque_floor_rad_s2": 0.8,
    "equation_error_share": 0.1,
    "line_ratio": 3.5,
    "line_ratio_with_memory": 10.0,
    "line_false_alarm": 1e-3,
    "line_min_hz": 0.3,
    "line_max_hz": 4.0,
    "pulse_ratio": 0.95,
    "pulse_min_s": 2.0,
    "pulse_max_s": 5.5,
    "excited_power_share": 0.02,
    "flight_repeat_share": 0.08,
    "flight_repeat_chance": 0.03,
    "visible_error_m": 0.003,
    "repeat_standard_errors": 2.0,
    "equation_error_amplitude": 0.2,
    "equation_error_m": 0.01,
    "worsened_ratio": 1.5,
    "worsened_m": 0.01,
    "repeat_shift_s": 1.0,
    "repeat_min_s": 3.0,
    "excess_force_m_s2": 0.5,
    "excess_torque_rad_s2": 3.0,
    # Uncertainty.
    "temper": (4.4, 2.7, 2.6, 2.0),
    "min_widening": 1.44,
    "min_widening_flights": 8.0,
    "widening_prior_flights": 7.0,
    "widening_pieces": 4,
    # Amount of data.
    "position_sigma_floor_m": 1e-3,
    "attitude_sigma_floor_rad": 3e-3,
    "rate_sigma_floor_rad_s": 5e-3,
    "force_sigma_floor_m_s2": 0.02,
    "mounting_sigma_rad": 0.001,
    "free_mounting_sigma_rad": 0.1,
    "torque_sigma_rad_s2": 0.3,
    "gyro_bias_sigma_rad_s": 0.02,
    "force_bias_sigma_m_s2": 0.05,
    "free_force_bias_sigma_m_s2": 0.5,
    "session_thrust_sigma": 0.05,
    "min_segments": 5,
    "min_poses": 100,
    "min_tracking_poses": 10,
    "flight_fit_min_s": 9.6,
    "flight_fit_pose_s": 0.04,
    "hover_extent_m": 0.3,
    "bins_per_order": 168,
    "missing_share": 0.4,
    "min_coverage": 0.5,
    "calibration_share": 0.25,
    # Quality of the data.
    "gap_s": 0.2,
    "saturation_s": 0.1,
    "saturation_low": 0.01,
    "saturation_high": 0.99,
    "saturation_share": 0.01,
    "tilt_max_rad": 1.3089969389957472,
    "pitch_max_rad": 1.3962634015954636,
    "clock_jump_s": 0.003,
    "late_recovery_s": 1.0,
    "late_pose_s": 0.05,
    "late_share": 0.25,
    "clock_drift_s": 0.002,
    "clear_m": 0.05,
    "low_m": 0.1,
    "support_ratio": 1.3,
    "level_speed_m_s": 0.15,
    "powered_share": 0.5,
    "impact_g": 2.0,
    "free_height_m": 0.3,
    "still_m": 0.02,
    "resting_thrust_g": 0.3,
    "sparse_rate_hz": 20.0,
    "rate_drop_share": 0.5,
    # Description of a disturbance outside the library.
    "min_skill": 0.1,
    "clear_form_skill": 0.5,
    "form_skill_margin": 0.05,
    "leading_share": 0.35,
    "shown_slack_m": 0.1,
    "one_heading": 0.995,
    # Rotor speeds.
    "rotor_speed_sigma": 0.002,
    "rotor_scale_sigma": 0.02,
    "rotor_age_sigma_s": 0.01,
    # Comparison of hovers.
    "hover_block_s": 2.0,
    "hover_margin_s": 0.5,
    "hover_min_s": 4.0,
    "hover_floor": 0.003,
    "hover_scatters": (0.25, 0.5, 1.0),
    "hover_handling": (0.1, 0.3, 1.0),
    "change_odds_against": 10.0,
    "hover_thrust_sigmas": (0.005, 0.01, 0.02, 0.05),
    "rotor_tilt_sigma_rad": 0.03490658503988659,
    "thrust_curve_linear": (0.4, 0.6, 0.8, 1.0),
}

OUTSIDE_THE_TABLE: Mapping[ModuleType, Mapping[str, float]] = {
    segment_fit: {"SEGMENTS_SETTLED": 0.2},
    recording: {"FLIGHT_BIN_S": 0.04},
    flight_fit: {"LOOP_SETTLED": 0.3},
    search: {"BEAM": 25},
    separation: {"SIGMA_MAX": 100.0},
}

TABLE = {row.name: row for row in rules.table()}


def test_every_rule_has_an_expected_value_in_the_order_of_the_table() -> None:
    assert list(TABLE) == list(EXPECTED)
    assert [f.name for f in fields(Rules)] == list(EXPECTED)


@pytest.mark.parametrize(("name", "value"), EXPECTED.items(), ids=list(EXPECTED))
def test_rule_has_the_value_that_it_was_calibrated_to(name: str, value: float | tuple[float, ...]) -> None:
    assert getattr(RULES, name) == pytest.approx(value, rel=1e-12)
    assert type(getattr(RULES, name)) is type(value)
    assert TABLE[name].value == getattr(RULES, name)


@pytest.mark.parametrize("name", EXPECTED)
def test_rule_states_unit_meaning_and_source(name: str) -> None:
    row = TABLE[name]
    assert row.unit.strip()
    assert row.meaning.strip()
    assert row.meaning.endswith(".")
    assert row.source in (MEASURED, CHOSEN)


@pytest.mark.parametrize(
    ("suffix", "unit"),
    [
        ("_m_s2", "m/s^2"),
        ("_rad_s2", "rad/s^2"),
        ("_m_s", "m/s"),
        ("_nats", "nats"),
        ("_rad", "rad"),
        ("_hz", "Hz"),
        ("_g", "g"),
        ("_m", "m"),
        ("_s", "s"),
    ],
)
def test_rule_whose_name_ends_in_a_unit_has_that_unit(suffix: str, unit: str) -> None:
    longer = {"_s": ("_m_s", "_rad_s")}.get(suffix, ())
    named = [name for name in EXPECTED if name.endswith(suffix) and not name.endswith(tuple(longer))]
    assert named
    assert {TABLE[name].unit for name in named} == {unit}


def test_table_of_other_rules_has_their_values() -> None:
    assert rules.table(replace(RULES, odds=100.0))[0].value == 100.0


def test_values_derived_from_the_odds_are_as_expected() -> None:
    assert RULES.tie_nats == pytest.approx(2.995732273553991, rel=1e-12)
    assert RULES.alias_probability == pytest.approx(0.05, rel=1e-12)
    assert RULES.undecided_sigma == pytest.approx(2.4477468306808166, rel=1e-12)
    assert RULES.prior_log_odds == pytest.approx(-3.6888794541139363, rel=1e-12)


def test_values_derived_from_the_odds_change_with_them() -> None:
    other = replace(RULES, odds=100.0, prior_odds_against=10.0)
    assert math.exp(other.tie_nats) == pytest.approx(100.0)
    assert other.alias_probability == pytest.approx(0.01)
    # Two effects separated by this many sigma have a likelihood ratio equal to the odds.
    assert math.exp(0.5 * other.undecided_sigma**2) == pytest.approx(100.0)
    assert math.exp(other.prior_log_odds) == pytest.approx(0.1)


def test_data_limits_are_consistent_with_the_whitening() -> None:
    assert pytest.approx(20 * whitening.CHANNELS * recording.FLIGHT_BIN_S) == RULES.flight_fit_min_s
    assert RULES.flight_fit_pose_s == recording.FLIGHT_BIN_S
    assert RULES.bins_per_order == 14 * whitening.CHANNELS


def test_rules_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        RULES.odds = 10.0  # pyright: ignore[reportAttributeAccessIssue]  # frozen


def test_every_rule_is_read_somewhere_in_tracing() -> None:
    package = Path(rules.__file__).parents[1]
    read = {
        node.attr
        for path in package.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
    }
    assert sorted(set(EXPECTED) - read) == []


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        pytest.param(module, name, value, id=f"{module.__name__.rpartition('.')[2]}.{name}")
        for module, values in OUTSIDE_THE_TABLE.items()
        for name, value in values.items()
    ],
)
def test_constant_outside_the_table_has_the_expected_value(
    module: ModuleType, name: str, value: float
) -> None:
    assert getattr(module, name) == pytest.approx(value, rel=1e-12)


def test_discrepancies_have_the_values_that_they_were_calibrated_to() -> None:
    parameters = {
        f"{effect.name}.{parameter.key}": parameter
        for effect in load_effects().values()
        for parameter in effect.parameters
        if not parameter.form
    }
    segments = {name: p.discrepancy for name, p in parameters.items() if p.discrepancy != 0.05}
    loop = {name: p.loop_discrepancy for name, p in parameters.items() if p.loop_discrepancy != 0.01}
    assert segments == {
        "motor-lag.extra_s": 0.25,
        "actuation-delay.delay_s": 0.4,
        "mocap-latency.latency_s": 0.1,
        "inertia.x": 0.2,
        "inertia.y": 0.2,
        "inertia.z": 0.2,
        "slung-payload.ratio": 0.15,
        "slung-payload.length_m": 1.0,
    }
    assert loop == {"motor-lag.extra_s": 0.05, "translational-lift.k": 0.05}
