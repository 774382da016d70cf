"""The parameter space: columns, tolerances, and the effects of unknown quantities."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.effects import load_effects
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
    assert len(parameter_space.owners["rotor-loss"]) == 4


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
