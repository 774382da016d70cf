"""Whole flights over the closed loop: what they find, how what is left is whitened, and whose estimate
counts.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from host.effects import load_effects
from host.log import read_flight
from host.trace import refine as closed
from host.trace.diagnose import Fit
from host.trace.parameters import Space, space
from host.trace.refine import CHANNELS, ClosedFit, Loop, Whitening

DATA = Path(__file__).parents[2] / "data"
PRESENT = ("thrust-gain", "motor-lag", "mocap-latency")
LIBRARY = (*PRESENT, "com-offset", "linear-drag", "mass", "quadratic-drag")
NOISE = np.repeat([4e-4, 3e-3, 8e-3], 3)


@pytest.fixture(scope="module")
def library() -> Space:
    effects = load_effects()
    vehicle = read_flight(DATA / "a1.mcap").vehicle
    return space(vehicle, {name: effects[name] for name in LIBRARY})


@pytest.fixture(scope="module")
def loop(library: Space) -> Loop:
    flights = [read_flight(DATA / f"{name}.mcap") for name in ("a1", "b1")]
    return closed.closed_loop(flights, flights[0].vehicle, library, np.zeros(len(library.columns)))


def scaled(library: Space, **values: float) -> np.ndarray:
    z = np.zeros(len(library.columns))
    for i, column in enumerate(library.columns):
        key = f"{column.owner}.{column.key}".replace("-", "_").replace(".", "__")
        if key in values:
            z[i] = (values[key] - column.neutral) / column.scale
    return z


def coloured(rng: np.random.Generator, bins: int) -> np.ndarray:
    """Noise (bins, 9) in which position follows attitude, and each channel its own past."""
    noise = rng.standard_normal((bins + 50, CHANNELS)) * NOISE
    for k in range(1, len(noise)):
        noise[k] += 0.8 * noise[k - 1]
        noise[k, 0:3] += 0.05 * noise[k - 1, 3:6]
    return noise[50:]


def simulated(loop: Loop, z: np.ndarray, seed: int) -> Loop:
    """A loop whose recordings are phi's own at z, with coloured noise on top."""
    rng = np.random.default_rng(seed)
    recordings = [
        replace(recording, measured=predicted[0] + coloured(rng, recording.bins))
        for recording, predicted in zip(loop.recordings, loop.predicted(z[:, None]), strict=True)
    ]
    return Loop(recordings, loop.recordings[0].states.vehicle, loop.space)


def test_shipped_flights_show_what_their_world_holds(library: Space) -> None:
    flights = [read_flight(DATA / f"{name}.mcap") for name in ("a1", "a2", "b1", "b2")]
    truth = json.loads((DATA / "truth.json").read_text())["effects"]
    start = scaled(library, mocap_latency__latency_s=0.018, motor_lag__extra_s=0.012, thrust_gain__gain=0.95)
    whole = closed.closed_loop(flights, flights[0].vehicle, library, start)
    fit = closed.fit_loop(whole, PRESENT, start, closed.order_of(whole, start))
    values, sd = library.values(fit.z), np.sqrt(np.diag(fit.covariance)) * library.scale
    for i, column in enumerate(library.columns):
        if column.owner in truth:
            error = abs(values[i] - truth[column.owner][column.key])
            assert error < 3.0 * sd[i], column
            assert error < 0.15 * abs(truth[column.owner][column.key] - column.neutral), column
    without = closed.fit_loop(whole, PRESENT[::2], start, fit.whitening.order)
    found = closed.gains(library, without)
    assert next(iter(found)) == "motor-lag"
    assert found["motor-lag"] == pytest.approx(fit.log_evidence - without.log_evidence, abs=3.0)
    assert found["motor-lag"] > 3.0
    assert max(closed.gains(library, fit).values()) < 0.0


def test_parameters_of_simulated_flights_lie_within_their_intervals(library: Space, loop: Loop) -> None:
    true = scaled(library, motor_lag__extra_s=0.01, linear_drag__dx=0.3, thrust_gain__gain=1.0)
    squares = []
    for seed in range(4):
        made = simulated(loop, true, seed)
        fit = closed.fit_loop(made, ("linear-drag", "motor-lag"), np.zeros(len(true)), 2)
        deviation = (fit.z - true) / np.sqrt(np.diag(fit.covariance))
        squares += [deviation[i] ** 2 for name in ("linear-drag", "motor-lag") for i in library.groups[name]]
        assert abs(fit.z[library.groups["motor-lag"][0]] * 0.015 - 0.01) < 0.002
    # 16 numbers of a chi-square with one degree of freedom each: beyond these once in a thousand.
    assert 0.2 < np.mean(squares) < 2.6


