"""Unexplained residual: repeatability of whole flights, and the channels that do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.host.trace.builders import build_flight_repeat, build_segments
from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.unexplained import NO_LINE, FlightRepeat, unexplained_residual

ABOVE = 1 + 1e-6
REPEAT_Z = RULES.repeat_z


@pytest.mark.parametrize(
    ("repeat", "lower_share", "nats"),
    [
        pytest.param(build_flight_repeat(share=0.5, z_score=0.0), 0.0, 0.0, id="nothing"),
        pytest.param(build_flight_repeat(share=0.5, z_score=REPEAT_Z), 0.0, 0.0, id="z-at"),
        pytest.param(build_flight_repeat(share=0.6, z_score=REPEAT_Z * ABOVE), 0.2, 300.0, id="z-just-above"),
        pytest.param(build_flight_repeat(share=0.5, z_score=4.0), 0.25, 250.0, id="two-standard-errors-down"),
        pytest.param(build_flight_repeat(share=0.5, z_score=40.0), 0.475, 250.0, id="well-known"),
        pytest.param(build_flight_repeat(share=0.5, z_score=40.0, size=10), 0.475, 2.5, id="few-numbers"),
        pytest.param(
            build_flight_repeat(share=0.5, z_score=40.0, position_m=9.0), 0.475, 250.0, id="any-position"
        ),
        pytest.param(build_flight_repeat(share=-0.5, z_score=-40.0), 0.0, 0.0, id="reversed"),
    ],
)
def test_lower_share_is_two_standard_errors_below_if_significant(
    repeat: FlightRepeat, lower_share: float, nats: float
) -> None:
    assert repeat.lower_share(RULES) == pytest.approx(lower_share, rel=1e-5)
    assert repeat.attainable_nats(RULES) == pytest.approx(nats, rel=1e-5)


def test_flight_repeat_uses_the_given_rules() -> None:
    repeat, stricter = (
        build_flight_repeat(share=0.5, z_score=4.0),
        replace(RULES, repeat_z=4.0),
    )
    assert (repeat.lower_share(stricter), repeat.attainable_nats(stricter)) == (0.0, 0.0)


@pytest.mark.parametrize(("share", "amplitude"), [(-0.5, 0.0), (0.0, 0.0), (0.25, 0.5), (4.0, 2.0)])
def test_flight_repeat_amplitude_is_the_root_of_its_share(share: float, amplitude: float) -> None:
    assert build_flight_repeat(share=share, z_score=10.0).amplitude == pytest.approx(amplitude)


COUNT, BINS, STEPS = 30, 6, 60
REPEAT_FLIGHTS = [(0, 1)]


def build_repeat_flights(*, rate_driven: bool = False) -> Segments:
    """Return segments of two flights that stand still; one flight holds COUNT segments of BINS bins."""
    n = 2 * COUNT
    return replace(
        build_segments(rate_driven=rate_driven),
        dt_s=0.01,
        flight=np.repeat([0, 1], COUNT),
        start_s=np.tile(np.arange(COUNT) * BINS * BIN_S, 2),
        p_ned=np.zeros((n, STEPS, 3)),
        R_ned_frd=np.tile(np.eye(3).ravel(), (n, STEPS, 1)),
        rate_frd=np.zeros((n, STEPS, 3)),
        rate_weight=np.ones((n, STEPS)),
        command=np.zeros((n, STEPS + 5, 4)),
        disturbance_frd=np.zeros((n, BINS, 6)),
    )


def disturbance_in(axis: int) -> np.ndarray:
    """Return noise (2 COUNT, BINS, 6) with a force that repeats and a line of 0.8 Hz along one axis."""
    rng = np.random.default_rng(3)
    w = 0.05 * rng.normal(size=(2 * COUNT, BINS, 6))
    t = BIN_S * np.arange(COUNT * BINS).reshape(COUNT, BINS)
    both = rng.normal(size=(COUNT, BINS)) + 2.0 * np.sin(2 * np.pi * 0.8 * t)
    w[:, :, axis] += np.tile(both, (2, 1))
    return w


@pytest.mark.parametrize(
    ("axis", "axial", "channel"),
    [
        pytest.param(0, True, "force", id="north"),
        pytest.param(2, True, "force", id="along-the-thrust"),
        pytest.param(0, False, "force", id="north-with-the-thrust-unknown"),
        pytest.param(2, False, None, id="along-an-unknown-thrust"),
        pytest.param(3, True, "torque", id="roll"),
        pytest.param(5, False, "torque", id="yaw-with-the-thrust-unknown"),
    ],
)
def test_residual_shows_in_its_own_channel_and_not_along_an_unknown_thrust(
    axis: int, axial: bool, channel: str | None
) -> None:
    unexplained = unexplained_residual(
        disturbance_in(axis), build_repeat_flights(), REPEAT_FLIGHTS, axial=axial
    )
    for name in ("force", "torque"):
        one = getattr(unexplained, name)
        assert (one.z_score > RULES.repeat_z) == (name == channel)
        assert (one.line.ratio > RULES.line_ratio) == (name == channel)
    assert unexplained.pairs == 1
    assert unexplained.flight_repeat is None


def test_residual_of_a_driven_rate_has_no_line_in_torque() -> None:
    w = disturbance_in(4)
    assert (
        unexplained_residual(w, build_repeat_flights(), REPEAT_FLIGHTS).torque.line.ratio > RULES.line_ratio
    )
    driven = unexplained_residual(w, build_repeat_flights(rate_driven=True), REPEAT_FLIGHTS)
    assert driven.torque.line == NO_LINE
    force = disturbance_in(0)
    assert (
        unexplained_residual(force, build_repeat_flights(rate_driven=True), REPEAT_FLIGHTS).force.line.ratio
        > 3.5
    )


@pytest.mark.parametrize("repeat_flights", [[], [(0, 1)], [(0, 1), (1, 0)]], ids=len)
def test_residual_counts_its_pairs_of_repeat_flights(repeat_flights: list[tuple[int, int]]) -> None:
    unexplained = unexplained_residual(disturbance_in(0), build_repeat_flights(), repeat_flights)
    assert unexplained.pairs == len(repeat_flights)
    assert (unexplained.force.z_score != 0.0) == bool(repeat_flights)


def test_residual_z_score_is_scaled_by_products_at_other_times() -> None:
    """Noise has a z score of order 1, whatever its size; only a repeatable part increases it."""
    rng = np.random.default_rng(11)
    scores = [
        unexplained_residual(
            size * rng.normal(size=(2 * COUNT, BINS, 6)), build_repeat_flights(), REPEAT_FLIGHTS
        ).force.z_score
        for size in np.geomspace(1e-3, 1e3, 60)
    ]
    assert abs(np.mean(scores)) < 0.4  # three standard errors
    assert 0.7 < np.std(scores) < 1.3


def test_residual_z_score_of_identical_noise_grows_with_the_amount_compared() -> None:
    """The squared cosine of two random segments of n values is 1/n, so the z score is sqrt(n COUNT)."""
    w = np.zeros((2 * COUNT, BINS, 6))
    w[:, :, :3] = np.tile(np.random.default_rng(7).normal(size=(COUNT, BINS, 3)), (2, 1, 1))
    unexplained = unexplained_residual(w, build_repeat_flights(), REPEAT_FLIGHTS).force
    assert unexplained.z_score == pytest.approx(np.sqrt(3 * BINS * COUNT), rel=0.15)
    # Per bin: three channels of unit variance.
    assert unexplained.repeat == pytest.approx(np.sqrt(3.0), rel=0.1)


def test_residual_that_reverses_between_repeat_flights_is_negative() -> None:
    w = disturbance_in(1)
    w[COUNT:] *= -1.0
    unexplained = unexplained_residual(w, build_repeat_flights(), REPEAT_FLIGHTS)
    assert unexplained.force.repeat < 0.0
    assert unexplained.force.z_score < 0.0


def test_residual_does_not_repeat_if_one_repeat_flight_has_no_segments() -> None:
    unexplained = unexplained_residual(disturbance_in(0), build_repeat_flights(), [(0, 2)])
    assert (unexplained.force.repeat, unexplained.force.z_score) == (0.0, 0.0)
