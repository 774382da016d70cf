"""The parameter space: columns, tolerances, and the effects of unknown quantities."""

from __future__ import annotations

import numpy as np
import pytest

from tests.host.trace.builders import build_effect, build_space
from trimtab.host.base.errors import UsageError
from trimtab.host.effects import load_effects
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.parameters import UNKNOWN, space
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
EFFECTS = load_effects()


def test_space_holds_every_candidate_but_mass_and_the_adjustments() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    rotors = {f"rotor-loss.loss_{i}" for i in (1, 2, 3, 4)}
    assert set(parameter_space.candidates) == set(EFFECTS) - {"mass", "rotor-loss"} | rotors
    assert "mass" in parameter_space.groups
    assert "thrust-curve" not in parameter_space.groups
    assert len(parameter_space.prior.spike) == len(parameter_space.columns)


def test_space_takes_the_vehicle_files_tolerances() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    column = next(c for c in parameter_space.columns if (c.owner, c.key) == ("thrust-gain", "gain"))
    assert column.tolerance == VEHICLE.tolerances["thrust-gain.gain"]


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_space_with_something_unknown_replaces_the_effects_it_explains(unknown: str) -> None:
    parameter_space = space(VEHICLE, EFFECTS, [unknown])
    replaced = {e.name for e in EFFECTS.values() if unknown in (*e.replaced_by, *e.freed_by)}
    assert not replaced & {parameter_space.effect(candidate).name for candidate in parameter_space.candidates}


def test_space_of_logs_without_inputs_has_only_effects_that_thrust_does_not_explain() -> None:
    parameter_space = space(VEHICLE, EFFECTS, ["thrust"])
    assert set(EFFECTS) - set(parameter_space.owners) == {
        "thrust-gain", "battery-sag", "ground-effect", "rotor-loss", "motor-lag", "actuation-delay",
        "thrust-inflow", "translational-lift", "uneven-lag", "dead-zone",
    }  # fmt: skip


def test_thrust_commanded_in_newton_does_not_take_the_tolerance_of_the_greatest_thrust() -> None:
    guessed = VEHICLE.replace(
        tolerances={**VEHICLE.tolerances, "thrust-gain.gain": 0.15, "mass.factor": 0.004}
    )

    def tolerances(*, thrust_commanded: bool) -> dict[str, float]:
        made = space(guessed, EFFECTS, thrust_commanded=thrust_commanded)
        return {f"{c.owner}.{c.key}": c.tolerance for c in made.columns}

    motors, newton = tolerances(thrust_commanded=False), tolerances(thrust_commanded=True)
    default = EFFECTS["thrust-gain"].parameters[0].tolerance
    assert (motors.pop("thrust-gain.gain"), newton.pop("thrust-gain.gain")) == (0.15, default)
    assert motors == newton
    assert newton["mass.factor"] == 0.004


def test_space_with_an_undefined_unknown_raises() -> None:
    with pytest.raises(ValueError, match="weather"):
        space(VEHICLE, EFFECTS, ["weather"])


def test_space_values_and_clipping_go_through_the_scales() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    index = parameter_space.groups["thrust-gain"][0]
    theta_scaled = np.zeros(len(parameter_space.columns))
    theta_scaled[index] = -1.0
    assert parameter_space.values(theta_scaled)[index] == pytest.approx(
        1.0 - EFFECTS["thrust-gain"].parameters[0].typical
    )
    theta_scaled[index] = -1e6
    assert parameter_space.values(parameter_space.clipped(theta_scaled))[index] == pytest.approx(
        EFFECTS["thrust-gain"].parameters[0].lower
    )


def test_space_admits_one_rotor_lost_of_four() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    assert parameter_space.admissible(["rotor-loss.loss_1", "com-offset"])
    assert not parameter_space.admissible(["rotor-loss.loss_1", "rotor-loss.loss_3"])
    assert parameter_space.effect("rotor-loss.loss_3").name == "rotor-loss"
    losses = [parameter_space.groups[f"rotor-loss.loss_{i}"] for i in (1, 2, 3, 4)]
    assert sorted(sum(losses, ())) == list(parameter_space.owners["rotor-loss"][:4])


def test_space_keeps_the_forms_of_an_effect_apart_from_its_values() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    keys = {
        name: [parameter_space.columns[i].key for i in columns]
        for name, columns in parameter_space.forms.items()
    }
    assert keys["linear-drag"] == ["rotor_share", "height_m"]
    assert keys["rotor-loss.loss_1"] == keys["rotor-loss.loss_4"] == ["rotor_share", "torque_ratio"]
    assert keys["mass"] == []
    assert set(keys) == set(parameter_space.groups)
    values = {i for columns in parameter_space.groups.values() for i in columns}
    forms = {i for columns in parameter_space.forms.values() for i in columns}
    assert forms == {i for i, column in enumerate(parameter_space.columns) if column.form}
    assert values == set(range(len(parameter_space.columns))) - forms


