"""Fits to whole flights in closed loop, and the whitening of their residuals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.models.phi import INTEGRAL
from trimtab.host.trace import evidence, selection, uncertainty
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit import fit as refine
from trimtab.host.trace.flight_fit import loop as closed
from trimtab.host.trace.flight_fit import recording as recordings
from trimtab.host.trace.flight_fit import whitening
from trimtab.host.trace.flight_fit.fitter import FlightFitter
from trimtab.host.trace.flight_fit.loop import ClosedLoop
from trimtab.host.trace.flight_fit.whitening import CHANNELS, WINDOWS
from trimtab.host.trace.parameters import ParameterSpace, RollOutDiverged, space
from trimtab.host.trace.segment_fit.fit import SegmentFitter, refit
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import best_predicting, guessed_from_segments

DATA = Path(__file__).parents[3] / "data"
PRESENT = ("thrust-gain", "motor-lag", "mocap-latency")
LIBRARY = (*PRESENT, "com-offset", "linear-drag", "mass", "quadratic-drag")
NOISE = np.repeat([4e-4, 3e-3, 8e-3, 2e-2], 3)


@pytest.fixture(scope="module")
def library() -> ParameterSpace:
    effects = load_effects()
    vehicle = read_flight(DATA / "a1.mcap").vehicle
    return space(vehicle, {name: effects[name] for name in LIBRARY})


@pytest.fixture(scope="module")
def loop(library: ParameterSpace) -> ClosedLoop:
    flights = [read_flight(DATA / f"{name}.mcap") for name in ("a1", "b1")]
    return closed.closed_loop(
        [FlightData.of(each) for each in flights], flights[0].vehicle, library, np.zeros(len(library.columns))
    )


def scaled(library: ParameterSpace, **values: float) -> np.ndarray:
    theta_scaled = np.zeros(len(library.columns))
    for i, column in enumerate(library.columns):
        key = f"{column.owner}.{column.key}".replace("-", "_").replace(".", "__")
        if key in values:
            theta_scaled[i] = (values[key] - column.neutral) / column.scale
    return theta_scaled


def coloured(rng: np.random.Generator, bins: int) -> np.ndarray:
    """Return noise (bins, 12) in which position depends on attitude, and each channel on its past."""
    noise = rng.standard_normal((bins + 50, CHANNELS)) * NOISE
    for k in range(1, len(noise)):
        noise[k] += 0.8 * noise[k - 1]
        noise[k, 0:3] += 0.05 * noise[k - 1, 3:6]
    return noise[50:]


def simulated(loop: ClosedLoop, theta_scaled: np.ndarray, seed: int) -> ClosedLoop:
    """Return a loop whose recordings are predictions of phi plus coloured noise."""
    rng = np.random.default_rng(seed)
    predictions = loop.with_predictions(theta_scaled[:, None], lambda _, predicted: predicted[0])
    recordings = [
        replace(recording, measured=predicted + coloured(rng, recording.bins))
        for recording, predicted in zip(loop.recordings, predictions, strict=True)
    ]
    return ClosedLoop(recordings, loop.recordings[0].states.vehicle, loop.space)


def whitening_at(loop: ClosedLoop, theta_scaled: np.ndarray) -> whitening.Whitening:
    """Return the whitening of order 2, fitted to the residuals at theta_scaled."""
    residuals = [r[0] for r in loop.residuals(theta_scaled[:, None])]
    return whitening.autoregression(
        whitening.regressors(r, known, 2) for r, known in zip(residuals, loop.known, strict=True)
    )


def test_shipped_flights_show_the_effects_of_their_world(library: ParameterSpace) -> None:
    flights = [read_flight(DATA / f"{name}.mcap") for name in ("a1", "a2", "b1", "b2")]
    truth = json.loads((DATA / "truth.json").read_text())["effects"]
    start = scaled(library, mocap_latency__latency_s=0.018, motor_lag__extra_s=0.012, thrust_gain__gain=0.95)
    whole = closed.closed_loop([FlightData.of(each) for each in flights], flights[0].vehicle, library, start)
    fit = refine.fit_closed_loop(whole, PRESENT, start, closed.order_of(whole))
    values, sd = library.values(fit.theta_scaled), np.sqrt(np.diag(fit.covariance)) * library.scale
    for i, column in enumerate(library.columns):
        if column.owner in truth and not column.form:
            error = abs(values[i] - truth[column.owner][column.key])
            assert error < 3.0 * sd[i], column
            assert error < 0.3 * abs(truth[column.owner][column.key] - column.neutral), column
    without = refine.fit_closed_loop(whole, PRESENT[::2], start, fit.whitening.order)
    score = FlightFitter(loop=whole, order=fit.whitening.order).scorer(without)
    # The scores are only hints, since the whitening without motor-lag has absorbed a part of its effect.
    # Their ranking is right.
    others = [name for name in library.candidates if name not in PRESENT]
    added = ("motor-lag", *others)
    grown = score([tuple(sorted((*PRESENT[::2], name))) for name in added])
    assert added[int(np.argmax(grown))] == "motor-lag"
    assert fit.log_evidence - without.log_evidence > 3.0 / fit.whitening.temper


def test_parameters_of_simulated_flights_lie_within_their_intervals(
    library: ParameterSpace, loop: ClosedLoop
) -> None:
    true = scaled(library, motor_lag__extra_s=0.01, linear_drag__dx=0.3, thrust_gain__gain=1.0)
    squares = []
    for seed in range(4):
        made = simulated(loop, true, seed)
        fit = refine.fit_closed_loop(made, ("linear-drag", "motor-lag"), np.zeros(len(true)), 2)
        deviation = (fit.theta_scaled - true) / np.sqrt(np.diag(fit.covariance))
        squares += [deviation[i] ** 2 for name in ("linear-drag", "motor-lag") for i in library.groups[name]]
        assert abs(fit.theta_scaled[library.groups["motor-lag"][0]] * 0.015 - 0.01) < 0.002
    # Chi-square with 16 degrees of freedom: values outside these limits have a probability of 0.001.
    assert 0.2 < np.mean(squares) < 2.6


def test_residuals_and_slopes_do_not_depend_on_the_number_of_threads(loop: ClosedLoop) -> None:
    """One thread rolls out both flights together, two threads each alone."""
    theta_scaled = 0.1 * np.arange(len(loop.space.columns))
    alone = ClosedLoop(loop.recordings, loop.recordings[0].states.vehicle, loop.space, jobs=2)
    base = [each.residuals(theta_scaled[:, None]) for each in (loop, alone)]
    slopes = [
        each.slopes(theta_scaled, (), [r[0] for r in residuals], afresh=True)
        for each, residuals in zip((loop, alone), base, strict=True)
    ]
    for flight in range(2):
        np.testing.assert_array_equal(base[0][flight], base[1][flight])
        np.testing.assert_array_equal(slopes[0][flight], slopes[1][flight])


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_search_starts_from_the_point_that_predicts_the_flights_best(loop: ClosedLoop) -> None:
    neutral = np.zeros(len(loop.space.columns))
    near, far, unstable = neutral + 0.1, neutral - 0.4, neutral + np.nan
    made = simulated(loop, near, 3)
    for points in ((near, far), (far, near), (neutral, near, far), (unstable, near)):
        np.testing.assert_array_equal(best_predicting(made, points), near)
    np.testing.assert_array_equal(best_predicting(simulated(loop, neutral, 3), (far, neutral)), neutral)


def test_segments_suggest_a_set_to_start_the_search_of_whole_flights_from(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    effects = load_effects()
    flights = [FlightData.of(read_flight(DATA / f"{name}.mcap")) for name in ("a1", "b1")]
    vehicle = flights[0].flight.vehicle
    library = space(vehicle, {name: effects[name] for name in ("thrust-gain", "linear-drag", "dead-zone")})
    data, _ = segments_of(flights, rate_driven=False)
    segments = SegmentFitter(segment_model=SegmentModel.of(vehicle, library, data))
    null_fit = refit(segments.segment_model, data, (), None, iterations=3)
    loop = closed.closed_loop(flights, vehicle, library, np.zeros(len(library.columns)))
    fitter = FlightFitter(loop=loop, order=1)
    guess = guessed_from_segments(segments, null_fit, fitter)
    assert guess is not None
    assert "thrust-gain" in guess.effects
    assert "dead-zone" not in guess.effects  # whole flights do not show it
    nothing = refine.fit_closed_loop(loop, (), null_fit.theta_scaled, 1)
    assert guess.log_evidence > nothing.log_evidence + 5.0

    def diverging(*_: Any, **__: Any) -> Any:
        raise RollOutDiverged("the model with thrust-gain diverges on these flights")

    monkeypatch.setattr(selection, "fit_closed_loop", diverging)
    assert guessed_from_segments(segments, null_fit, fitter) is None


def test_slope_of_a_payload_line_is_updated_once_there_is_a_payload(loop: ClosedLoop) -> None:
    """The cached zero slope of the line without a payload is updated once there is a payload."""
    effects = load_effects()
    vehicle = loop.recordings[0].states.vehicle
    library = space(vehicle, {name: effects[name] for name in ("slung-payload", "thrust-gain")})
    nowhere, there = scaled(library), scaled(library, slung_payload__ratio=0.05)
    whole, afresh = (ClosedLoop(loop.recordings, vehicle, library) for _ in range(2))
    base = [[r[0] for r in whole.residuals(theta_scaled[:, None])] for theta_scaled in (nowhere, there)]
    (line,) = (i for i, column in enumerate(library.columns) if column.key == "length_m")
    assert not whole.slopes(nowhere, (), base[0])[0][line].any()
    wanted = afresh.slopes(there, (), base[1])[0][line]
    assert np.abs(wanted).max() > 0.0
    np.testing.assert_allclose(whole.slopes(there, ("slung-payload",), base[1])[0][line], wanted)


def test_slopes_of_forms_are_zero_unless_their_effect_is_present(
    library: ParameterSpace, loop: ClosedLoop
) -> None:
    vehicle = loop.recordings[0].states.vehicle
    there = scaled(library, linear_drag__dx=0.3)
    form_of_drag = set(library.forms["linear-drag"])
    forms = {i for columns in library.forms.values() for i in columns}
    assert forms > form_of_drag
    for theta_scaled, acting in ((scaled(library), set()), (there, form_of_drag)):
        fresh = ClosedLoop(loop.recordings, vehicle, library)
        base = [r[0] for r in fresh.residuals(theta_scaled[:, None])]
        sizes = np.abs(fresh.slopes(theta_scaled, (), base)[0]).max((1, 2))
        assert set(np.flatnonzero(sizes)) & forms == acting


def test_slopes_of_a_form_are_computed_once_its_effect_is_added(
    library: ParameterSpace, loop: ClosedLoop
) -> None:
    """The cached slopes are those of the flights without the effect."""
    vehicle = loop.recordings[0].states.vehicle
    nowhere, there = scaled(library), scaled(library, linear_drag__dx=0.3)
    cached, fresh = (ClosedLoop(loop.recordings, vehicle, library) for _ in range(2))
    base = [[r[0] for r in fresh.residuals(theta_scaled[:, None])] for theta_scaled in (nowhere, there)]
    cached.slopes(nowhere, (), base[0])
    found = cached.slopes(there, ("linear-drag",), base[1])[0]
    expected = fresh.slopes(there, ("linear-drag",), base[1])[0]
    columns = [*library.groups["linear-drag"], *library.forms["linear-drag"]]
    np.testing.assert_array_equal(found[columns], expected[columns])
    assert np.abs(found[columns]).max((1, 2)).min() > 0.0


@pytest.mark.parametrize(("overshoot", "share"), [(1.0, 1.0), (2.0, 0.5), (4.0, 0.25)])
def test_line_search_takes_the_best_share_of_a_step_that_gains_too_little(
    library: ParameterSpace, loop: ClosedLoop, overshoot: float, share: float
) -> None:
    """The linearisation, with a gradient that is too great, leads past the drag of the flights."""
    there, neutral = scaled(library, linear_drag__dx=0.3), scaled(library)
    made = simulated(loop, there, 2)
    base = [r[0] for r in made.residuals(neutral[:, None])]
    white = whitening_at(made, there)
    gram = refine.whitened_grams(white, made, base, made.slopes(neutral, (), base)).sum(0) / white.temper
    gram[0, 1:] *= overshoot
    gram[1:, 0] *= overshoot
    tried: list[int] = []
    rolled = made.with_residuals

    def counted(points: np.ndarray, work: Any) -> Any:
        tried.append(points.shape[1])
        return rolled(points, work)

    made.with_residuals = counted  # type: ignore[method-assign]
    step = overshoot * there
    cost = refine._Cost(loop=made, white=white, precision=np.zeros(len(there)))
    moved, residuals, gain_nats, missed_nats = refine._line_search(cost, neutral, step, base, gram)
    np.testing.assert_allclose(moved, share * step)
    assert gain_nats + missed_nats == pytest.approx(overshoot**2 * gain_nats, rel=0.05)
    assert tried == ([1] if share == 1.0 else [1, 3])
    for found, expected in zip(residuals, made.residuals(moved[:, None]), strict=True):
        np.testing.assert_allclose(found, expected[0], atol=1e-12)


@pytest.mark.parametrize("about", [0.0, 0.5], ids=["prior-about-zero", "prior-about-the-build"])
def test_a_fit_with_a_given_whitening_settles_where_the_slope_of_a_form_vanishes(about: float) -> None:
    """At `fast_share` 0 the flights have no slope along it, so whole steps lead to and fro."""
    flights = [read_flight(DATA / f"{name}.mcap") for name in ("a1", "b1")]
    vehicle, effects = flights[0].vehicle, load_effects()
    library = space(vehicle, {name: effects[name] for name in ("uneven-lag", "mass")})
    centre = about * scaled(library, mass__factor=1.02)
    true = centre + scaled(library, uneven_lag__ratio=3.0, uneven_lag__fast_share=0.0)
    data = [FlightData.of(each) for each in flights]
    made = simulated(closed.closed_loop(data, vehicle, library, true), true, 2)
    white = whitening_at(made, true)
    start = centre + scaled(library, uneven_lag__ratio=3.0)
    found, covariance, _, at = refine.fit_with_whitening(
        made, white, ("uneven-lag",), start, centre=centre, flight_weight=4.0
    )
    again, *_ = refine.fit_with_whitening(
        made, white, ("uneven-lag",), found, centre=centre, flight_weight=4.0
    )
    precision = refine.prior_of(library).precision(("uneven-lag",))
    cost = refine._Cost(loop=made, white=white, precision=precision, centre=centre, flight_weight=4.0)
    points = np.column_stack([true, start, at, found, again])
    of_true, of_start, of_last, of_found, of_again = cost.at(points, made.residuals(points))
    assert of_found < min(of_true, of_start)
    assert of_found <= of_last + 0.2
    assert of_again == pytest.approx(of_found, abs=0.2)
    sd = np.sqrt(np.diag(covariance))
    assert np.abs((found - true) / sd).max() < 4.0


def test_a_fit_with_a_given_whitening_starts_within_the_bounds(
    library: ParameterSpace, loop: ClosedLoop
) -> None:
    beyond = scaled(library, motor_lag__extra_s=-1.0)
    within = library.clipped(beyond)
    assert not np.array_equal(within, beyond)
    made = simulated(loop, scaled(library, motor_lag__extra_s=0.01), 3)
    white = whitening_at(made, within)
    fits = [refine.fit_with_whitening(made, white, ("motor-lag",), start) for start in (beyond, within)]
    np.testing.assert_array_equal(fits[0][0], fits[1][0])


def test_a_fit_far_below_its_start_keeps_slopes_from_nearby(
    library: ParameterSpace, loop: ClosedLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = simulated(loop, scaled(library, linear_drag__dx=0.3, motor_lag__extra_s=0.01), 4)
    refreshed: list[bool] = []
    slopes = ClosedLoop.slopes

    def counted(self: ClosedLoop, *arguments: Any, afresh: bool = False) -> Any:
        refreshed.append(afresh)
        return slopes(self, *arguments, afresh=afresh)

    monkeypatch.setattr(ClosedLoop, "slopes", counted)
    neutral, evidences = np.zeros(len(library.columns)), []
    for hopeless in (-np.inf, np.inf):
        refreshed.clear()
        fresh = ClosedLoop(made.recordings, made.recordings[0].states.vehicle, library)
        fit = refine.fit_closed_loop(fresh, ("linear-drag",), neutral, 2, hopeless=hopeless)
        evidences.append(fit.log_evidence)
        assert any(refreshed) == (hopeless < 0.0)
    assert evidences[0] == pytest.approx(evidences[1], abs=RULES.hopeless_nats)


def test_whole_flights_are_searched_without_effects_of_which_they_show_nothing() -> None:
    effects = load_effects()
    flights = [FlightData.of(read_flight(DATA / "a1.mcap"))]
    vehicle = flights[0].flight.vehicle
    library = space(vehicle, {name: effects[name] for name in ("dead-zone", "linear-drag")})
    shown = closed.closed_loop(flights, vehicle, library, np.zeros(len(library.columns))).space
    assert shown.candidates == ("linear-drag",)
    assert shown.columns == library.columns
    assert shown.parts == ("linear-drag",)


def test_evidence_prefers_the_true_drag(library: ParameterSpace, loop: ClosedLoop) -> None:
    made = simulated(loop, scaled(library, quadratic_drag__c=0.06), 5)
    zero = np.zeros(len(library.columns))
    fits = [
        refine.fit_closed_loop(made, names, zero, 2) for names in (("quadratic-drag",), ("linear-drag",), ())
    ]
    drag, linear, nothing = (fit.log_evidence for fit in fits)
    assert drag - linear > 5.0
    assert drag - nothing > 5.0


@pytest.mark.parametrize("order", [len(WINDOWS) - 1, len(WINDOWS)])
def test_fit_counts_tempered_information_in_estimate_and_evidence(
    library: ParameterSpace, loop: ClosedLoop, order: int
) -> None:
    """Computed again from the residuals that the fit is linearised at."""
    made = simulated(loop, scaled(library, quadratic_drag__c=0.06), 5)
    fit = refine.fit_closed_loop(made, ("quadratic-drag",), np.zeros(len(library.columns)), order)
    base = [r[0] for r in made.residuals(fit.at[:, None])]
    slopes = made.slopes(fit.at, fit.effects, base)
    grams = refine.whitened_grams(fit.whitening, made, base, slopes) / fit.whitening.temper
    np.testing.assert_allclose(fit.grams, grams, rtol=1e-6, atol=1e-9 * np.abs(grams).max())
    prior = refine.prior_of(library)
    total = fit.grams.sum(0)[1:, 1:] + np.diag(prior.precision(fit.effects))
    variance = np.diag(np.linalg.inv(total))
    free = ~library.at_bound(fit.theta_scaled)
    np.testing.assert_allclose(np.diag(fit.covariance)[free], variance[free], rtol=1e-3)
    bins = sum(len(whitening.usable_bins(known, whitening.span_of(order))) for known in made.known)
    log_det = bins * np.linalg.slogdet(fit.whitening.innovation)[1] / fit.whitening.temper
    (nats,) = evidence.log_evidences(grams.sum(0), log_det, fit.at, prior, [fit.effects], library.bounds)
    assert fit.log_evidence == pytest.approx(nats, rel=1e-6)


def test_recording_predicts_what_telemetry_records_of_a_motion(loop: ClosedLoop) -> None:
    """After six lost frames, the next mean covers their time too; the integral is known at its ends."""
    flight = read_flight(DATA / "a1.mcap")
    control = flight.control
    assert control is not None
    assert flight.tracking is not None
    start_s = flight.tracking[0] * 1e-6
    lost = np.searchsorted(control.t0_us * 1e-6, start_s + 2.0) + np.arange(6)
    received = np.delete(np.arange(len(control)), lost)
    t0_us = control.t0_us.copy()
    t0_us[lost[-1] + 1] = t0_us[lost[0]]
    gappy = replace(control.rows(received), t0_us=t0_us[received])
    begin, end = 9.0 * (gappy.sensed_us * 1e-6 - start_s).T
    means = (np.cos(begin) - np.cos(end)) / (end - begin)
    partial = replace(
        gappy,
        gyro_mean=np.repeat(means[:, None], 3, axis=1),
        rate_integral=np.repeat(np.sin(end)[:, None], 3, axis=1),
    )
    recording = recordings.record(FlightData.of(replace(flight, control=partial)), loop.recordings[0].states)
    t = recordings.SAMPLE_S * np.arange(recording.bins * recordings.PER_BIN + 1)
    states = np.repeat(np.sin(9.0 * t)[:, None, None], INTEGRAL.stop, axis=1)
    predicted = closed._means(recording, states, np.zeros(1))[0]
    gap = slice(48, 56)
    at = recording.known
    np.testing.assert_allclose(predicted[at, 6:], recording.measured[at, 6:], atol=2e-4)
    middle = recordings.FLIGHT_BIN_S * (np.arange(recording.bins) + 0.5)
    mean = np.sin(9.0 * middle) * np.sinc(4.5 * recordings.FLIGHT_BIN_S / np.pi)
    assert np.abs(recording.measured[gap, 6] - mean[gap]).max() > 0.02


def test_autoregression_is_recovered_and_leaves_white_innovations() -> None:
    noise = coloured(np.random.default_rng(1), 6000)
    known = np.ones(len(noise), dtype=bool)
    known[1000:1003] = False
    spoilt = noise.copy()
    spoilt[1000:1003] = 1e3
    white = whitening.autoregression([whitening.regressors(spoilt, known, 1)])
    wanted = 0.8 * np.eye(CHANNELS)
    # A first-order form of the process: position uses the attitude of the step before.
    wanted[0:3, 3:6] = 0.05 * np.eye(3)
    np.testing.assert_allclose(white.coefficients.T[:3, :6], wanted[:3, :6], atol=0.04)
    innovations = whitening.whitened(white, spoilt[None], known)[0].reshape(-1, CHANNELS)
    assert len(innovations) == len(noise) - 1 - 4
    np.testing.assert_allclose(innovations.T @ innovations / len(innovations), np.eye(CHANNELS), atol=1e-9)
    assert np.abs((innovations[1:] * innovations[:-1]).mean(0)).max() < 0.06


def test_inflated_covariance_is_never_less_than_that_of_the_fit(
    library: ParameterSpace, loop: ClosedLoop
) -> None:
    fit = refine.fit_closed_loop(loop, ("linear-drag",), np.zeros(len(library.columns)), 2)
    covariance = uncertainty.inflated_flight_covariance(library, fit, [[0], [1]])
    assert (np.diag(covariance) >= np.diag(fit.covariance)).all()
    np.linalg.cholesky(covariance)
