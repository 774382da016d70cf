"""The gradient of Algorithm 1, of both engines, against finite differences and CasADi's own reverse mode."""

from __future__ import annotations

import casadi
import numpy as np
import pytest

from trimtab.host.codegen import find_compiler
from trimtab.host.effects import load_effects
from trimtab.host.learn.adjoint import Rollouts, loss_of
from trimtab.host.learn.lanes import LaneRollouts
from trimtab.host.learn.train import LOSS_SIGMA
from trimtab.host.models.drive import DRIVE_ROWS, FLIGHT
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out
from trimtab.host.models.segments import cut
from trimtab.host.vehicle import load_vehicle

LAYOUT = Layout(hidden=(8, 8))
LAYOUTS = [LAYOUT, Layout(hidden=(5, 7, 3), frame="body")]
EFFECTS = {name: load_effects()[name] for name in ("linear-drag", "motor-lag")}
PHI = Phi(vehicle=load_vehicle("research"), estimator=False)
WITH_EFFECTS = Phi(vehicle=load_vehicle("research"), effects=tuple(EFFECTS.values()), estimator=False)
THETA = np.zeros(0)
DRAG = np.array([0.3, 0.25, 0.1, 0.2, 0.01, 0.004])
LATE = Phi(
    vehicle=load_vehicle("research"),
    effects=(load_effects()["linear-drag"], load_effects()["actuation-delay"]),
    estimator=False,
)
LATE_THETA = DRAG
WEIGHT = 1.0 / np.square(LOSS_SIGMA)
STEPS, BATCH = 20, 4


@pytest.fixture(scope="module")
def segments(make_states):
    return cut([make_states(1)], PHI, steps=STEPS).take([2, 5, 7])


def make(engine, phi=PHI, layout=LAYOUT, theta=THETA):
    if engine == "vm":
        return Rollouts(phi, layout, theta, batch=BATCH, step_s=0.02, weight=WEIGHT)
    compiler = find_compiler()
    assert compiler is not None
    return LaneRollouts(phi, layout, theta, step_s=0.02, weight=WEIGHT, compiler=compiler)


@pytest.fixture(scope="module", params=["vm", "c"])
def rollouts(request, require):
    if request.param == "c":
        require("compiler")
    return make(request.param)


def weights(layout):
    rng = np.random.default_rng(2)
    return layout.initial(rng) + 0.05 * rng.standard_normal(layout.size)


@pytest.fixture(scope="module")
def xi():
    return weights(LAYOUT)


def test_gradient_equals_finite_differences(rollouts, segments, xi):
    found = rollouts.gradient(segments, segments.x0, xi)

    def loss(shift, x0_shift):
        states = rollouts.roll_out(segments, segments.x0 + x0_shift, xi + shift)
        return loss_of(segments, states, WEIGHT)

    rng = np.random.default_rng(3)
    x0_scale = np.repeat([1e-3, 1e-2, 1e-2, 1e-1, 0.1, 0.1], [3, 3, 3, 3, 4, 3])
    for _ in range(6):
        along = rng.standard_normal(LAYOUT.size)
        start_along = rng.standard_normal((segments.count, PHI.size)) * x0_scale

        def slope(h, along=along, start_along=start_along):
            forward, back = loss(h * along, h * start_along), loss(-h * along, -h * start_along)
            return (forward - back) / (2.0 * h)

        # Richardson: differences of order four, exact far below the bound.
        numeric = (4.0 * slope(1e-4) - slope(2e-4)) / 3.0
        exact = found.xi @ along + (found.x0 * start_along).sum()
        assert exact == pytest.approx(numeric, rel=1e-7)


