"""Unexplained residual: repeatable and ringing parts stand out; noise and flown frequencies do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.decision.findings import Code
from trimtab.host.trace.decision.residual_rules import no_effect_bounds, residual_bounds, residual_findings
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.unexplained import FlightRepeat, UnexplainedResidual, unexplained_residual

BINS, STEPS, SEGMENTS, FLIGHTS = 6, 60, 20, 4
PAIRS = [(0, 1), (2, 3)]


def data(motion_hz: float = 0.0, each: int = SEGMENTS, turn_hz: float = 0.0) -> Segments:
    """Return `each` segments of four flights that swing slowly and at motion_hz, and rotate at turn_hz."""
    count = each * FLIGHTS
    flight = np.repeat(np.arange(FLIGHTS), each)
    start = np.tile(np.arange(each) * STEPS * 0.01, FLIGHTS)
    t = start[:, None] + 0.01 * np.arange(STEPS)
    position = np.zeros((count, STEPS, 3))
    position[:, :, 0] = np.sin(2 * np.pi * motion_hz * t)
    position[:, :, 1] = np.sin(2 * np.pi * 0.15 * t)
    n = (count, STEPS)
    rate = np.zeros((*n, 3))
    rate[:, :, 0] = np.sin(2 * np.pi * turn_hz * t)
    return Segments(
        dt_s=0.01,
        flight=flight,
        start_s=start,
        x0=np.zeros((count, 12)),
        p_ned=position,
        R_ned_frd=np.tile(np.eye(3).ravel(), (*n, 1)),
        shift_s=np.zeros(n),
        pose_weight=np.ones(n),
        rate_frd=rate,
        rate_weight=np.ones(n),
        force_frd=np.zeros((*n, 3)),
        force_weight=np.ones(n),
        command=np.zeros((count, STEPS + 5, 4)),
        voltage_ratio=np.ones(n),
        sigma=np.ones((count, 4)),
        disturbance_frd=np.zeros((count, BINS, 6)),
        path_start_s=np.zeros(count),
        paths=np.zeros((FLIGHTS, 2, 12)),
        in_newton=False,
        rate_driven=False,
    )


def codes(residual: UnexplainedResidual) -> list[Code]:
    """Return the codes of the findings on a residual, by the bounds of the model without effects."""
    return [finding.code for finding in residual_findings(residual, no_effect_bounds(RULES), RULES)]


def codes_beside(residual: UnexplainedResidual, without: UnexplainedResidual) -> list[Code]:
    """Return the same for a selected set, if `without` is the residual without effects."""
    bounds = residual_bounds(without, has_effects=True, has_memory=False, rules=RULES)
    return [finding.code for finding in residual_findings(residual, bounds, RULES)]


def noise(seed: int, each: int = SEGMENTS) -> np.ndarray:
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(each * FLIGHTS, BINS, 6))
    return w * np.array([0.05] * 3 + [0.5] * 3)


def series(hz: float, phase: np.ndarray) -> np.ndarray:
    """Return a sine (segments, bins) over each flight, with a phase for each flight."""
    t = BIN_S * np.arange(SEGMENTS * BINS)
    rows = [np.sin(2 * np.pi * hz * t + p).reshape(SEGMENTS, BINS) for p in phase]
    return np.concatenate(rows)


@pytest.mark.parametrize("each", [8, SEGMENTS, 70])
@pytest.mark.parametrize("seed", range(5))
def test_residual_of_noise_has_no_findings(seed: int, each: int) -> None:
    assert codes(unexplained_residual(noise(seed, each), data(each=each), PAIRS)) == []


def test_repeat_score_of_gusts_that_grow_with_speed_is_a_standard_normal() -> None:
    gusty = np.tile(1.0 + 4.0 * np.sin(np.linspace(0, 3, SEGMENTS)) ** 2, FLIGHTS)[:, None, None]
    scores = [unexplained_residual(noise(seed) * gusty, data(), PAIRS).force.z_score for seed in range(100)]
    assert abs(np.mean(scores)) < 0.3
    assert 0.7 < np.std(scores) < 1.3


def test_residual_of_a_repeatable_force_in_flights_of_five_seconds_repeats() -> None:
    w = noise(1, 8)
    field = np.random.default_rng(9).normal(size=(8, BINS)) * 2.0
    w[:, :, 0] += np.tile(field, (FLIGHTS, 1))
    unexplained = unexplained_residual(w, data(each=8), PAIRS[:1])
    assert Code.FORCE_REPEATS in codes(unexplained)


def test_residual_of_a_repeatable_force_repeats() -> None:
    w = noise(1)
    field = np.random.default_rng(9).normal(size=(SEGMENTS, BINS)) * 0.2
    w[:, :, 0] += np.tile(field, (FLIGHTS, 1))
    unexplained = unexplained_residual(w, data(), PAIRS)
    assert unexplained.force.repeat == pytest.approx(0.2, rel=0.25)
    assert codes(unexplained) == [Code.FORCE_REPEATS]


def test_residual_of_a_force_that_does_not_repeat_has_no_findings() -> None:
    w = noise(2)
    w[:, :, 0] += np.random.default_rng(4).normal(size=(SEGMENTS * FLIGHTS, BINS)) * 0.2
    assert codes(unexplained_residual(w, data(), PAIRS)) == []


def pushes(begins_s: Sequence[Sequence[float]], bearing: float, size: float) -> np.ndarray:
    """Return noise with pulses of half a second that begin at these times, one row for each flight."""
    w, t = noise(6), BIN_S * np.arange(SEGMENTS * BINS)
    for flight, row in enumerate(begins_s):
        on = np.any([(begin <= t) & (t < begin + 0.5) for begin in row], axis=0).reshape(SEGMENTS, BINS)
        segments = slice(flight * SEGMENTS, (flight + 1) * SEGMENTS)
        w[segments, :, 0] += size * np.cos(bearing) * on
        w[segments, :, 1] += size * np.sin(bearing) * on
    return w


def every(period_s: float, phases_s: Sequence[float]) -> list[list[float]]:
    return [np.arange(phase, SEGMENTS * BINS * BIN_S, period_s).tolist() for phase in phases_s]


@pytest.mark.parametrize("bearing", [0.3, 2.0, 4.0])
@pytest.mark.parametrize("period_s", [2.7, 3.6, 5.0])
def test_residual_of_pushes_every_few_seconds_pulses(period_s: float, bearing: float) -> None:
    w = pushes(every(period_s, (0.2, 1.9, 2.4, 0.9)), bearing, 0.3)
    unexplained = unexplained_residual(w, data(), PAIRS)
    pulses = unexplained.pulses
    assert pulses.period_s == pytest.approx(period_s, abs=0.11)
    assert pulses.bearing_rad == pytest.approx(bearing, abs=0.2)
    assert pulses.peak_m_s2 == pytest.approx(0.3, rel=0.3)
    assert Code.FORCE_PULSES in codes(unexplained)
    assert Code.FORCE_PULSES not in codes(unexplained_residual(0.15 * w, data(), PAIRS))  # below turbulence
    assert Code.FORCE_PULSES not in codes(unexplained_residual(w, data(), []))


def test_residual_of_pushes_in_a_turned_vehicle_pulses_in_the_world() -> None:
    w = pushes(every(3.6, (0.2, 1.9, 2.4, 0.9)), 0.3, 0.3)
    turned = data()
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(turned, R_ned_frd=np.tile(R.ravel(), (*turned.R_ned_frd.shape[:2], 1)))
    found = unexplained_residual(w, turned, PAIRS).pulses
    assert found.bearing_rad == pytest.approx(0.3 + np.pi / 2.0, abs=0.2)


def test_residual_of_pushes_that_repeat_or_come_at_random_seldom_pulses() -> None:
    same = pushes(every(3.6, (0.2, 0.2, 2.4, 2.4)), 0.3, 0.3)
    assert codes(unexplained_residual(same, data(), PAIRS)) == [Code.FORCE_REPEATS]
    rng = np.random.default_rng(3)
    at_random = [
        unexplained_residual(pushes(rng.uniform(0.0, 11.5, (FLIGHTS, 3)).tolist(), 0.3, 0.3), data(), PAIRS)
        for _ in range(20)
    ]
    assert sum(Code.FORCE_PULSES in codes(each) for each in at_random) <= 4


def test_residual_of_a_line_of_random_phase_rings() -> None:
    w = noise(3)
    w[:, :, 1] += 0.15 * series(0.8, np.array([0.0, 2.0, 4.0, 1.0]))
    unexplained = unexplained_residual(w, data(), PAIRS)
    assert unexplained.force.line.hz == pytest.approx(0.8, abs=0.08)
    assert Code.FORCE_RINGS in codes(unexplained)


def test_residual_with_a_line_weaker_than_turbulence_does_not_ring() -> None:
    line = 0.15 * series(0.8, np.array([0.0, 2.0, 4.0, 1.0]))
    w = noise(3)
    w[:, :, 1] += line
    calm = unexplained_residual(0.25 * w, data(), PAIRS)
    assert calm.force.line.ratio > RULES.line_ratio
    assert calm.force.line.chance < RULES.line_false_alarm
    assert calm.force.line.rms == pytest.approx(0.25 * 0.15 / np.sqrt(2.0), rel=0.2)
    assert codes(calm) == []
    assert codes(unexplained_residual(w, data(), PAIRS)) != []


@pytest.mark.parametrize("begin", [0, 50])
def test_residual_with_a_line_rings_across_left_out_segments(begin: int) -> None:
    each = 100
    w, t = noise(3, each), BIN_S * np.arange(each * BINS).reshape(each, BINS)
    w[:, :, 1] += np.tile(
        0.4 * np.sin(2 * np.pi * 0.8 * t) * (np.arange(each) >= begin)[:, None], (FLIGHTS, 1)
    )
    used = np.tile(np.arange(each) != 20, FLIGHTS)
    unexplained = unexplained_residual(w[used], data(each=each).take(used), [])
    assert unexplained.force.line.hz == pytest.approx(0.8, abs=0.08)
    assert Code.FORCE_RINGS in codes(unexplained)


def test_residual_with_a_line_at_a_flown_frequency_does_not_ring() -> None:
    w = noise(3)
    w[:, :, 1] += 0.15 * series(0.8, np.array([0.0, 2.0, 4.0, 1.0]))
    unexplained = unexplained_residual(w, data(motion_hz=0.8), PAIRS)
    assert Code.FORCE_RINGS not in codes(unexplained)


@pytest.mark.parametrize(("turn_hz", "rings"), [(2.4, False), (0.7, True)])
def test_residual_torque_rings_at_frequencies_without_flown_rotation(turn_hz: float, rings: bool) -> None:
    w = noise(3)
    w[:, :, 4] += 1.5 * series(2.4, np.array([0.0, 2.0, 4.0, 1.0]))
    unexplained = unexplained_residual(w, data(turn_hz=turn_hz), PAIRS)
    assert (Code.TORQUE_RINGS in codes(unexplained)) == rings


def test_small_repeatable_rest_of_a_large_explained_force_has_no_findings() -> None:
    w, greater = noise(1), noise(2)
    repeated = np.tile(np.random.default_rng(3).normal(size=(SEGMENTS, BINS, 3)), (FLIGHTS, 1, 1))
    w[:, :, :3] += 0.06 * repeated
    greater[:, :, :3] += 1.5 * repeated
    unexplained = unexplained_residual(w, data(), PAIRS)
    assert codes(unexplained)
    assert codes_beside(unexplained, unexplained_residual(greater, data(), PAIRS)) == []
    assert codes_beside(unexplained, unexplained_residual(noise(2), data(), PAIRS)) == codes(unexplained)


@pytest.mark.parametrize(("with_m", "without_m", "speaks"), [(0.12, 0.01, True), (0.011, 0.01, False)])
def test_effects_that_increase_the_repeatable_position_are_rejected(
    with_m: float, without_m: float, speaks: bool
) -> None:
    quiet = unexplained_residual(noise(1), data(), PAIRS)
    one, nothing = (
        replace(quiet, flight_repeat=FlightRepeat(share=0.05, z_score=5.0, position_m=position))
        for position in (with_m, without_m)
    )
    assert codes_beside(one, nothing) == ([Code.FLIGHTS_WORSENED] if speaks else [])


def test_residual_without_repeat_flights_has_no_pairs() -> None:
    unexplained = unexplained_residual(noise(0), data(), [])
    assert unexplained.pairs == 0
    assert unexplained.force.z_score == 0.0
