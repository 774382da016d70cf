"""Sets of effects fitted to segments."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.trace import evidence
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.next_flight.information import Instruments
from trimtab.host.trace.parameters import RollOutDiverged, space
from trimtab.host.trace.segment_fit import linearise
from trimtab.host.trace.segment_fit.fit import SegmentFitter, at_parameters, refit
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.segment_fit.rollout import roll_out

DATA = Path(__file__).parents[3] / "data"
LIBRARY = ("thrust-gain", "mass", "com-offset", "ground-effect")


def test_a_fit_is_the_optimum_of_its_linearisation() -> None:
    """A fit that ends a standard deviation early would leave a force that looks like another effect."""
    flight = read_flight(DATA / "c1.mcap")
    effects = load_effects()
    library = space(flight.vehicle, {name: effects[name] for name in LIBRARY})
    data, _ = segments_of([FlightData.of(flight)], rate_driven=False)
    form = SegmentModel.of(flight.vehicle, library, data)
    nothing = refit(form, data, (), None, iterations=2)
    fit = refit(form, data, ("thrust-gain",), nothing, iterations=1)
    white = evidence.marginal_grams(fit.lin, fit.process, library.prior)
    step, covariance = evidence.bounded_step(
        white.gram, fit.lin.theta_scaled, library.prior.precision(fit.effects), library.bounds
    )
    assert (np.abs(step) / np.sqrt(np.diag(covariance))).max() > 1.0
    np.testing.assert_allclose(fit.theta_scaled, fit.lin.theta_scaled + step)

    again = at_parameters(form, nothing, fit.effects, fit.theta_scaled, fit.covariance, 0.0)
    white = evidence.marginal_grams(again.lin, again.process, library.prior)
    moved = evidence.nuisance_step(again.lin, white, library.prior, np.zeros(len(step)))
    np.testing.assert_allclose(again.nuisances, again.lin.nuisances + moved)


def test_a_fit_of_an_effect_that_is_not_smooth_starts_where_its_start_values_gain_most() -> None:
    """The measurements are those of the model with a wide dead zone, without noise."""
    flight = read_flight(DATA / "c1.mcap")
    effects = load_effects()
    library = space(flight.vehicle, {name: effects[name] for name in (*LIBRARY, "dead-zone")})
    data, _ = segments_of([FlightData.of(flight)], rate_driven=False)
    model = SegmentModel.of(flight.vehicle, library, data)
    width, centre = library.groups["dead-zone"]
    there = np.zeros(len(library.columns))
    there[width] = 0.15 / library.columns[width].scale
    with_zone = measured_by(model, data, there)

    fitter = SegmentFitter(segment_model=model)
    nothing = refit(model, data, (), None, iterations=3)
    assert fitter.start_gain("dead-zone", nothing) < 0.0
    assert fitter.start_gain("mass", nothing) == 0.0
    assert fitter.underrated_extensions(nothing) == []

    missed = refit(model, with_zone, (), None, iterations=3)
    assert fitter.start_gain("dead-zone", missed) > 1000.0
    assert fitter.underrated_extensions(missed) == [("dead-zone",)]
    fit = fitter.fit(("dead-zone",), missed)
    found = library.values(fit.theta_scaled)
    assert found[width] == pytest.approx(0.15, rel=0.02)
    assert found[centre] == pytest.approx(1.0, abs=0.01)
    # Without the effect, its tolerance has to explain the zone: the value remains, at its price.
    without = fitter.fit((), fit)
    assert library.values(without.theta_scaled)[width] == pytest.approx(0.15, rel=0.02)
    assert fitter.fit(("dead-zone",), without).log_evidence > without.log_evidence + 20.0


def measured_by(
    model: SegmentModel, data: Segments, theta_scaled: Annotated[np.ndarray, "parameters"]
) -> Segments:
    """Return the segments with what the model at theta_scaled predicts as their measurements."""
    count = len(data.flight)
    none = np.zeros((model.nuisances, 1, count))
    predicted = roll_out(model, data, data.x0.T[:, None], theta_scaled[:, None], none)[:, :, 0]
    p, turn, rate, force = predicted.transpose(1, 2, 0).reshape(4, 3, count, -1).transpose(0, 2, 3, 1)
    measured = Rotation.from_matrix(data.R_ned_frd.reshape(-1, 3, 3))
    R = (measured * Rotation.from_rotvec(turn.reshape(-1, 3))).as_matrix().reshape(data.R_ned_frd.shape)
    return replace(data, p_ned=p, R_ned_frd=R, rate_frd=rate, force_frd=force)


def test_a_fit_is_as_wide_as_the_sensors_are_noisy_whatever_they_state() -> None:
    flight = read_flight(DATA / "c1.mcap")
    library = space(flight.vehicle, {name: load_effects()[name] for name in LIBRARY})
    data, _ = segments_of([FlightData.of(flight)], rate_driven=False)
    model = SegmentModel.of(flight.vehicle, library, data)
    column = library.groups["mass"][0]
    stated = [replace(data, sigma=share * data.sigma) for share in (0.5, 0.25)]
    fits = [refit(model, each, (), None, iterations=4) for each in stated]
    factors = [fit.lin.variance_factor for fit in fits]
    assert factors[1] == pytest.approx(4.0 * factors[0], rel=0.05)
    sds = [np.sqrt(fit.covariance[column, column]) for fit in fits]
    assert sds[1] == pytest.approx(sds[0], rel=0.05)
    given = at_parameters(model, fits[0], (), fits[0].theta_scaled, fits[0].covariance, 0.0)
    assert given.lin.variance_factor == pytest.approx(factors[0], rel=0.05)
    expected = Instruments.of(replace(fits[0], lin=fits[0].lin.with_variance_factor(1.0)))
    np.testing.assert_allclose(Instruments.of(fits[0]).sigma, np.sqrt(factors[0]) * expected.sigma)


def test_set_whose_model_diverges_is_impossible_and_ends_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = read_flight(DATA / "c1.mcap")
    library = space(flight.vehicle, {name: load_effects()[name] for name in LIBRARY})
    data, _ = segments_of([FlightData.of(flight)], rate_driven=False)
    model = SegmentModel.of(flight.vehicle, library, data)
    nothing = refit(model, data, (), None, iterations=1)
    linearised = linearise.linearise

    def diverging(*arguments: Any) -> Any:
        if arguments[1].disturbance_frd.any():
            raise RollOutDiverged("the model with mass diverges on these flights")
        return linearised(*arguments)

    disturbed = replace(nothing, data=data.with_w(np.ones_like(data.disturbance_frd)))
    monkeypatch.setattr(linearise, "linearise", diverging)
    moved = np.full(len(library.columns), 0.01)
    fit = SegmentFitter(segment_model=model).fit(
        ("mass",), replace(disturbed, lin=replace(nothing.lin, theta_scaled=moved))
    )
    assert (fit.effects, fit.log_evidence) == (("mass",), -np.inf)
    given = at_parameters(model, disturbed, (), moved, nothing.covariance, 1.0)
    assert np.isfinite(given.lin.theta_scaled).all()
    assert (given.log_evidence, given.effects) == (1.0, ())
