"""Abstention: repeatable leftovers and ringing ones stand out, noise and driven frequencies do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trimtab.host.trace.segments import BIN_S, Segments
from trimtab.host.trace.twins import LINE_CHANCE, LINE_RATIO, Repeat, leftover

BINS, STEPS, SEGMENTS, FLIGHTS = 6, 60, 20, 4
PAIRS = [(0, 1), (2, 3)]


def data(motion_hz: float = 0.0, each: int = SEGMENTS, turn_hz: float = 0.0) -> Segments:
    """`each` segments of four flights that swing slowly, and at `motion_hz`, and turn at `turn_hz`."""
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
        position=position,
        attitude=np.tile(np.eye(3).ravel(), (*n, 1)),
        shift_s=np.zeros(n),
        pose_weight=np.ones(n),
        rate=rate,
        rate_weight=np.ones(n),
        force=np.zeros((*n, 3)),
        force_weight=np.ones(n),
        command=np.zeros((count, STEPS + 5, 4)),
        voltage_ratio=np.ones(n),
        sigma=np.ones((count, 4)),
        w=np.zeros((count, BINS, 6)),
        path_start_s=np.zeros(count),
        paths=np.zeros((FLIGHTS, 2, 12)),
        in_newton=False,
        rate_driven=False,
    )


def noise(seed: int, each: int = SEGMENTS) -> np.ndarray:
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(each * FLIGHTS, BINS, 6))
    return w * np.array([0.05] * 3 + [0.5] * 3)


def series(hz: float, phase: np.ndarray) -> np.ndarray:
    """(segments, bins) of a sine over each flight, with a phase for each flight."""
    t = BIN_S * np.arange(SEGMENTS * BINS)
    rows = [np.sin(2 * np.pi * hz * t + p).reshape(SEGMENTS, BINS) for p in phase]
    return np.concatenate(rows)


@pytest.mark.parametrize("each", [8, SEGMENTS, 70])
@pytest.mark.parametrize("seed", range(5))
def test_leftover_of_noise_gives_no_reason(seed: int, each: int) -> None:
    assert leftover(noise(seed, each), data(each=each), PAIRS).reasons == ()


def test_repeat_score_of_gusts_that_grow_with_speed_is_a_standard_normal() -> None:
    gusty = np.tile(1.0 + 4.0 * np.sin(np.linspace(0, 3, SEGMENTS)) ** 2, FLIGHTS)[:, None, None]
    scores = [leftover(noise(seed) * gusty, data(), PAIRS).force_z for seed in range(100)]
    assert abs(np.mean(scores)) < 0.3
    assert 0.7 < np.std(scores) < 1.3


def test_leftover_of_a_repeatable_force_in_flights_of_five_seconds_names_it() -> None:
    w = noise(1, 8)
    field = np.random.default_rng(9).normal(size=(8, BINS)) * 2.0
    w[:, :, 0] += np.tile(field, (FLIGHTS, 1))
    found = leftover(w, data(each=8), PAIRS[:1])
    assert any("force" in reason and "repeats" in reason for reason in found.reasons)


def test_leftover_of_a_repeatable_force_names_it() -> None:
    w = noise(1)
    field = np.random.default_rng(9).normal(size=(SEGMENTS, BINS)) * 0.2
    w[:, :, 0] += np.tile(field, (FLIGHTS, 1))
    found = leftover(w, data(), PAIRS)
    assert found.force_repeat == pytest.approx(0.2, rel=0.25)
    assert any("force" in reason and "repeats" in reason for reason in found.reasons)
    assert not any("angular" in reason for reason in found.reasons)


def test_leftover_of_a_force_that_does_not_repeat_stays_silent() -> None:
    w = noise(2)
    w[:, :, 0] += np.random.default_rng(4).normal(size=(SEGMENTS * FLIGHTS, BINS)) * 0.2
    assert leftover(w, data(), PAIRS).reasons == ()


def test_leftover_of_a_line_of_random_phase_rings() -> None:
    w = noise(3)
    w[:, :, 1] += 0.15 * series(0.8, np.array([0.0, 2.0, 4.0, 1.0]))
    found = leftover(w, data(), PAIRS)
    assert found.force_line_hz == pytest.approx(0.8, abs=0.08)
    assert any("rings" in reason for reason in found.reasons)


def test_leftover_of_a_clear_line_weaker_than_turbulence_is_no_ringing() -> None:
    line = 0.15 * series(0.8, np.array([0.0, 2.0, 4.0, 1.0]))
    w = noise(3)
    w[:, :, 1] += line
    calm = leftover(0.25 * w, data(), PAIRS)
    assert calm.force_line > LINE_RATIO
    assert calm.force_line_chance < LINE_CHANCE
    assert calm.force_line_rms == pytest.approx(0.25 * 0.15 / np.sqrt(2.0), rel=0.2)
    assert calm.reasons == ()
    assert leftover(w, data(), PAIRS).reasons != ()


@pytest.mark.parametrize("begin", [0, 50])
def test_leftover_of_a_line_late_in_long_flights_rings_across_segments_left_out(begin: int) -> None:
    each = 100
    w, t = noise(3, each), BIN_S * np.arange(each * BINS).reshape(each, BINS)
    w[:, :, 1] += np.tile(
        0.4 * np.sin(2 * np.pi * 0.8 * t) * (np.arange(each) >= begin)[:, None], (FLIGHTS, 1)
    )
    kept = np.tile(np.arange(each) != 20, FLIGHTS)
    found = leftover(w[kept], data(each=each).take(kept), [])
    assert found.force_line_hz == pytest.approx(0.8, abs=0.08)
    assert any("rings" in reason for reason in found.reasons)


def test_leftover_of_a_line_at_the_motions_own_frequency_is_no_ringing() -> None:
    w = noise(3)
    w[:, :, 1] += 0.15 * series(0.8, np.array([0.0, 2.0, 4.0, 1.0]))
    found = leftover(w, data(motion_hz=0.8), PAIRS)
    assert not any("rings" in reason for reason in found.reasons)


@pytest.mark.parametrize(("turn_hz", "rings"), [(2.4, False), (0.7, True)])
def test_leftover_of_a_torque_rings_where_the_vehicle_was_not_made_to_turn(
    turn_hz: float, rings: bool
) -> None:
    w = noise(3)
    w[:, :, 4] += 1.5 * series(2.4, np.array([0.0, 2.0, 4.0, 1.0]))
    found = leftover(w, data(turn_hz=turn_hz), PAIRS)
    assert any("torque rings" in reason for reason in found.reasons) == rings


def test_what_repeats_beside_a_much_greater_force_that_was_explained_is_no_reason() -> None:
    w, greater = noise(1), noise(2)
    twin = np.tile(np.random.default_rng(3).normal(size=(SEGMENTS, BINS, 3)), (FLIGHTS, 1, 1))
    w[:, :, :3] += 0.06 * twin
    greater[:, :, :3] += 1.5 * twin
    found = leftover(w, data(), PAIRS)
    assert found.reasons
    assert not found.beside(leftover(greater, data(), PAIRS)).reasons
    assert found.beside(leftover(noise(2), data(), PAIRS)).reasons == found.reasons


@pytest.mark.parametrize(("with_m", "without_m", "speaks"), [(0.12, 0.01, True), (0.011, 0.01, False)])
def test_effects_with_which_more_of_the_position_repeats_explain_nothing(
    with_m: float, without_m: float, speaks: bool
) -> None:
    quiet = leftover(noise(1), data(), PAIRS)
    one, nothing = (
        replace(quiet, whole=Repeat(share=0.05, z=5.0, position_m=position))
        for position in (with_m, without_m)
    )
    assert bool(one.beside(nothing).reasons) == speaks


def test_leftover_without_twins_says_so() -> None:
    found = leftover(noise(0), data(), [])
    assert found.pairs == 0
    assert found.force_z == 0.0
