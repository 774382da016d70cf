"""Held-out skill of a dependence: ridge regression trained without the reference that it is judged on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.features import Bins

Channel = Literal["force", "torque"]


BLOCKS = 4
"""Contiguous parts of each flight that are left out in turn where all flew one reference."""


RUN_S = 1.2
"""Length of the pieces that are drawn again for an interval: disturbances last some tenths of a second."""


FLOORS: dict[Channel, float] = {"force": RULES.force_floor_m_s2, "torque": RULES.torque_floor_rad_s2}
"""Explained disturbance, rms, below which it needs no name."""


_DRAWS = 400


_RIDGES = 10.0 ** np.arange(-3.0, 3.1)


@dataclass(frozen=True, kw_only=True)
class Skill:
    """Held-out skill of one group, 1 - MSE / variance, and the interval that holds it with 95 %.

    `rms` is what the group explains, in the channel's unit; `counts`: that it is more than nothing, and more
    than what is worth a name.
    """

    group: str
    skill: float
    low: float
    high: float
    rms: float
    counts: bool


def folds_of(bins: Bins) -> tuple[np.ndarray, Literal["reference", "blocks"]]:
    """Which fold each row is held out in (n,), and what a fold is."""
    if len(np.unique(bins.reference)) > 1:
        return bins.reference, "reference"
    return time_blocks(bins), "blocks"


def time_blocks(bins: Bins) -> np.ndarray:
    """Contiguous parts of each flight's time, whole segments, numbered alike in all flights (n,)."""
    starts = np.array([bins.t_s[bins.segment == k].min() for k in range(bins.segment.max() + 1)])
    edges = np.quantile(starts, np.arange(1, BLOCKS) / BLOCKS)
    return np.searchsorted(edges, starts, side="right")[bins.segment]


def segment_grams(columns: np.ndarray, y: np.ndarray, bins: Bins) -> np.ndarray:
    """Grams (segments, 1 + k, 1 + k) of [y | columns]."""
    whole = np.concatenate([y[:, :, None], columns], axis=2)
    count = int(bins.segment.max()) + 1
    whole = whole.reshape(count, -1, whole.shape[2])
    return np.swapaxes(whole, 1, 2) @ whole


def held_out_squares(grams: np.ndarray, bins: Bins, folds: np.ndarray, free: int) -> np.ndarray:
    """Squared error (segments,) of each segment, predicted by a fit without its fold.

    The first `free` columns are not penalised; the ridge of the others is chosen by folds of the training
    data alone.
    """
    first = np.flatnonzero(np.r_[True, np.diff(bins.segment) > 0])
    outer, inner = folds[first], time_blocks(bins)[first]
    errors = np.empty(len(grams))
    for fold in np.unique(outer):
        out = outer == fold
        rest = np.unique(outer[~out])
        parts = outer if len(rest) > 1 else inner
        ridge = _RIDGES[0]
        if grams.shape[1] > 1 + free:
            scores = np.zeros(len(_RIDGES))
            for part in np.unique(parts[~out]):
                check = ~out & (parts == part)
                fit, judge = grams[~out & ~check].sum(0), grams[check].sum(0)
                if fit[0, 0] == 0.0:
                    continue
                scores += [_error(judge, _ridge(fit, r, free)) for r in _RIDGES]
            ridge = _RIDGES[int(scores.argmin())]
        slope = _ridge(grams[~out].sum(0), ridge, free)
        errors[out] = [_error(gram, slope) for gram in grams[out]]
    return errors


def _ridge(gram: np.ndarray, ridge: float, free: int) -> np.ndarray:
    """Coefficients (k,) of least squares with a penalty in shares of the columns' mean square."""
    A, b = gram[1:, 1:], gram[1:, 0]
    scale = float(np.trace(A)) / len(A)
    penalty = np.full(len(A), ridge * scale)
    penalty[:free] = 1e-6 * scale
    return np.linalg.solve(A + np.diag(penalty), b)


def _error(gram: np.ndarray, slope: np.ndarray) -> float:
    return float(gram[0, 0] - 2.0 * gram[0, 1:] @ slope + slope @ gram[1:, 1:] @ slope)


def pieces_of(bins: Bins) -> np.ndarray:
    """Which piece each segment belongs to (segments,): the same time of a reference, in all its flights."""
    first = np.flatnonzero(np.r_[True, np.diff(bins.segment) > 0])
    piece = np.floor(bins.t_s[first] / RUN_S).astype(int)
    _, unit = np.unique(np.column_stack([bins.reference[first], piece]), axis=0, return_inverse=True)
    return unit.reshape(-1)


def skill_of_group(
    channel: Channel, group: str, errors: np.ndarray, left: np.ndarray, bins: Bins, unit: np.ndarray
) -> Skill:
    """Skill of errors over those `left` without the group, and its interval over pieces drawn again."""
    sums = np.column_stack([np.bincount(unit, errors), np.bincount(unit, left)])
    rng = np.random.default_rng(0)
    drawn = sums[rng.integers(len(sums), size=(_DRAWS, len(sums)))].sum(1)
    spread = 1.0 - drawn[:, 0] / np.maximum(drawn[:, 1], 1e-300)
    low, high = np.quantile(spread, [0.025, 0.975])
    skill = 1.0 - float(errors.sum()) / max(float(left.sum()), 1e-300)
    rms = float(np.sqrt(max(float(left.sum() - errors.sum()), 0.0) / len(bins.w)))
    return Skill(
        group=group,
        skill=skill,
        low=float(low),
        high=float(high),
        rms=rms,
        counts=bool(low > 0.0 and skill > RULES.min_skill and rms > FLOORS[channel]),
    )
