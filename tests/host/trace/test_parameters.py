"""The space that tracing searches: columns, tolerances, what a log's unknowns take out."""

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
    found = space(VEHICLE, EFFECTS)
    rotors = {f"rotor-loss.loss_{i}" for i in (1, 2, 3, 4)}
    assert set(found.candidates) == set(EFFECTS) - {"mass", "rotor-loss"} | rotors
    assert "mass" in found.groups
    assert "thrust-curve" not in found.groups
    assert len(found.prior.spike) == len(found.columns)


def test_space_takes_the_vehicle_files_tolerances() -> None:
    found = space(VEHICLE, EFFECTS)
    column = next(c for c in found.columns if (c.owner, c.key) == ("thrust-gain", "gain"))
    assert column.tolerance == VEHICLE.tolerances["thrust-gain.gain"]


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_space_with_something_unknown_replaces_the_effects_it_explains(unknown: str) -> None:
    found = space(VEHICLE, EFFECTS, [unknown])
    replaced = {e.name for e in EFFECTS.values() if unknown in (*e.replaced_by, *e.freed_by)}
    assert not replaced & {found.effect(candidate).name for candidate in found.candidates}


def test_space_of_logs_without_inputs_has_only_what_thrust_does_not_explain() -> None:
    found = space(VEHICLE, EFFECTS, ["thrust"])
    assert set(EFFECTS) - set(found.owners) == {
        "thrust-gain", "battery-sag", "ground-effect", "rotor-loss", "motor-lag", "actuation-delay",
        "thrust-inflow", "translational-lift",
    }  # fmt: skip


def test_space_with_an_unheard_of_unknown_is_refused() -> None:
    with pytest.raises(ValueError, match="weather"):
        space(VEHICLE, EFFECTS, ["weather"])


def test_space_values_and_clipping_go_through_the_scales() -> None:
    found = space(VEHICLE, EFFECTS)
    index = found.groups["thrust-gain"][0]
    theta_scaled = np.zeros(len(found.columns))
    theta_scaled[index] = -1.0
    assert found.values(theta_scaled)[index] == pytest.approx(
        1.0 - EFFECTS["thrust-gain"].parameters[0].typical
    )
    theta_scaled[index] = -1e6
    assert found.values(found.clipped(theta_scaled))[index] == pytest.approx(
        EFFECTS["thrust-gain"].parameters[0].lower
    )


def test_space_admits_one_rotor_lost_of_four() -> None:
    found = space(VEHICLE, EFFECTS)
    assert found.admissible(["rotor-loss.loss_1", "com-offset"])
    assert not found.admissible(["rotor-loss.loss_1", "rotor-loss.loss_3"])
    assert found.effect("rotor-loss.loss_3").name == "rotor-loss"
    assert len(found.owners["rotor-loss"]) == 4


def test_space_leaves_what_a_log_declares_unknown_free() -> None:
    found = space(VEHICLE, EFFECTS, ["inertia", "pose-latency"])
    assert {"inertia", "mocap-latency"} <= set(found.unknown)
    index = found.owners["mocap-latency"][0]
    assert found.columns[index].tolerance == 0.02
    assert "mocap-latency" not in found.candidates


def test_space_admits_wind_only_with_a_drag() -> None:
    found = space(VEHICLE, EFFECTS)
    assert not found.admissible(["wind"])
    assert found.admissible(["wind", "linear-drag"])
    assert found.admissible(["wind", "quadratic-drag", "motor-lag"])


def test_space_refuses_roll_outs_that_diverge_and_names_the_parameter() -> None:
    found = space(VEHICLE, EFFECTS)
    sizes = np.ones(1 + len(found.columns))
    found.check_finite(sizes)
    index = found.owners["slung-payload"][1]
    sizes[1 + index] = np.nan
    with pytest.raises(UsageError, match=r"slung-payload\.length_m diverge"):
        found.check_finite(sizes)
    sizes[0] = np.inf
    with pytest.raises(UsageError, match="the model with slung-payload diverge"):
        found.check_finite(sizes)
