"""Shape of the turbulence: white noise for the plant's gusts, and their state at the start of a flight.

The plant turns white noise into Ornstein-Uhlenbeck processes. These are the longitudinal gusts of Dryden's
model. Its transverse gusts have the power spectrum (1 + 3 (w t)^2) / (1 + (w t)^2)^2 with correlation time t
(MIL-F-8785C). White noise that first passes a lead-lag filter gives them.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from trimtab.sitl.plant_model import TICK_S
from trimtab.sitl.world import Turbulence

_TRANSVERSE = (1, 2, 4, 5)
"""Gusts with the transverse spectrum: force along east and down, torque in pitch and yaw."""

_SETTLE = 20.0
"""Duration from rest to the stationary state, in correlation times."""


class Gusts:
    """Source of a flight's turbulence. `rng` is the generator of the flight."""

    def __init__(self, settings: Turbulence, rng: np.random.Generator) -> None:
        self._rng = rng
        self._sd = np.array([settings.force_m_s2] * 3 + [settings.torque_rad_s2] * 3)
        self._filter = _lead_lag(settings) if settings.spectrum == "dryden" else None
        self._memory = np.zeros((1, len(_TRANSVERSE)))
        self._settle = round(_SETTLE * settings.correlation_s / TICK_S)
        self._keep = math.exp(-TICK_S / settings.correlation_s)

    def start(self) -> Annotated[np.ndarray, "6"]:
        """Return the gusts at the start of a flight, from the stationary distribution.

        Accelerations in NED, m/s^2, and angular accelerations in FRD, rad/s^2.
        """
        if self._filter is None:
            return self._rng.standard_normal(6) * self._sd
        fresh = math.sqrt(1.0 - self._keep * self._keep)
        self._memory[:] = 0.0
        noise = self.noise(self._settle)
        past, _ = _filtered(np.array([fresh, 0.0]), np.array([1.0, -self._keep]), noise, np.zeros((1, 6)))
        return past[-1] * self._sd

    def noise(self, ticks: int) -> Annotated[np.ndarray, "ticks 6"]:
        """Return the noise that drives the gusts in the next ticks."""
        noise = self._rng.standard_normal((ticks, 6))
        if self._filter is not None:
            shaped, self._memory = _filtered(*self._filter, noise[:, _TRANSVERSE], self._memory)
            noise[:, _TRANSVERSE] = shaped
        return noise


def _filtered(
    numerator: np.ndarray, denominator: np.ndarray, noise: np.ndarray, memory: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the filtered noise (ticks, n), and the memory of the filter (1, n) after it."""
    from scipy.signal import lfilter  # takes longer to import than most flights take, and few need it

    out, after = lfilter(numerator, denominator, noise, axis=0, zi=memory)
    return np.asarray(out), np.asarray(after)


def _lead_lag(settings: Turbulence) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator of the filter; it keeps the standard deviation of the gusts."""
    keep = math.exp(-TICK_S / settings.correlation_s)
    lead = math.exp(-TICK_S / (math.sqrt(3.0) * settings.correlation_s))
    k = np.arange(round(_SETTLE * settings.correlation_s / TICK_S))
    response = (k + 1.0) * keep**k - lead * k * keep ** np.maximum(k - 1, 0)
    gain = 1.0 / math.sqrt((1.0 - keep * keep) * float(response @ response))
    return gain * np.array([1.0, -lead]), np.array([1.0, -keep])
