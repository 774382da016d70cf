"""Gusts: standard deviation and power spectra against the formulas of MIL-F-8785C."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest
from scipy.signal import lfilter, welch

from trimtab.sitl.gusts import Gusts
from trimtab.sitl.world import Turbulence

TICK_S, TAU_S = 0.001, 0.3
KEEP = math.exp(-TICK_S / TAU_S)


def flown(spectrum: Literal["ornstein-uhlenbeck", "dryden"], ticks: int) -> np.ndarray:
    """Gusts of a flight (ticks, 6) over their standard deviations, as the plant makes them."""
    settings = Turbulence(force_m_s2=1.0, torque_rad_s2=1.0, correlation_s=TAU_S, spectrum=spectrum)
    gusts = Gusts(settings, np.random.default_rng(3))
    start = gusts.start()
    noise = np.concatenate([gusts.noise(1024) for _ in range(ticks // 1024)])
    fresh = math.sqrt(1.0 - KEEP**2)
    out, _ = lfilter([fresh], [1.0, -KEEP], noise, axis=0, zi=KEEP * start[None])
    return np.asarray(out)


@pytest.mark.parametrize("spectrum", ["ornstein-uhlenbeck", "dryden"])
def test_gusts_have_the_stated_spectrum_in_every_axis(
    spectrum: Literal["ornstein-uhlenbeck", "dryden"],
) -> None:
    found = flown(spectrum, 1_000_000)
    assert found.std(0) == pytest.approx(np.ones(6), rel=0.06)
    hz, power = welch(found, fs=1.0 / TICK_S, nperseg=16384, axis=0)
    at = (hz > 0.1) & (hz < 20.0)
    x = 2.0 * np.pi * hz[at] * TAU_S
    along = 4.0 * TAU_S / (1.0 + x**2)
    across = 2.0 * TAU_S * (1.0 + 3.0 * x**2) / (1.0 + x**2) ** 2
    for axis in range(6):
        expected = across if spectrum == "dryden" and axis % 3 else along
        ratio = power[at, axis] / expected
        assert ratio.mean() == pytest.approx(1.0, abs=0.06)
        low, high = ratio[hz[at] < 0.4].mean(), ratio[hz[at] > 5.0].mean()
        assert (low, high) == (pytest.approx(1.0, abs=0.35), pytest.approx(1.0, abs=0.06))


def test_drydens_gusts_start_in_their_stationary_state() -> None:
    settings = Turbulence(spectrum="dryden")
    starts = np.array([Gusts(settings, np.random.default_rng(seed)).start() for seed in range(400)])
    assert starts.std(0) == pytest.approx([0.04] * 3 + [0.5] * 3, rel=0.12)


def test_flight_is_the_same_again_with_its_generator() -> None:
    assert np.array_equal(flown("dryden", 4096), flown("dryden", 4096))