def test_prior_fixes_only_forms_whose_effect_is_in_the_linearisation_but_not_selected() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    forms = {name: list(columns) for name, columns in parameter_space.forms.items()}
    selected = ["linear-drag", "rotor-loss.loss_2", "motor-lag"]
    linearised_with = ["linear-drag", "rotor-loss.loss_1", "quadratic-drag"]
    sigma = 1.0 / np.sqrt(parameter_space.prior.precision(selected, linearised_with))
    for i, column in enumerate(parameter_space.columns):
        if i in forms["quadratic-drag"]:
            assert sigma[i] < 0.01
        elif column.form:
            assert sigma[i] == pytest.approx(column.tolerance / column.scale)
    strengths = [i for name in selected for i in parameter_space.groups[name]]
    assert (sigma[strengths] >= RULES.slab_sigma).all()
    assert sigma[parameter_space.groups["rotor-loss.loss_1"]] < RULES.slab_sigma


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_forms_are_active_while_their_effect_is_beyond_its_tolerance(sign: float) -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    theta_scaled = np.zeros(len(parameter_space.columns))
    values = {i for columns in parameter_space.groups.values() for i in columns}
    theta_scaled[list(parameter_space.forms["torque-bias"])] = 1.0
    assert set(parameter_space.active(theta_scaled)) == values
    (index, *_) = parameter_space.groups["torque-bias"]
    column = parameter_space.columns[index]
    for share, active in ((0.999, values), (1.001, values | set(parameter_space.forms["torque-bias"]))):
        theta_scaled[index] = sign * share * column.tolerance / column.scale
        assert set(parameter_space.active(theta_scaled)) == active


def test_space_frees_what_a_log_declares_unknown() -> None:
    parameter_space = space(VEHICLE, EFFECTS, ["inertia", "pose-latency"])
    assert {"inertia", "mocap-latency"} <= set(parameter_space.freed)
    index = parameter_space.owners["mocap-latency"][0]
    assert parameter_space.columns[index].tolerance == 0.02
    assert "mocap-latency" not in parameter_space.candidates


def test_space_admits_wind_only_with_a_drag() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    assert not parameter_space.admissible(["wind"])
    assert parameter_space.admissible(["wind", "linear-drag"])
    assert parameter_space.admissible(["wind", "quadratic-drag", "motor-lag"])


@pytest.mark.parametrize(
    ("candidate", "other", "expected"),
    [
        pytest.param("linear-drag", "thrust-inflow", True, id="each-states-the-other"),
        pytest.param("uneven-lag", "dead-zone", True, id="of-the-rotors"),
        pytest.param("rotor-loss.loss_2", "com-offset", True, id="one-rotor-of-four"),
        pytest.param("com-offset", "rotor-loss.loss_2", True, id="the-other-way-round"),
        pytest.param("linear-drag", "com-offset", False, id="neither-states-the-other"),
        pytest.param("linear-drag", "linear-drag", False, id="itself"),
    ],
)
def test_aliases_are_those_that_either_effect_states(candidate: str, other: str, expected: bool) -> None:
    assert space(VEHICLE, EFFECTS).are_aliases(candidate, other) == expected


def test_an_alias_that_only_one_effect_states_counts_from_both_sides() -> None:
    made = build_space(build_effect("drag", aliases=("lift",)), "lift", "lag")
    assert made.are_aliases("drag", "lift")
    assert made.are_aliases("lift", "drag")
    assert not made.are_aliases("lag", "lift")


@pytest.mark.parametrize(
    ("candidate", "selected", "expected"),
    [
        pytest.param("wind", (), False, id="alone"),
        pytest.param("wind", ("wind", "motor-lag"), False, id="beside-another"),
        pytest.param("wind", ("linear-drag",), True, id="by-one-drag"),
        pytest.param("wind", ("quadratic-drag", "wind"), True, id="by-the-other-drag"),
        pytest.param("motor-lag", (), True, id="needs-none"),
        pytest.param("rotor-loss.loss_1", (), True, id="one-of-four-needs-none"),
    ],
)
def test_an_effect_is_carried_by_one_that_it_acts_through(
    candidate: str, selected: tuple[str, ...], expected: bool
) -> None:
    assert space(VEHICLE, EFFECTS).carried(candidate, selected) == expected


def test_check_finite_raises_with_the_parameter_that_diverges() -> None:
    parameter_space = space(VEHICLE, EFFECTS)
    sizes = np.ones(1 + len(parameter_space.columns))
    parameter_space.check_finite(sizes)
    index = parameter_space.owners["slung-payload"][1]
    sizes[1 + index] = np.nan
    with pytest.raises(UsageError, match=r"slung-payload\.length_m diverge"):
        parameter_space.check_finite(sizes)
    sizes[0] = np.inf
    with pytest.raises(UsageError, match="the model with slung-payload diverge"):
        parameter_space.check_finite(sizes)
