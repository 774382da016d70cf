"""The joint parameter space of two sets of flights: columns, mapping to flights, bounds and Grams."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.effects.unknowns import THRUST, THRUST_CURVE, TORQUE
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import bounded_step, log_evidences
from trimtab.host.trace.joint import COMMON, JointSpace, joint_space
from trimtab.host.trace.parameters import space
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
EFFECTS = load_effects()
BEFORE, AFTER = 0, 1


def joint(*names: str, unknown: tuple[str, ...] = ()) -> JointSpace:
    effects = {name: EFFECTS[name] for name in names} if names else EFFECTS
    return joint_space(VEHICLE, effects, unknown, [False, True])


def column(parameter_space: JointSpace, owner: str, key: str) -> int:
    return next(i for i, c in enumerate(parameter_space.columns) if (c.owner, c.key) == (owner, key))


def test_an_adjustment_and_what_an_unknown_removes_are_candidates_of_a_change() -> None:
    alone, changed = space(VEHICLE, EFFECTS, (THRUST_CURVE,)), joint(unknown=(THRUST_CURVE,))
    names = {changed.effect(name).name for name in changed.candidates}
    assert {"mass", "thrust-gain", "rotor-loss", "com-offset", "torque-bias"} <= names
    assert not {"mass", "thrust-gain"} & set(alone.candidates)
    assert COMMON + "thrust-gain" not in changed.owners
    assert COMMON + "thrust-curve" in changed.freed


def test_what_both_sets_leave_unknown_is_no_candidate_of_a_change() -> None:
    assert not {"thrust-gain", "battery-sag"} & set(joint(unknown=(THRUST,)).candidates)
    assert not {"com-offset", "torque-bias"} & set(joint(unknown=(TORQUE,)).candidates)


def test_a_difference_acts_only_after_the_change() -> None:
    changed = joint("mass", "linear-drag")
    theta_scaled = np.zeros(len(changed.columns))
    theta_scaled[column(changed, COMMON + "linear-drag", "dx")] = 1.0
    theta_scaled[column(changed, "linear-drag", "dx")] = 2.0
    drag = next(i for i, c in enumerate(changed.rolled.columns) if c.key == "dx")
    assert changed.of_flight(theta_scaled, BEFORE)[drag] == 1.0
    assert changed.of_flight(theta_scaled, AFTER)[drag] == 3.0
    assert changed.after_change().of_flight(theta_scaled, BEFORE)[drag] == 3.0


def test_grams_expand_as_the_slopes_do() -> None:
    changed = joint("mass", "linear-drag")
    rng = np.random.default_rng(1)
    count, others = len(changed.rolled.columns), 3
    slopes = rng.normal(size=(20, 1 + count + others))
    own = slopes[:, 1 : 1 + count] @ changed.matrix(BEFORE)
    joint_slopes = np.column_stack([slopes[:, :1], own, slopes[:, 1 + count :]])
    gram = changed.expanded((slopes.T @ slopes)[None], BEFORE)[0]
    np.testing.assert_allclose(gram, joint_slopes.T @ joint_slopes, atol=1e-12)


def test_bounds_are_those_of_the_sum() -> None:
    changed = joint("linear-drag")
    common, difference = column(changed, COMMON + "linear-drag", "dx"), column(changed, "linear-drag", "dx")
    theta_scaled = np.zeros(len(changed.columns))
    theta_scaled[[common, difference]] = 1.0, -1.5
    clipped = changed.clipped(theta_scaled)
    assert clipped[common] == 1.0
    assert clipped[difference] == pytest.approx(-1.0)  # the drag is gone, not negative


def test_a_drag_that_was_there_before_may_go_and_no_more() -> None:
    """The baseline shows a drag of 1 (scaled), the flights after one of -0.5, which is beyond the bound."""
    changed = joint("linear-drag")
    common, difference = column(changed, COMMON + "linear-drag", "dx"), column(changed, "linear-drag", "dx")
    count = len(changed.columns)
    gram = np.zeros((1 + count, 1 + count))
    for value, columns in ((1.0, [common]), (-0.5, [common, difference])):
        row = np.zeros(1 + count)
        row[0], row[[1 + i for i in columns]] = 1e3 * value, 1e3
        gram += np.outer(row, row)
    theta_scaled, prior = np.zeros(count), changed.prior
    precision = prior.precision(["linear-drag"])
    step, _ = bounded_step(gram, theta_scaled, precision, changed.bounds, changed.added)
    assert step[common] + step[difference] == pytest.approx(0.0, abs=1e-9)
    assert step[difference] < -0.5
    free, _ = bounded_step(gram, theta_scaled, precision, (changed.bounds[0] - 9.0, changed.bounds[1]))
    assert free[common] + free[difference] == pytest.approx(-0.5, abs=1e-3)
    (bounded,) = log_evidences(gram, 0.0, theta_scaled, prior, [("linear-drag",)], changed.bounds)
    wide = (changed.bounds[0] - 9.0, changed.bounds[1])
    (unbounded,) = log_evidences(gram, 0.0, theta_scaled, prior, [("linear-drag",)], wide)
    assert bounded < unbounded - 100.0


def test_common_columns_are_never_candidates_and_leave_the_null_model() -> None:
    changed = joint()
    assert not any(name.startswith(COMMON) for name in changed.candidates)
    assert {owner for owner in changed.owners if owner.startswith(COMMON)} == set(changed.freed)


def test_the_thrust_of_each_log_has_a_scale_of_its_own() -> None:
    assert joint().nuisance_sigma == (*space(VEHICLE, EFFECTS).nuisance_sigma, RULES.session_thrust_sigma)