def test_evidence_prefers_the_drag_that_flew(library: Space, loop: Loop) -> None:
    made = simulated(loop, scaled(library, quadratic_drag__c=0.06), 5)
    zero = np.zeros(len(library.columns))
    fits = [closed.fit_loop(made, names, zero, 2) for names in (("quadratic-drag",), ("linear-drag",), ())]
    refined = [cast(Any, SimpleNamespace(closed=fit)) for fit in fits]
    found = closed.log_evidences(refined)
    assert found["quadratic-drag",] - found["linear-drag",] > 5.0
    assert found["quadratic-drag",] - found[()] > 5.0


def test_evidences_of_different_orders_are_not_compared() -> None:
    white = [Whitening(coefficients=np.zeros((n, 9, 9)), innovation=np.eye(9)) for n in (1, 2)]
    fits = [cast(Any, SimpleNamespace(closed=SimpleNamespace(whitening=w))) for w in white]
    with pytest.raises(ValueError, match="different orders"):
        closed.log_evidences(fits)


def test_autoregression_is_recovered_and_leaves_white_innovations() -> None:
    noise = coloured(np.random.default_rng(1), 6000)
    known = np.ones(len(noise), dtype=bool)
    known[1000:1003] = False
    spoilt = noise.copy()
    spoilt[1000:1003] = 1e3
    white = closed.autoregression([spoilt], [known], 1)
    wanted = 0.8 * np.eye(CHANNELS)
    # A first-order form of it: position takes the attitude before its own step.
    wanted[0:3, 3:6] = 0.05 * np.eye(3)
    np.testing.assert_allclose(white.coefficients[0][:3, :6], wanted[:3, :6], atol=0.04)
    left = closed.whitened(white, spoilt[None], known)[0].reshape(-1, CHANNELS)
    assert len(left) == len(noise) - 1 - 4
    np.testing.assert_allclose(left.T @ left / len(left), np.eye(CHANNELS), atol=1e-9)
    assert np.abs((left[1:] * left[:-1]).mean(0)).max() < 0.06


def fitted(library: Space, size: float) -> Fit:
    count = len(library.columns)
    made = SimpleNamespace(effects=("motor-lag",), z=np.full(count, size), covariance=0.01**2 * np.eye(count))
    return cast(Fit, made)


def test_timing_is_taken_from_the_loop_and_torque_from_whichever_knows_it_better(library: Space) -> None:
    count = len(library.columns)
    com, lag = library.groups["com-offset"], library.groups["motor-lag"][0]
    lacking = library.groups["quadratic-drag"][0]
    z, covariance = np.full(count, 0.16), 0.02**2 * (0.5 * np.eye(count) + 0.5)
    z[lag] = 2.0
    covariance[com[0], com[0]] = 0.5**2
    grams = np.stack([np.diag(np.r_[1.0, np.full(count, 1e4)])] * 3)
    grams[:, 1 + lacking] = 0.0
    answer = ClosedFit(
        effects=("motor-lag",),
        z=z,
        at=z,
        covariance=covariance,
        log_evidence=0.0,
        whitening=Whitening(coefficients=np.zeros((1, 9, 9)), innovation=np.eye(9)),
        grams=grams,
        residuals=(),
    )
    refined = closed.combined(library, fitted(library, 0.15), answer)
    own = np.sqrt(np.diag(covariance) + closed.loop_discrepancy(library) ** 2)
    theirs = np.hypot(0.01, [column.discrepancy for column in library.columns])
    for i, column in enumerate(library.columns):
        kept = i in (com[0], lacking)
        assert refined.method[i] == ("segments" if kept else "closed-loop"), column
        assert refined.z[i] == (0.15 if kept else z[i])
        if i != lag:
            assert refined.covariance[i, i] == pytest.approx((theirs[i] if kept else own[i]) ** 2)
    beyond = 1.85 - closed.AGREE * np.hypot(own[lag], theirs[lag])
    assert beyond > 0.5
    assert refined.covariance[lag, lag] == pytest.approx(own[lag] ** 2 + beyond**2)
    assert refined.covariance[com[0], lag] == 0.0
    np.linalg.cholesky(refined.covariance)


def test_jackknife_widens_only_what_differs_between_flights() -> None:
    rng = np.random.default_rng(3)
    slopes = rng.standard_normal((8, 400, 2))
    shift = np.array([0.0, 0.6])  # of the second parameter, from flight to flight
    grams = []
    for k in range(8):
        r = rng.standard_normal(400) + slopes[k] @ (shift * rng.standard_normal(2))
        A = np.column_stack([r, slopes[k]])
        grams.append(A.T @ A)
    factors = closed.jackknife_by_flight(np.stack(grams), np.zeros(2), np.full(2, 1e-4))
    assert factors[0] < 1.6
    assert factors[1] > 4.0
    np.testing.assert_array_equal(
        closed.jackknife_by_flight(np.stack(grams[:1]), np.zeros(2), np.ones(2)), np.ones(2)
    )
