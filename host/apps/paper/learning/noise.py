"""Trajectory loss against labels of acceleration, over noise on the nodes and what is made of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trimtab.host.apps.paper.learning.flights import STEP_S, Flights
from trimtab.host.apps.paper.learning.measure import acceleration_error
from trimtab.host.apps.paper.learning.methods import (
    Regressor,
    condensed,
    condensed_settings,
    patience_of,
    phi_of,
)
from trimtab.host.apps.paper.learning.supervised import label, train_supervised
from trimtab.host.learn.condensed import CondensedSettings
from trimtab.host.log.smoothing import Series, Smoothed, smooth

POSITION_M, ATTITUDE_RAD, RATE_RAD_S = 1e-3, float(np.deg2rad(0.3)), 0.02
"""Noise of one node, one sigma, at scale 1."""

_DENSITIES = (20.0, 200.0, 2e3, 2e4)
"""Of jerk, (m/s^3)^2/Hz, to choose from."""
_IDENTITY = 1e4
"""Times the identity, the L of raw differences: what is known beforehand of an effect then does not count."""
_L2 = 1e-5
_LEAST = (1e-5, 1e-4, 1e-4, 1e-3)
"""No sigma is smaller: m, m/s, rad, rad/s."""


TRAJECTORY, TRAJECTORY_RAW = "trajectory loss, smoothed, starts free", "trajectory loss, raw, starts measured"
SUPERVISED, SUPERVISED_RAW = "supervised, smoothed labels", "supervised, differences"


@dataclass(frozen=True, kw_only=True, eq=False)
class Observed:
    """States (F, n, 12) with sigma (12,) and accelerations (F, n, 3) from noisy nodes.

    smoothed: positions, velocities and accelerations by a fixed-interval smoother. raw: positions as they
    came, the rest their central differences. Attitude and body rate are as measured in both.
    """

    smoothed: np.ndarray
    smoothed_a: np.ndarray
    raw: np.ndarray
    raw_a: np.ndarray
    sigma: np.ndarray


def observe(flights: Flights, scale: float, rng: np.random.Generator) -> Observed:
    """Return the flights with `scale` times the nominal noise. With 0, they are exact before smoothing."""
    x = flights.x[..., :12]
    spread = np.repeat([POSITION_M, 0.0, ATTITUDE_RAD, RATE_RAD_S], 3)
    seen = x + scale * spread * rng.standard_normal(x.shape)
    v = np.gradient(seen[..., 0:3], STEP_S, axis=1)
    raw = seen.copy()
    raw[..., 3:6] = v
    sigma_p = max(scale * POSITION_M, _LEAST[0])
    found = _smoothed(seen[..., 0:3], sigma_p)
    smoothed = seen.copy()
    smoothed[..., 0:3], smoothed[..., 3:6] = (np.stack([getattr(f, name) for f in found]) for name in "pv")
    sigmas = (
        float(np.median([f.sigma_p for f in found])),
        float(np.median([f.sigma_v for f in found])),
        scale * ATTITUDE_RAD,
        scale * RATE_RAD_S,
    )
    return Observed(
        smoothed=smoothed,
        smoothed_a=np.stack([f.a for f in found]),
        raw=raw,
        raw_a=np.gradient(v, STEP_S, axis=1),
        sigma=np.repeat(np.maximum(sigmas, _LEAST), 3),
    )


def compare(
    sets: dict[str, Flights], regressor: Regressor, scale: float, seed: int, iterations: int
) -> list[dict[str, Any]]:
    """Return acceleration errors of one regressor learned in four ways from the same noisy nodes.

    Errors are pointwise against the exact flights. Early stopping uses noisy flights too.
    """
    rng = np.random.default_rng([seed, 7])
    phi = phi_of(sets["train"], regressor)
    seen = {name: observe(sets[name], scale, rng) for name in ("train", "validation")}
    found = {}
    for method, which, weight in (
        (TRAJECTORY, "smoothed", 1.0 / np.square(seen["train"].sigma)),
        (TRAJECTORY_RAW, "raw", np.full(12, _IDENTITY)),
    ):
        train, validation = (
            sets[name].segments(phi, measured=getattr(seen[name], which), sigma=seen[name].sigma)
            for name in ("train", "validation")
        )
        found[method] = condensed(
            phi,
            train,
            validation,
            seed,
            condensed_settings(regressor.layout, iterations, l2=_L2, free_start=method == TRAJECTORY),
            weight=weight,
        ).candidate
    settings = CondensedSettings(
        layout=regressor.layout, iterations=iterations, patience=patience_of(iterations), l2=_L2
    )
    for method, which in ((SUPERVISED, "smoothed"), (SUPERVISED_RAW, "raw")):
        labelled, checked = (
            label(sets[name], getattr(seen[name], which), getattr(seen[name], f"{which}_a"))
            for name in ("train", "validation")
        )
        found[method] = train_supervised(phi, labelled, checked, settings, np.random.default_rng(seed))
    return [
        {
            "regressor": regressor.name,
            "scale": scale,
            "seed": seed,
            "method": method,
            **{name: acceleration_error(each, sets[name]).pointwise for name in ("test", "ood")},
        }
        for method, each in found.items()
    ]


def _smoothed(p: np.ndarray, sigma: float) -> list[Smoothed]:
    """Return smoothed positions (F, n, 3), with the density that best predicts the nodes left out."""
    t_s = STEP_S * np.arange(p.shape[1])

    def left_out(density: float) -> float:
        found = smooth([_series(t_s[::2], path[::2], sigma, t_s[1::2], density) for path in p])
        return float(sum(((f.p - path[1::2])[:-1] ** 2).sum() for f, path in zip(found, p, strict=True)))

    density = min(_DENSITIES, key=left_out)
    return smooth([_series(t_s, path, sigma, t_s, density) for path in p])


def _series(t_s: np.ndarray, p: np.ndarray, sigma: float, at_s: np.ndarray, density: float) -> Series:
    return Series(t_s=t_s, samples=p, sigma=sigma, at_s=at_s, jerk_density=density)
