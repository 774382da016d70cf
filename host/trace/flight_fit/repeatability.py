"""What of whole flights repeats between twins: abstention over the closed loop.

Twin flights share the world and the reference and nothing else. Their difference holds turbulence and noise
only, so an autoregression fitted to it whitens without knowing any of the physics; what of the whitened
residuals the twins then have in common is physics the model lacks. Segments cannot say this as finely: what
the loop does about a gust within them looks like a wrong model, and repeats too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import FlightFit, weighted
from trimtab.host.trace.flight_fit.loop import Loop
from trimtab.host.trace.flight_fit.recording import FLIGHT_BIN_S
from trimtab.host.trace.flight_fit.whitening import (
    CHANNELS,
    Whitening,
    affordable,
    autoregression,
    stretches,
    whitened,
)
from trimtab.host.trace.residual.unexplained import FlightRepeat

_EVERY = 5


def repeatability_of(
    loop: Loop, theta_scaled: np.ndarray, order: int, twins: Sequence[tuple[int, int]]
) -> FlightRepeat | None:
    """Return what repeats at theta_scaled (P,), whitened by an autoregression of `order`; None without twins.

    `twins` pair the loop's recordings.
    """
    pairs = _pairs(loop, theta_scaled, twins)
    white = _turbulence(pairs, order)
    if white is None:
        return None
    common, variance, count, position = 0.0, 0.0, 0, 0.0
    for one, other, known in pairs:
        at = stretches(known, white.span)
        x, y = whitened(white, np.stack([one, other]), known).reshape(2, len(at), -1)
        apart = range(
            round(RULES.twin_shift_s / FLIGHT_BIN_S),
            len(at) - round(RULES.twin_shift_s / FLIGHT_BIN_S),
            _EVERY,
        )
        by_chance = [float((x * np.roll(y, shift, axis=0)).sum()) for shift in apart]
        common += float((x * y).sum())
        variance += max(float(x.size), float(np.var(by_chance)))
        count += x.size
        position += float((one[known, :3] * other[known, :3]).sum()) / int(known.sum())
    # The autoregression fits the difference, which it was made from, better than the sum: without any repeat
    # the sum's power is greater by as much as the coefficients and the innovation's covariance took up.
    rows, coefficients = count / CHANNELS, CHANNELS * white.order
    common -= 0.5 * count * (2 * coefficients + CHANNELS + 1) / (rows - coefficients - CHANNELS - 1)
    return FlightRepeat(
        share=common / count,
        z_score=common / float(np.sqrt(variance)),
        position_m=float(np.sqrt(max(position / len(pairs), 0.0))),
        size=count,
    )


def turbulence(
    loop: Loop, theta_scaled: np.ndarray, order: int, twins: Sequence[tuple[int, int]]
) -> Whitening | None:
    """Return what whitens turbulence and noise, from twins' differences at theta_scaled (P,).

    None without twins.
    """
    return _turbulence(_pairs(loop, theta_scaled, twins), order)


def in_turbulence(loop: Loop, fit: FlightFit, order: int, twins: Sequence[tuple[int, int]]) -> FlightFit:
    """Return the fit's effects fitted once more, whitened by what twins differ by; without twins only
    its covariance is another.

    The search whitens by all that a set leaves, so that what no form explains counts as noise and names
    nothing. For how large an effect is, only chance is noise: weights are then those of the flights, not of
    the library's shortcomings.
    """
    white = turbulence(loop, fit.theta_scaled, order, twins)
    if white is None:
        return replace(fit, covariance=RULES.temper * fit.covariance, grams=fit.grams / RULES.temper)
    theta_scaled, covariance, grams = weighted(loop, white, fit.effects, fit.theta_scaled)
    return replace(
        fit, theta_scaled=theta_scaled, at=theta_scaled, covariance=covariance, whitening=white, grams=grams
    )


_Pair = tuple[np.ndarray, np.ndarray, np.ndarray]


def _pairs(loop: Loop, theta_scaled: np.ndarray, twins: Sequence[tuple[int, int]]) -> list[_Pair]:
    """Of twins long enough to be compared: residuals (bins, 12) of both, and where they are known (bins,)."""
    left = [each[0] for each in loop.residuals(theta_scaled[:, None])] if twins else []
    out = []
    for a, b in twins:
        bins = min(len(left[a]), len(left[b]))
        known = loop.known[a][:bins] & loop.known[b][:bins]
        if known.sum() * FLIGHT_BIN_S >= RULES.twin_min_s:
            out.append((left[a][:bins], left[b][:bins], known))
    return out


def _turbulence(pairs: Sequence[_Pair], order: int) -> Whitening | None:
    if not pairs:
        return None
    order = min(order, affordable(sum(int(known.sum()) for *_, known in pairs)))
    gusts = [(one - other) / np.sqrt(2.0) for one, other, _ in pairs]
    return autoregression(gusts, [known for *_, known in pairs], order)
