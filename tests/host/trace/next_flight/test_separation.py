"""Separation of two effects by the flights so far and by manoeuvres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from generators.manoeuvres import INSTRUMENTS

from tests.narrowing import not_none
from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.route import load_route
from trimtab.host.trace import words
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.next_flight.information import Instruments, information
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre, manoeuvres
from trimtab.host.trace.next_flight.separation import (
    NextFlight,
    _flown_information,
    propose,
    separation,
)
from trimtab.host.trace.parameters import ParameterSpace, space
from trimtab.host.trace.segment_fit.fit import SegmentFit, refit
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.vehicle import Vehicle, load_vehicle

DATA = Path(__file__).parents[3] / "data"
LIBRARY = ("com-offset", "frame-tilt", "linear-drag", "mass", "thrust-gain", "torque-bias", "wind")
NAMES = ("hover", "hover-turns", "doublets")


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("research")


@pytest.fixture(scope="module")
def library(vehicle: Vehicle) -> ParameterSpace:
    effects = load_effects()
    return space(vehicle, {name: effects[name] for name in LIBRARY})


@pytest.fixture(scope="module")
def segment_model(vehicle: Vehicle, library: ParameterSpace) -> SegmentModel:
    return SegmentModel(vehicle, library, dt_s=0.01, in_newton=False, rate_driven=False)


@pytest.fixture(scope="module")
def known(vehicle: Vehicle) -> dict[str, Manoeuvre]:
    return {flown.route: flown for flown in manoeuvres({n: load_route(n) for n in NAMES}, vehicle)}


@pytest.fixture(scope="module")
def fit(segment_model: SegmentModel) -> SegmentFit:
    """Return a fit to a shipped flight with an assumed offset of the centre of mass."""
    flight = read_flight(DATA / "c1.mcap")
    data, _ = segments_of([FlightData.of(flight)], rate_driven=False)
    fitted = refit(segment_model, data, ("com-offset",), None, iterations=2)
    theta_scaled = fitted.theta_scaled.copy()
    theta_scaled[list(segment_model.space.groups["com-offset"])] = 0.5
    return replace(fitted, theta_scaled=theta_scaled)


def columns_of(library: ParameterSpace, *effects: str) -> list[int]:
    return [library.groups[name][0] for name in effects]


def test_separation_of_an_effect_alone_is_its_length(library: ParameterSpace) -> None:
    (gain, tilt) = columns_of(library, "thrust-gain", "frame-tilt")
    gram = np.zeros((len(library.columns),) * 2)
    gram[gain, gain], gram[tilt, tilt] = 25.0, 100.0
    theta_scaled = np.zeros(len(library.columns))
    theta_scaled[gain] = 2.0
    assert separation(
        library, gram, ("thrust-gain",), theta_scaled, "thrust-gain", "frame-tilt"
    ) == pytest.approx(10.0)


def test_separation_from_a_parallel_alias_is_limited_by_its_prior(
    library: ParameterSpace,
) -> None:
    gain, tilt = columns_of(library, "thrust-gain", "frame-tilt")
    shape = np.zeros(len(library.columns))
    shape[[gain, tilt]] = 50.0
    theta_scaled = np.zeros(len(library.columns))
    theta_scaled[gain] = 1.0
    apart = separation(
        library, np.outer(shape, shape), ("thrust-gain",), theta_scaled, "thrust-gain", "frame-tilt"
    )
    # Two parallel columns of length 50, the alias free within 2 typical sizes: 50 / sqrt(1 + 100^2).
    assert apart == pytest.approx(50.0 / np.sqrt(1.0 + 100.0**2))


def test_separation_leaves_the_other_effects_of_the_set_free(library: ParameterSpace) -> None:
    gain, drag = columns_of(library, "thrust-gain", "linear-drag")
    shape = np.zeros(len(library.columns))
    shape[[gain, drag]] = 50.0
    gram, theta_scaled = np.outer(shape, shape), np.zeros(len(library.columns))
    theta_scaled[gain] = 1.0
    alone = separation(library, gram, ("thrust-gain",), theta_scaled, "thrust-gain", "frame-tilt")
    beside = separation(
        library, gram, ("thrust-gain", "linear-drag"), theta_scaled, "thrust-gain", "frame-tilt"
    )
    assert alone > 10.0
    assert beside < 1.0


def test_instruments_of_a_simulated_flight_are_those_of_the_simulator(fit: SegmentFit) -> None:
    instruments = Instruments.of(fit)
    np.testing.assert_allclose(instruments.sigma[1:], INSTRUMENTS.sigma[1:], rtol=0.1)
    # A varying pose latency looks like noise at speed.
    assert 1.0 <= instruments.sigma[0] / INSTRUMENTS.sigma[0] < 2.0
    np.testing.assert_allclose(instruments.shares, 1.0, atol=0.15)
    assert instruments.voltage[0] == pytest.approx(1.0, abs=1e-3)


def test_flights_so_far_tell_less_if_the_sensors_are_noisier_than_stated(
    segment_model: SegmentModel, fit: SegmentFit
) -> None:
    """Also where they are linearised again."""
    noisy = replace(fit, lin=fit.lin.with_variance_factor(4.0), nuisances=fit.lin.nuisances)
    at = noisy.lin.theta_scaled
    same = _flown_information(segment_model, replace(noisy, theta_scaled=at), at)
    again = _flown_information(segment_model, replace(noisy, theta_scaled=at), at + 1e-9)
    stated = _flown_information(segment_model, replace(noisy, lin=fit.lin, theta_scaled=at), at)
    np.testing.assert_allclose(np.diag(again), np.diag(same), rtol=0.05)
    assert (np.diag(same) <= np.diag(stated)).all()
    assert np.diag(same).sum() < 0.9 * np.diag(stated).sum()


def test_instruments_of_wrong_shape_raise() -> None:
    with pytest.raises(ValueError, match="sigma"):
        replace(INSTRUMENTS, sigma=np.array([1.0, 1.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match="shares"):
        replace(INSTRUMENTS, shares=np.ones(2))


def test_information_does_not_depend_on_the_linearisation_point(
    segment_model: SegmentModel, known: dict[str, Manoeuvre]
) -> None:
    """What a flight tells does not hang on the point it is linearised at: a torque that turns the vehicle
    over within a segment would look like information.
    """
    effect, alias = "com-offset", "torque-bias"
    theta_scaled = np.zeros(len(segment_model.space.columns))
    theta_scaled[list(segment_model.space.groups[effect])] = 1.0
    at = [
        separation(
            segment_model.space,
            not_none(information(segment_model, flat, point, INSTRUMENTS)),
            (effect,),
            theta_scaled,
            effect,
            alias,
        )
        for flat in (known["doublets"].flat,)
        for point in (np.zeros(len(theta_scaled)), theta_scaled)
    ]
    assert at[1] == pytest.approx(at[0], rel=0.1)


def test_flight_shorter_than_a_segment_has_no_information(
    segment_model: SegmentModel, known: dict[str, Manoeuvre]
) -> None:
    theta_scaled = np.zeros(len(segment_model.space.columns))
    assert information(segment_model, known["hover"].flat[:, :50], theta_scaled, INSTRUMENTS) is None


def test_wind_and_tilt_without_accelerometer_are_separated_only_by_motion(
    segment_model: SegmentModel, known: dict[str, Manoeuvre]
) -> None:
    blind = replace(INSTRUMENTS, shares=np.array([1.0, 1.0, 0.0]))
    drag = list(segment_model.space.groups["linear-drag"])
    theta_scaled = np.zeros(len(segment_model.space.columns))
    theta_scaled[drag] = 1.0
    sigma = {}
    size = np.zeros(len(theta_scaled))
    size[list(segment_model.space.groups["wind"])] = 1.0
    for name, flown in known.items():
        added = information(segment_model, flown.flat, theta_scaled, blind)
        assert added is not None
        sigma[name] = separation(segment_model.space, added, ("linear-drag",), size, "wind", "frame-tilt")
    # Hover shows that so strong a wind would require a tilt of twice the typical size.
    assert sigma["hover"] < RULES.detectable_sigma < sigma["hover-turns"]
    assert sigma["doublets"] > 4.0 * sigma["hover"]


def test_proposal_is_the_manoeuvre_of_greatest_separation_with_the_flights_so_far(
    segment_model: SegmentModel, fit: SegmentFit, known: dict[str, Manoeuvre]
) -> None:
    alone = propose(segment_model, fit, "com-offset", "torque-bias", [known["hover"]])
    best = propose(segment_model, fit, "com-offset", "torque-bias", list(known.values()))
    assert alone is not None
    assert best is not None
    assert (best.route, best.separates) == ("doublets", ("com-offset", "torque-bias"))
    assert best.so_far_sigma == alone.so_far_sigma
    assert 0.0 < best.so_far_sigma <= RULES.undecided_sigma
    assert alone.so_far_sigma < alone.expected_sigma < best.expected_sigma
    assert best.decides
    assert best.total_time_s is None
    assert propose(segment_model, fit, "com-offset", "torque-bias", []) is None


def test_alias_that_acts_through_an_absent_effect_assumes_that_effect(
    segment_model: SegmentModel, fit: SegmentFit, known: dict[str, Manoeuvre]
) -> None:
    """Without drag a wind does nothing, and a tilted frame would look as if nothing could be mistaken for
    it.
    """
    theta_scaled = fit.theta_scaled.copy()
    theta_scaled[list(segment_model.space.groups["frame-tilt"])] = 1.0
    theta_scaled[list(segment_model.space.groups["linear-drag"])] = 0.0
    tilted = replace(fit, effects=("frame-tilt",), theta_scaled=theta_scaled)
    still = propose(segment_model, tilted, "frame-tilt", "thrust-gain", [known["hover"]])
    windy = propose(segment_model, tilted, "frame-tilt", "wind", [known["hover"]])
    assert still is not None
    assert windy is not None
    assert windy.expected_sigma < 0.7 * still.expected_sigma
    assert windy.known_measurement == "fly again without wind, or level the camera system"
    assert still.known_measurement is None


def test_next_flight_states_that_no_manoeuvre_decides() -> None:
    best = NextFlight(
        route="low",
        total_time_s=14.0,
        separates=("frame-tilt", "wind"),
        so_far_sigma=0.5,
        expected_sigma=2.1,
        known_measurement="fly once more without wind, or level the camera system",
    )
    assert not best.decides
    assert words.next_flight(best) == (
        "no known route separates frame-tilt from wind well enough: the best one, low (plan it with --time-s "
        "14.0), separates them by 2.1 sigma, but 4.2 sigma are needed; fly once more without wind, or level "
        "the camera system"
    )
    enough = replace(best, expected_sigma=RULES.detectable_sigma, total_time_s=None)
    assert enough.decides
    assert enough.measurement is None
    assert words.next_flight(enough) == (
        "fly low next and trace all flights together: this separates frame-tilt and wind by 4.2 sigma, now "
        "0.5 sigma"
    )
    assert enough.to_json()["decides"] is True


def test_log_without_inputs_informs_on_forces_but_not_on_torques(
    vehicle: Vehicle, library: ParameterSpace, known: dict[str, Manoeuvre]
) -> None:
    """Thrust in N and the measured body rate drive such a log."""
    poses = replace(INSTRUMENTS, shares=np.array([0.5, 0.0, 0.0]), in_newton=True, rate_driven=True)
    segment_model = SegmentModel(vehicle, library, dt_s=0.01, in_newton=True, rate_driven=True)
    added = information(segment_model, known["doublets"].flat, np.zeros(len(library.columns)), poses)
    assert added is not None
    (drag, turn) = columns_of(library, "linear-drag", "torque-bias")
    assert added[drag, drag] > 100.0
    assert added[turn, turn] < 1e-6
