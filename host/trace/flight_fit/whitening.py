"""What whitens whole flights less their prediction: one coloured process in all channels at once.

A gust shows in position, attitude and rate, so a bin is regressed on the bins before it: the last ones
singly, earlier ones by their mean (Corsi 2009, "A simple approximate long-memory model of realized
volatility"). The loop lets go of a gust only after about a second. Windows that reach so far learn the few
gusts of these flights by heart and whiten no better; where sizes are told, that the innovations keep a slow
part is reckoned with instead (`trimtab.host.trace.flight_fit.fit`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.host.trace.decision.rules import RULES

CHANNELS = 12
"""Of a bin: position (heading frame), attitude (FRD), body rate (FRD), the law's rate integral (FRD): what it
holds is the torque that something else takes.
"""

WINDOWS = ((1, 1), (2, 2), (3, 3), (4, 6))
"""First and last bin back of each mean that is looked at; an autoregression of some order has the first so
many.
"""


@dataclass(frozen=True, kw_only=True)
class Whitening:
    """A vector autoregression: r_k = past_k A + e_k, past_k (12 order,) the means over WINDOWS before bin k.

    coefficients A (12 order, 12); covariance of e `innovation` (12, 12).
    """

    coefficients: np.ndarray
    innovation: np.ndarray

    @property
    def order(self) -> int:
        """How many windows are looked at."""
        return len(self.coefficients) // CHANNELS

    @property
    def span(self) -> int:
        """How many earlier bins are looked at."""
        return span_of(self.order)


def affordable(bins: int) -> int:
    """Return the greatest order whose coefficients so many known bins tell, at least 1."""
    return max(1, min(len(WINDOWS), bins // RULES.bins_per_order))


def span_of(order: int) -> int:
    """Bins that an autoregression of this order looks back."""
    return WINDOWS[order - 1][1]


def autoregression(residuals: Sequence[np.ndarray], known: Sequence[np.ndarray], order: int) -> Whitening:
    """Return the autoregression of residuals (bins, 12) by flight, where the bins it looks back at are
    known.
    """
    before, now = [], []
    for r, whole in zip(residuals, known, strict=True):
        at = stretches(whole, span_of(order))
        before.append(_past(r, order)[at])
        now.append(r[at])
    X, Y = np.concatenate(before), np.concatenate(now)
    found, *_ = np.linalg.lstsq(X, Y, rcond=None)
    left = Y - X @ found
    return Whitening(coefficients=found, innovation=left.T @ left / len(Y))


def _past(x: np.ndarray, order: int) -> np.ndarray:
    """Means (..., bins, 12 order) over the windows before each bin of x (..., bins, 12), 0 if too early."""
    bins = x.shape[-2]
    sums = np.zeros((*x.shape[:-2], bins + 1, CHANNELS))
    np.cumsum(x, axis=-2, out=sums[..., 1:, :])
    out = np.zeros((*x.shape[:-1], order * CHANNELS))
    for i, (first, last) in enumerate(WINDOWS[:order]):
        columns = slice(i * CHANNELS, (i + 1) * CHANNELS)
        found = sums[..., last - first + 1 : bins - first + 1, :] - sums[..., : bins - last, :]
        out[..., last:, columns] = found / (last - first + 1)
    return out


def stretches(known: np.ndarray, span: int) -> np.ndarray:
    """Bins that are known with the `span` bins before them."""
    run = np.convolve(known.astype(int), np.ones(span + 1, dtype=int))[: len(known)]
    at = np.flatnonzero(run == span + 1)
    return at[at >= span]


def whitened(white: Whitening, columns: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Columns (m, bins, 12) of a flight as (m, n): innovations of unit covariance."""
    at = stretches(known, white.span)
    whiten = np.linalg.inv(np.linalg.cholesky(white.innovation))
    out = columns[:, at] @ whiten.T
    out -= _past(columns, white.order)[:, at] @ (white.coefficients @ whiten.T)
    return out.reshape(len(columns), -1)
