"""Whitening of the residuals of whole flights: one vector autoregression over all channels.

A gust shows in position, attitude and rate at once, so all channels of a bin are regressed on all channels of
the bins before it. Recent bins enter one by one, earlier ones as means (Corsi 2009, "A simple approximate
long-memory model of realized volatility"). The closed loop takes about a second to reject a gust. Windows
that reach back that far overfit the few gusts of the flights and whiten no better. The innovations therefore
keep a slow part; the fits allow for it by `RULES.temper`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from trimtab.host.trace.decision.rules import RULES

CHANNELS = 12
"""Channels of a bin, three each: position (heading frame), attitude (FRD), body rate (FRD) and rate integral
of the control law (FRD). The rate integral shows the torque that counteracts an unmodelled torque.
"""

WINDOWS = ((1, 1), (2, 2), (3, 3), (4, 6))
"""First and last bin of each window, counted back from the current bin. An autoregression of order n uses the
means over the first n windows.
"""

_TRIANGLES = 64
"""Most triangles of flights in memory."""


@dataclass(frozen=True, kw_only=True)
class Whitening:
    """A vector autoregression r_k = past_k A + e_k; past_k (12 order,) are means over WINDOWS before bin k.

    coefficients: A. innovation: covariance of e.
    """

    coefficients: Annotated[np.ndarray, "past 12"]
    innovation: Annotated[np.ndarray, "12 12"]

    @cached_property
    def root(self) -> Annotated[np.ndarray, "12 12"]:
        """The matrix that e is multiplied by from the right for unit covariance."""
        return np.linalg.inv(np.linalg.cholesky(self.innovation)).T

    @property
    def order(self) -> int:
        """Number of windows."""
        return len(self.coefficients) // CHANNELS

    @property
    def temper(self) -> float:
        """By what the information of the innovations is divided, since they are not quite white."""
        return RULES.temper[self.order - 1]

    @property
    def span(self) -> int:
        """Number of earlier bins that a prediction uses."""
        return span_of(self.order)


def affordable(known: Collection[Annotated[np.ndarray, "bins"]]) -> int:
    """Return the greatest order that the bins of flights determine by RULES.bins_per_order; at least 1.

    known: mask of each flight. An order counts the bins that it can use, by `usable_bins`.
    """

    def usable(order: int) -> int:
        return sum(len(usable_bins(mask, span_of(order))) for mask in known)

    orders = range(1, len(WINDOWS) + 1)
    return max((order for order in orders if usable(order) >= order * RULES.bins_per_order), default=1)


def span_of(order: int) -> int:
    """Return the number of earlier bins that an autoregression of this order uses."""
    return WINDOWS[order - 1][1]


@dataclass(frozen=True, kw_only=True)
class Regressors:
    """Residual of a flight, reduced to what an autoregression needs.

    triangle: R of [past | residual] = Q R over the usable bins. count: number of usable bins.
    """

    triangle: Annotated[np.ndarray, "rows past_and_12"]
    count: int


def regressors(
    residual: Annotated[np.ndarray, "bins 12"], known: Annotated[np.ndarray, "bins"], order: int
) -> Regressors:
    """Return the regressors of a flight. A bin is used if it and the `span_of(order)` before it are known."""
    usable = usable_bins(known, span_of(order))
    columns = np.concatenate([_past(residual, order)[usable], residual[usable]], axis=1)
    return Regressors(triangle=_triangle(columns), count=len(usable))


def autoregression(flights: Iterable[Regressors]) -> Whitening:
    """Return the autoregression fitted to the residuals of flights by least squares."""
    triangles: list[np.ndarray] = []
    count = 0
    for flight in flights:
        triangles.append(flight.triangle)
        count += flight.count
        if len(triangles) == _TRIANGLES:
            triangles = [_triangle(np.concatenate(triangles))]
    triangle = _triangle(np.concatenate(triangles))
    X, Y = triangle[:, :-CHANNELS], triangle[:, -CHANNELS:]
    coefficients, *_ = np.linalg.lstsq(X, Y, rcond=None)
    innovations = Y - X @ coefficients
    return Whitening(coefficients=coefficients, innovation=innovations.T @ innovations / count)


def _triangle(columns: np.ndarray) -> np.ndarray:
    """Return the triangle R of columns = Q R, whose Gram is that of the columns."""
    return np.asarray(np.linalg.qr(columns, mode="r"))


def _past(x: np.ndarray, order: int) -> np.ndarray:
    """Return means (..., bins, 12 order) over the windows before each bin of x (..., bins, 12).

    A window that begins before the first bin has a mean of 0.
    """
    bins = x.shape[-2]
    sums = np.zeros((*x.shape[:-2], bins + 1, CHANNELS))
    np.cumsum(x, axis=-2, out=sums[..., 1:, :])
    out = np.zeros((*x.shape[:-1], order * CHANNELS))
    for i, (first, last) in enumerate(WINDOWS[:order]):
        columns = slice(i * CHANNELS, (i + 1) * CHANNELS)
        window_sums = sums[..., last - first + 1 : bins - first + 1, :] - sums[..., : bins - last, :]
        out[..., last:, columns] = window_sums / (last - first + 1)
    return out


def usable_bins(known: Annotated[np.ndarray, "bins"], span: int) -> Annotated[np.ndarray, "usable"]:
    """Return the indices of bins that are known together with the `span` bins before them."""
    counts = np.convolve(known.astype(int), np.ones(span + 1, dtype=int))[: len(known)]
    usable = np.flatnonzero(counts == span + 1)
    return usable[usable >= span]


def whitened(
    white: Whitening, columns: Annotated[np.ndarray, "columns bins 12"], known: Annotated[np.ndarray, "bins"]
) -> Annotated[np.ndarray, "columns innovations"]:
    """Return columns of one flight as innovations of unit covariance, in the precision of the columns.

    known: mask. There are 12 innovations for each bin that `usable_bins` returns.
    """
    usable = usable_bins(known, white.span)
    out = columns @ white.root.astype(columns.dtype)
    for i, (first, last) in enumerate(WINDOWS[: white.order]):
        window = white.coefficients[i * CHANNELS : (i + 1) * CHANNELS] / (last - first + 1)
        predicted = columns @ (window @ white.root).astype(columns.dtype)
        for lag in range(first, last + 1):
            out[:, lag:] -= predicted[:, :-lag]
    return out[:, usable].reshape(len(columns), -1)