@pytest.mark.parametrize(
    "layout",
    [pytest.param(LAYOUTS[0], marks=pytest.mark.full, id="world"), pytest.param(LAYOUTS[1], id="body")],
)
@pytest.mark.parametrize(
    ("phi", "theta"),
    [pytest.param(WITH_EFFECTS, DRAG, id="whole-steps"), pytest.param(LATE, LATE_THETA, id="split-steps")],
)
def test_both_engines_have_the_same_gradient(make_states, layout, phi, theta, require):
    """To 1e-12, in weights, starts and effects, for more segments than lanes and for fewer."""
    require("compiler")
    vm, c = (make(engine, phi, layout, theta) for engine in ("vm", "c"))
    segments = cut([make_states(1)], phi, steps=STEPS).take([2, 5, 7, 1])
    xi = weights(layout)
    one, other = (engine.gradient(segments, segments.x0, xi) for engine in (vm, c))
    assert one.loss == pytest.approx(other.loss, rel=1e-12)
    for a, b in ((one.xi, other.xi), (one.x0, other.x0), (one.theta, other.theta)):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * np.abs(a).max())
    many = segments.take([0, 1, 2, 3] * 3)
    tripled = c.gradient(many, many.x0, xi)
    np.testing.assert_allclose(tripled.xi, 3.0 * other.xi, rtol=0.0, atol=1e-12 * np.abs(tripled.xi).max())
    np.testing.assert_allclose(tripled.x0[4:8], other.x0, rtol=0.0, atol=1e-12 * np.abs(other.x0).max())


def test_gradient_and_roll_outs_are_the_same_bits_for_any_number_of_lanes(make_states, compiler_of_width):
    segments = cut([make_states(1)], WITH_EFFECTS, steps=STEPS).take([2, 5, 7, 1, 3, 0, 4, 6, 8, 2, 5])
    layout = Layout(hidden=(5,))
    xi, results = weights(layout), []
    for lanes in (2, 4, 8):
        rollouts = LaneRollouts(
            WITH_EFFECTS, layout, DRAG, step_s=0.02, weight=WEIGHT, compiler=compiler_of_width(lanes)
        )
        found = rollouts.gradient(segments, segments.x0, xi)
        results.append(
            [rollouts.roll_out(segments, segments.x0, xi), found.loss, found.xi, found.x0, found.theta]
        )
    first, *others = ([np.asarray(part).tobytes() for part in result] for result in results)
    assert others == [first, first]


def test_gradient_by_effects_equals_finite_differences(make_states):
    segments = cut([make_states(1)], WITH_EFFECTS, steps=STEPS).take([2, 5])
    xi, along, h = weights(LAYOUT), np.array([0.1, -0.2, 0.3, 0.05, 0.02, 0.002]), 1e-4
    found = make("vm", WITH_EFFECTS, LAYOUT, DRAG).gradient(segments, segments.x0, xi).theta @ along
    ends = []
    for shift in (h, -h):
        states = make("vm", WITH_EFFECTS, LAYOUT, DRAG + shift * along).roll_out(segments, segments.x0, xi)
        ends.append(loss_of(segments, states, WEIGHT))
    assert found == pytest.approx((ends[0] - ends[1]) / (2.0 * h), rel=1e-6)


def whole_step(count):
    """One RK4 step as a function that CasADi differentiates as a whole."""
    x, xi = casadi.MX.sym("x", PHI.size, count), casadi.MX.sym("xi", LAYOUT.size)
    drives = [casadi.MX.sym(name, DRIVE_ROWS["reference"], count) for name in "abc"]
    flight = casadi.MX.sym("flight", len(FLIGHT), count)
    mapped = PHI.function.map(count)

    def rate(state, drive):
        return mapped(state, drive, flight, casadi.DM(0, count), LAYOUT.matrices(xi, state[3:9, :]))

    k1 = rate(x, drives[0])
    k2 = rate(x + 0.01 * k1, drives[1])
    k3 = rate(x + 0.01 * k2, drives[1])
    k4 = rate(x + 0.02 * k3, drives[2])
    following = x + 0.02 / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return casadi.Function("whole", [x, *drives, flight, xi], [following])


