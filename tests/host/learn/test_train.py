"""Training finds a residual that was put there, and starts that were moved."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from trimtab.host.learn.adam import Adam
from trimtab.host.learn.evaluate import whole_flights
from trimtab.host.learn.lanes import rollouts
from trimtab.host.learn.learn import region
from trimtab.host.learn.split import split_by_reference
from trimtab.host.learn.starts import free_starts
from trimtab.host.learn.train import LOSS_SIGMA, Settings, train
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out
from trimtab.host.models.segments import cut
from trimtab.host.vehicle import load_vehicle, to_parameters

PHI = Phi(vehicle=load_vehicle("research"), estimator=False)
WHOLE = Phi(vehicle=load_vehicle("research"))
OBSERVING = Phi(
    vehicle=load_vehicle("research"),
    parameters=to_parameters(load_vehicle("research")) | {"OBS_GAIN": 4.0},
    estimator=False,
)
NONE = np.zeros(0)
WEIGHT = 1.0 / np.square(LOSS_SIGMA)


def test_train_drag_is_learned_and_carries_over_to_another_reference(make_states):
    flights, other = [make_states(seed, duration_s=6.0) for seed in (1, 2, 3)], [make_states(9)]
    segments = cut(flights, PHI, steps=25)
    rng = np.random.default_rng(0)
    settings = Settings(hidden=(8, 8), epochs=12, batch=12)
    trained = train(PHI, NONE, segments, cut(other, PHI, steps=25), settings, rng, weight=WEIGHT)
    assert trained.validation_loss[trained.best_epoch] < 0.2 * trained.validation_loss[0]
    nominal = whole_flights(WHOLE, NONE, other)
    learned = whole_flights(WHOLE, NONE, other, trained.network)
    assert nominal.position_rmse_m > 0.02
    assert learned.position_rmse_m < 0.5 * nominal.position_rmse_m


@pytest.mark.usefixtures("virtual_machine")
def test_train_same_seed_gives_the_same_network(make_states):
    segments = cut([make_states(1)], PHI, steps=25)
    settings = Settings(hidden=(4,), epochs=2, batch=8)
    networks = [
        train(
            PHI, NONE, segments, segments.take([0, 1]), settings, np.random.default_rng(7), weight=WEIGHT
        ).network
        for _ in range(2)
    ]
    np.testing.assert_array_equal(networks[0].xi, networks[1].xi)


@pytest.mark.usefixtures("virtual_machine")
def test_train_nothing_to_learn_stops_early_near_nothing(make_states):
    flights = [make_states(seed, drag=False) for seed in (1, 2)]
    segments = cut(flights, PHI, steps=25)
    settings = Settings(hidden=(4,), epochs=40, patience=2, rate=1e-3)
    trained = train(PHI, NONE, segments, segments, settings, np.random.default_rng(0), weight=WEIGHT)
    assert trained.best_epoch <= trained.epochs <= 40
    push = trained.network.acceleration_ned(*np.split(flights[0].x[::10, 3:9].T, 2))
    assert np.abs(push).max() < 0.15


@pytest.mark.usefixtures("virtual_machine")
def test_free_starts_moved_starts_come_back(make_states):
    """Starts off by two sigmas, states exact: one step brings most of it back."""
    segments = cut([make_states(4, noise=0.0, drag=False)], PHI, steps=25)
    engine = rollouts(PHI, Layout(hidden=(1,)), NONE, batch=1, step_s=0.02, weight=WEIGHT)
    starts = free_starts(engine, NONE, segments, WEIGHT * 100.0)
    rng = np.random.default_rng(1)
    moved = np.zeros((segments.count, PHI.size))
    moved[:, 3:9] = 2.0 * rng.standard_normal((segments.count, 6))

    def residual(shift):
        states = roll_out(
            PHI,
            x0=(segments.x0 + shift * starts.sigma).T,
            drive=segments.drive.transpose(1, 2, 0),
            flight=segments.constants.T,
            theta=NONE,
            step_s=0.02,
        )
        return segments.measured[:, 1:] - states[1:].transpose(2, 0, 1)

    everyone = np.arange(segments.count)
    # Measured from the moved starts, the best shift is the way back, drawn a little to zero.
    found = starts.refine(everyone, np.zeros_like(moved), residual(moved))
    assert np.abs(residual(moved + found)).mean() < 0.3 * np.abs(residual(moved)).mean()
    again = starts.refine(everyone, found, residual(moved + found))
    np.testing.assert_allclose(again, found, atol=0.15)


def test_adam_quadratic_reaches_its_minimum():
    target = np.array([1.0, -2.0, 3.0])
    adam = Adam(np.zeros(3), rate=0.1, steps=400)
    for _ in range(400):
        adam.step(2.0 * (adam.x - target))
    np.testing.assert_allclose(adam.x, target, atol=1e-3)


def test_adam_bad_settings_are_refused():
    with pytest.raises(ValueError, match="rate > 0"):
        Adam(np.zeros(1), rate=0.0, steps=1)
    with pytest.raises(ValueError, match="must be positive"):
        Settings(epochs=0)


def test_split_by_reference_never_shares_one(make_states):
    states = [make_states(seed) for seed in (1, 2, 3, 1, 2)]
    used, held = split_by_reference(states, np.random.default_rng(0))
    assert len(used) + len(held) == 5
    assert held
    assert not {s.reference_id for s in used} & {s.reference_id for s in held}
    assert split_by_reference(states[:2], np.random.default_rng(0))[1] == []


def test_region_covers_the_flights(make_states):
    states = make_states(1)
    covered = region([states])
    assert covered.speed_max_m_s == np.linalg.norm(states.x[:, 3:6], axis=1).max()
    assert 0.0 < covered.tilt_max_deg < 80.0
    assert covered.thrust_min_n < 0.752 * 9.81 < covered.thrust_max_n


@pytest.mark.parametrize("phi", [PHI, OBSERVING], ids=["plain", "observer"])
def test_segments_turned_are_flights_of_the_same_vehicle(make_states, phi):
    """Rolled out from a turned start along a turned reference, the states are the turned states."""
    states = make_states(1, drag=False)
    seen = np.tile((0.5, -0.3, 0.2), (len(states.t_s), 1))
    segments = cut([dataclasses.replace(states, observer=seen)], phi, steps=25)
    assert phi is PHI or (segments.x0[:, phi.observer][:, :3] == seen[0]).all()
    angles = np.linspace(-3.0, 3.0, segments.count)

    def predicted(of):
        return roll_out(
            phi,
            x0=of.x0.T,
            drive=of.drive.transpose(1, 2, 0),
            flight=of.constants.T,
            theta=NONE,
            step_s=0.02,
        ).transpose(2, 0, 1)

    straight = predicted(segments)
    expected = dataclasses.replace(segments, measured=straight).turned(angles)
    np.testing.assert_allclose(predicted(segments.turned(angles)), expected.measured, atol=1e-9)
    back = segments.turned(angles).turned(-angles)
    np.testing.assert_allclose(back.drive, segments.drive, atol=1e-12)
