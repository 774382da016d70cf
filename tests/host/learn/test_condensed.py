"""The condensed loss against true roll-outs, and what is learned on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trimtab.host.codegen import find_compiler
from trimtab.host.effects import load_effects
from trimtab.host.learn.adjoint import Rollouts, loss_of
from trimtab.host.learn.condensed import DELAY_S, CondensedSettings, condense, knots, spline
from trimtab.host.learn.fit import Basis, Examples, accelerations, fit, initial
from trimtab.host.learn.lanes import LaneRollouts, rollouts
from trimtab.host.learn.linear import Linearised, between, effect_scales
from trimtab.host.learn.quick import train_condensed
from trimtab.host.learn.starts import start_sigma
from trimtab.host.learn.train import LOSS_SIGMA
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments, cut
from trimtab.host.vehicle import load_vehicle

pytestmark = pytest.mark.usefixtures("virtual_machine")

VEHICLE = load_vehicle("research")
DRAG = load_effects()["linear-drag"]
PHI = Phi(vehicle=VEHICLE, effects=(DRAG,), estimator=False)
BARE = Phi(vehicle=VEHICLE, estimator=False)
LATE = Phi(vehicle=VEHICLE, effects=(DRAG, load_effects()["actuation-delay"]), estimator=False)
SMALL = Layout(hidden=(1,))
WEIGHT = 1.0 / np.square(LOSS_SIGMA)
STEPS = 20
NO_FORM = (0.0, 0.0)
"""The form of the drag, which is not learned."""
KNOTS = knots(STEPS + 1)


@pytest.fixture(scope="module")
def segments(make_states) -> Segments:
    return cut([make_states(seed) for seed in (1, 2)], PHI, steps=STEPS)


def condensed_about(
    segments: Segments, acceleration: np.ndarray, theta: np.ndarray, *, phi: Phi = PHI, held: float = 1.0
):
    engine = rollouts(phi, SMALL, theta, batch=1, step_s=0.02, weight=WEIGHT)
    return condense(
        engine,
        segments,
        start_sigma=held * start_sigma(phi, segments),
        acceleration=acceleration,
        theta=theta,
        free=range(3),
    )


def rolled(segments: Segments, push: np.ndarray, theta: np.ndarray, phi: Phi = PHI) -> float:
    """The loss of true roll-outs from the measured starts with accelerations (S, knots, 3) at the knots."""
    engine = Rollouts(phi, SMALL, theta, batch=1, step_s=0.02, weight=WEIGHT)
    thetas = np.repeat(theta[None], segments.count, axis=0)
    states = engine.pushed(segments)(segments.x0, thetas, between(spline(STEPS + 1) @ push, segments.split))
    return loss_of(segments, states.transpose(1, 0, 2), WEIGHT)


def test_products_are_those_of_slopes_that_are_formed():
    """The oracle chains the steps for every column, as the roll-outs do."""
    rng = np.random.default_rng(3)
    count, steps, size, parameters, others = 2, 4, 14, 2, 3
    shapes = ((size, size), (size, 3), (size, 3), (size, parameters))
    by_state, by_first, by_second, by_theta = (rng.standard_normal((count, steps, *s)) for s in shapes)
    linear = Linearised(
        states=np.zeros((count, steps + 1, size)),
        by_state=by_state,
        by_first=by_first,
        by_second=by_second,
        by_theta=by_theta,
    )
    weight, columns = rng.uniform(0.5, 2.0, 12), rng.standard_normal((count, steps, 12, others))
    slopes = np.zeros((count, steps + 1, size, 3 * (steps + 1) + parameters))
    for k in range(steps):
        slopes[:, k + 1] = by_state[:, k] @ slopes[:, k]
        slopes[:, k + 1, :, 3 * k : 3 * k + 3] += by_first[:, k]
        slopes[:, k + 1, :, 3 * k + 3 : 3 * k + 6] += by_second[:, k]
        slopes[:, k + 1, :, -parameters:] += by_theta[:, k]
    chained = linear.chained(np.zeros((count, size, 1)))
    np.testing.assert_allclose(chained[..., :parameters], slopes[:, 1:, :12, -parameters:])
    assert not chained[..., parameters:].any()
    every = np.concatenate([slopes[:, 1:, :12, :-parameters], columns], axis=3).reshape(count, 12 * steps, -1)
    expected = every.swapaxes(1, 2) @ (np.tile(weight, steps)[:, None] * every)
    np.testing.assert_allclose(linear.products(weight, columns), expected, atol=1e-9 * abs(expected).max())


@pytest.mark.parametrize("nodes", [21, 50])
def test_spline_has_the_values_of_its_knots_and_follows_a_turn_of_the_attitude(nodes):
    """At 12 rad/s, the bandwidth of the attitude loop: within 2 % away from the ends."""
    t_s = 0.02 * np.arange(nodes)
    at = knots(nodes)
    assert at[0] == 0
    assert at[-1] == nodes - 1
    np.testing.assert_allclose(spline(nodes)[at], np.eye(len(at)), atol=1e-12)
    np.testing.assert_allclose(spline(nodes) @ t_s[at] ** 3, t_s**3, atol=1e-12)
    wave = np.sin(12.0 * t_s)
    assert abs(spline(nodes) @ wave[at] - wave)[6:-6].max() < 0.02


@pytest.mark.parametrize("frame", ["world", "body"])
def test_first_weights_see_inputs_in_typical_sizes(frame):
    layout = Layout(hidden=(4, 3), frame=frame)
    (first, *_), (drawn, *_) = (
        layout.layers(xi)
        for xi in (initial(layout, np.random.default_rng(5)), layout.initial(np.random.default_rng(5)))
    )
    typical = [3.0, 3.0, 3.0, 0.6, 0.6, 3.0][: layout.sizes[0]]
    np.testing.assert_allclose(first[0] * typical, drawn[0])


@pytest.mark.parametrize(
    ("phi", "fixed"),
    [pytest.param(PHI, NO_FORM, id="whole-steps"), pytest.param(LATE, (*NO_FORM, 0.004), id="split-steps")],
)
def test_condensed_loss_is_that_of_roll_outs_where_the_start_is_held(make_states, phi, fixed):
    few = cut([make_states(seed) for seed in (1, 2)], phi, steps=STEPS).take([0, 3])
    rng = np.random.default_rng(0)
    at, theta = 0.2 * rng.standard_normal((2, len(KNOTS), 3)), np.array([0.1, 0.2, 0.05, *fixed])
    condensed = condensed_about(few, at, theta, phi=phi, held=1e-6)
    u = condensed.at.copy()
    assert condensed.loss(u)[0] == pytest.approx(rolled(few, at, theta, phi), rel=1e-9)
    # Near it, and better than the slope alone says.
    push, more = 0.02 * rng.standard_normal(at.shape), np.array([0.02, -0.01, 0.03, *np.zeros(len(fixed))])
    u[:, : push[0].size] += push.reshape(2, -1)
    u[:, push[0].size : -1] += more[:3] / effect_scales(PHI)[:3]
    true = rolled(few, at + push, theta + more, phi)
    assert condensed.loss(u)[0] == pytest.approx(true, rel=2e-3)
    assert abs(true / condensed.loss(condensed.at)[0] - 1.0) > 0.02


def test_condensed_loss_of_free_starts_is_less_and_its_slope_is_its_difference(segments):
    few = segments.take([0, 3])
    still, theta = np.zeros((2, len(KNOTS), 3)), PHI.theta_neutral
    held, free = (condensed_about(few, still, theta, held=held) for held in (1e-6, 1.0))
    assert free.loss(free.at)[0] < held.loss(held.at)[0]
    rng = np.random.default_rng(1)
    u, along = free.at + 0.1 * rng.standard_normal(free.at.shape), rng.standard_normal(free.at.shape)
    numeric = (free.loss(u + 1e-4 * along)[0] - free.loss(u - 1e-4 * along)[0]) / 2e-4
    assert (free.loss(u)[1] * along).sum() == pytest.approx(numeric, rel=1e-8)


def test_both_engines_condense_alike(segments, require):
    require("compiler")
    compiler = find_compiler()
    assert compiler is not None
    few, theta = segments.take([1]), np.array([0.1, 0.2, 0.05, *NO_FORM])
    engines = (
        Rollouts(PHI, SMALL, theta, batch=1, step_s=0.02, weight=WEIGHT),
        LaneRollouts(PHI, SMALL, theta, step_s=0.02, weight=WEIGHT, compiler=compiler),
    )
    found = [
        condense(
            engine,
            few,
            start_sigma=start_sigma(PHI, few),
            acceleration=np.zeros((1, len(KNOTS), 3)),
            theta=theta,
            free=range(3),
        )
        for engine in engines
    ]
    for name in ("hessian", "slope", "constant", "at"):
        one, other = (getattr(each, name) for each in found)
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-8 * np.abs(one).max())


@pytest.mark.parametrize("frame", ["world", "body"])
def test_slope_of_what_is_learned_is_its_difference(segments, frame):
    few = segments.take([0, 3, 5])
    layout = Layout(hidden=(4, 3), frame=frame)
    basis = Basis(layout=layout, parameters=3, delay=True)
    rng = np.random.default_rng(2)
    headings = rng.uniform(-3.0, 3.0, (2, 3))
    states = few.measured[:, KNOTS, 3:9]
    examples = Examples(
        condensed=condensed_about(few, np.zeros((3, len(KNOTS), 3)), PHI.theta_neutral), states=states
    )
    from trimtab.host.learn.fit import _Problem

    problem = _Problem(basis, examples, l2=1e-3, headings=headings)
    v = np.concatenate([layout.initial(rng), [0.3, 0.2, 0.1, 0.05]])
    along = rng.standard_normal(len(v))
    numeric = (problem(v + 1e-6 * along)[0] - problem(v - 1e-6 * along)[0]) / 2e-6
    assert problem(v)[1] @ along == pytest.approx(numeric, rel=1e-6)
    value, slope = _Problem(basis, examples, l2=1e-3, headings=headings, jobs=3)(v)
    assert value == problem(v)[0]
    np.testing.assert_array_equal(slope, problem(v)[1])


def learned(make_states, settings, phi=PHI, *, noise=1.0, turn=lambda s: s):
    flights = [make_states(seed, noise=noise) for seed in range(1, 7)]
    segments = turn(cut(flights, phi, steps=25))
    rng = np.random.default_rng(0)
    order = rng.permutation(segments.count)
    return train_condensed(
        phi,
        phi.theta_neutral,
        (segments.take(order[6:]), segments.take(order[:6])),
        settings,
        rng,
        weight=WEIGHT,
    )


def test_effects_alone_are_found_in_noise(make_states):
    trained = learned(make_states, CondensedSettings(layout=None))
    np.testing.assert_allclose(trained.theta, [0.45, 0.35, 0.25, *NO_FORM], rtol=0.12)
    assert trained.network is None
    assert trained.after < 0.2 * trained.before


def test_what_is_not_free_stays(make_states):
    segments = cut([make_states(seed) for seed in (1, 2, 3)], PHI, steps=25)
    theta = np.array([0.45, 0.0, 0.25, *NO_FORM])
    trained = train_condensed(
        PHI,
        theta,
        (segments, segments.take([0, 4, 8])),
        CondensedSettings(layout=None),
        np.random.default_rng(0),
        weight=WEIGHT,
        free=[1],
    )
    assert trained.theta[[0, 2]].tolist() == [0.45, 0.25]
    assert trained.theta[1] == pytest.approx(0.35, rel=0.12)


@pytest.mark.parametrize("frame", ["world", "body"])
def test_a_network_alone_learns_the_drag(make_states, frame):
    trained = learned(make_states, CondensedSettings(layout=Layout(hidden=(16, 16), frame=frame)), BARE)
    assert trained.after < 0.3 * trained.before
    assert trained.network is not None
    push = trained.network.acceleration_ned(np.array([[2.0], [0.0], [0.0]]), np.zeros((3, 1)))
    np.testing.assert_allclose(push[:, 0], [-0.9, 0.0, 0.0], atol=0.25)


def test_poses_that_are_late_are_found_so(make_states):
    """Measured states moved back by 8 ms: what the cameras saw then is older than its stamp."""

    def late(segments: Segments) -> Segments:
        rates = np.gradient(segments.measured, segments.step_s, axis=1)
        rates[:, :, 9:] = 0.0
        measured = segments.measured - 0.008 * rates
        x0 = segments.x0.copy()
        x0[:, :12] = measured[:, 0]
        return replace(segments, measured=measured, x0=x0)

    settings = CondensedSettings(layout=None, delay=True)
    trained = learned(make_states, settings, noise=0.0, turn=late)
    assert trained.delay_s == pytest.approx(0.008, abs=0.0015)
    assert DELAY_S == 0.01
    np.testing.assert_allclose(trained.theta, [0.45, 0.35, 0.25, *NO_FORM], rtol=0.1)


def test_fit_ends_early_where_validation_does_not_improve(segments):
    few, other = segments.take([0, 3]), segments.take([5])
    basis = Basis(layout=Layout(hidden=(4,)), parameters=0, delay=False)
    phi_examples = []
    for part in (few, other):
        engine = rollouts(BARE, SMALL, np.zeros(0), batch=1, step_s=0.02, weight=WEIGHT)
        condensed = condense(
            engine,
            part,
            start_sigma=start_sigma(BARE, part),
            acceleration=np.zeros((part.count, len(KNOTS), 3)),
            theta=np.zeros(0),
            free=(),
        )
        phi_examples.append(Examples(condensed=condensed, states=part.measured[:, KNOTS, 3:9]))
    start = np.zeros(basis.size)
    start[:] = Layout(hidden=(4,)).initial(np.random.default_rng(0))
    found = fit(
        basis, phi_examples[0], phi_examples[1], start, CondensedSettings(iterations=400, patience=5, l2=0.0)
    )
    assert found.best <= found.iterations <= found.best + 5
    assert found.validation_loss[found.best] == found.validation_loss.min()
    assert accelerations(basis, found.xi, few.measured[:, :, 3:9]).shape == (2, STEPS + 1, 3)
