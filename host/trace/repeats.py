"""What of whole flights repeats between twins: abstention over the closed loop.

Twin flights share the world and the reference and nothing else. Their difference holds turbulence and noise
only, so an autoregression fitted to it whitens without knowing any of the physics; what of the whitened
residuals the twins then have in common is physics the model lacks. Segments cannot say this as finely: what
the loop does about a gust within them looks like a wrong model, and repeats too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from host.trace.refine import BIN_S, CHANNELS, Loop, autoregression, stretches, whitened
from host.trace.twins import Repeat

APART_S = 1.0
"""Twins shifted by more than this have nothing in common but by chance."""

_EVERY = 5


def repeat(loop: Loop, z: np.ndarray, order: int, twins: Sequence[tuple[int, int]]) -> Repeat | None:
    """What repeats at scaled parameters z (P,), whitened to an autoregression of `order`; None without twins.

    `twins` pair the loop's recordings.
    """
    if not twins:
        return None
    left = [each[0] for each in loop.residuals(z[:, None])]
    pairs = [(left[a][: len(left[b])], left[b][: len(left[a])]) for a, b in twins]
    known = [loop.known[a][: len(left[b])] & loop.known[b][: len(left[a])] for a, b in twins]
    gusts = [(one - other) / np.sqrt(2.0) for one, other in pairs]
    white = autoregression(gusts, known, order)
    common, variance, count, position = 0.0, 0.0, 0, 0.0
    for (one, other), whole in zip(pairs, known, strict=True):
        at = stretches(whole, order)
        if len(at) < 4 * APART_S / BIN_S:
            continue
        x, y = whitened(white, np.stack([one, other]), whole).reshape(2, len(at), -1)
        apart = range(round(APART_S / BIN_S), len(at) - round(APART_S / BIN_S), _EVERY)
        by_chance = [float((x * np.roll(y, shift, axis=0)).sum()) for shift in apart]
        common += float((x * y).sum())
        variance += max(float(x.size), float(np.var(by_chance)))
        count += x.size
        position += float((one[whole, :3] * other[whole, :3]).sum()) / int(whole.sum())
    if not count:
        return None
    # The autoregression fits the difference, which it was made from, better than the sum: without any repeat
    # the sum's power is greater by as much as the coefficients and the innovation's covariance took up.
    rows, coefficients = count / CHANNELS, CHANNELS * order
    common -= 0.5 * count * (2 * coefficients + CHANNELS + 1) / (rows - coefficients - CHANNELS - 1)
    return Repeat(
        share=common / count,
        z=common / float(np.sqrt(variance)),
        position_m=float(np.sqrt(max(position / len(pairs), 0.0))),
    )