def test_gradient_equals_casadi_reverse_mode(rollouts, segments, xi):
    step = whole_step(3)
    weights, x0 = casadi.MX.sym("xi", LAYOUT.size), casadi.MX.sym("x0", PHI.size, 3)
    x, total = x0, 0.0
    for k in range(STEPS):
        drives = [segments.drive[:, 2 * k + i].T for i in range(3)]
        x = step(x, *drives, segments.constants.T, weights)
        error = x[:12, :] - segments.measured[:, k + 1].T
        total += casadi.dot(error, casadi.diag(casadi.DM(WEIGHT)) @ error) / STEPS
    reverse = casadi.Function(
        "reverse", [weights, x0], [total, casadi.gradient(total, weights), casadi.gradient(total, x0)]
    )
    loss, by_xi, by_x0 = (np.array(value) for value in reverse(xi, segments.x0.T))
    found = rollouts.gradient(segments, segments.x0, xi)
    assert found.loss == pytest.approx(loss.item(), rel=1e-12)
    scale = np.abs(by_xi).max()
    np.testing.assert_allclose(found.xi, by_xi.ravel(), rtol=1e-10, atol=1e-10 * scale)
    np.testing.assert_allclose(found.x0, by_x0.T, rtol=1e-10, atol=1e-10 * np.abs(by_x0).max())


def test_gradient_of_segments_is_the_sum_of_each_ones(rollouts, segments, xi):
    whole = rollouts.gradient(segments, segments.x0, xi)
    parts = [segments.take([k]) for k in range(3)]
    each = [rollouts.gradient(part, part.x0, xi) for part in parts]
    total = sum(one.xi for one in each)
    np.testing.assert_allclose(whole.xi, total, rtol=0.0, atol=1e-12 * np.abs(total).max())
    assert whole.loss == pytest.approx(sum(one.loss for one in each), rel=1e-12)


def test_roll_out_equals_that_over_lanes(rollouts, segments):
    """CasADi's step and numpy's lanes are one model."""
    states = rollouts.roll_out(segments, segments.x0, np.zeros(LAYOUT.size))
    lanes = roll_out(
        PHI,
        x0=segments.x0.T,
        drive=segments.drive.transpose(1, 2, 0),
        flight=segments.constants.T,
        theta=THETA,
        step_s=0.02,
    )
    np.testing.assert_allclose(states[:, :, :12].transpose(0, 2, 1), lanes, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("engine", ["vm", "c"])
def test_delayed_commands_split_steps_and_the_gradient_equals_finite_differences(
    engine, make_states, require
):
    if engine == "c":
        require("compiler")
    segments = cut([make_states(1)], LATE, steps=STEPS).take([2, 5, 7])
    assert segments.split == LATE.substeps(0.02) == 4
    assert (segments.steps, segments.drive.shape[1]) == (STEPS, 8 * STEPS + 1)
    rollouts, xi = make(engine, LATE, theta=LATE_THETA), weights(LAYOUT)
    found = rollouts.gradient(segments, segments.x0, xi)
    along = np.random.default_rng(3).standard_normal(LAYOUT.size)

    def slope(h):
        ahead, behind = (
            loss_of(segments, rollouts.roll_out(segments, segments.x0, xi + sign * h * along), WEIGHT)
            for sign in (1.0, -1.0)
        )
        return (ahead - behind) / (2.0 * h)

    assert found.xi @ along == pytest.approx((4.0 * slope(1e-4) - slope(2e-4)) / 3.0, rel=1e-7)
    states = rollouts.roll_out(segments, segments.x0, np.zeros(LAYOUT.size))
    fine = roll_out(
        LATE,
        x0=segments.x0.T,
        drive=segments.drive.transpose(1, 2, 0),
        flight=segments.constants.T,
        theta=LATE_THETA,
        step_s=0.005,
        every=4,
    )
    np.testing.assert_allclose(states[:, :, :12].transpose(0, 2, 1), fine, rtol=1e-10, atol=1e-12)


def test_rollouts_refuse_segments_cut_for_whole_steps_and_too_many_segments(segments, xi):
    late = make("vm", LATE, theta=LATE_THETA)
    with pytest.raises(ValueError, match="segments in 1 parts a step, but this model needs 4"):
        late.roll_out(segments, np.zeros((3, LATE.size)), xi)
    many = segments.take([0, 1, 2, 0, 1])
    with pytest.raises(ValueError, match="5 segments for a batch of 4"):
        make("vm").roll_out(many, many.x0, xi)
