"""Held-out skill of a group of quantities, by ridge regression and cross-validation over references."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.features import Bins

Channel = Literal["force", "torque"]

BLOCKS = 4
"""Contiguous parts of each flight that are held out in turn if all flights flew one reference."""

RUN_S = 1.2
"""Length of the pieces that the bootstrap draws. Disturbances are correlated over some tenths of a second."""

FLOORS: dict[Channel, float] = {"force": RULES.force_floor_m_s2, "torque": RULES.torque_floor_rad_s2}
"""Explained rms, in m/s^2 or rad/s^2, below which a dependence is not worth naming."""

_DRAWS = 400
"""Bootstrap draws."""

_RIDGES = 10.0 ** np.arange(-3.0, 3.1)
"""Ridge penalties that are tried, as shares of the mean square of the columns."""


@dataclass(frozen=True, kw_only=True)
class Skill:
    """Held-out skill of one group of quantities.

    Attributes
    ----------
    group
        Name of the group.
    skill
        1 - MSE / variance on held-out data.
    low, high
        95 % interval of the skill.
    rms
        Explained disturbance, in m/s^2 or rad/s^2.
    counts
        Whether the skill is significant and both skill and rms are worth naming.
    """

    group: str
    skill: float
    low: float
    high: float
    rms: float
    counts: bool


def folds_of(bins: Bins) -> tuple[Annotated[np.ndarray, "rows"], Literal["reference", "blocks"]]:
    """Return the fold in which each row is held out, and what a fold is."""
    if len(np.unique(bins.reference)) > 1:
        return bins.reference, "reference"
    return time_blocks(bins), "blocks"


def time_blocks(bins: Bins) -> Annotated[np.ndarray, "rows"]:
    """Return the time block of each row.

    A block holds whole segments and covers the same time in all flights.
    """
    starts = np.array([bins.t_s[bins.segment == k].min() for k in range(bins.segment.max() + 1)])
    edges = np.quantile(starts, np.arange(1, BLOCKS) / BLOCKS)
    return np.searchsorted(edges, starts, side="right")[bins.segment]


def segment_grams(
    columns: Annotated[np.ndarray, "rows 3 regressors"], y: Annotated[np.ndarray, "rows 3"], bins: Bins
) -> Annotated[np.ndarray, "segments columns columns"]:
    """Return the Grams of [y | columns] of each segment."""
    whole = np.concatenate([y[:, :, None], columns], axis=2)
    count = int(bins.segment.max()) + 1
    whole = whole.reshape(count, -1, whole.shape[2])
    return np.swapaxes(whole, 1, 2) @ whole


def held_out_squares(
    grams: Annotated[np.ndarray, "segments columns columns"],
    bins: Bins,
    folds: Annotated[np.ndarray, "rows"],
    free: int,
) -> Annotated[np.ndarray, "segments"]:
    """Return the squared error of each segment, predicted by a fit without its fold.

    Parameters
    ----------
    grams
        Grams of [y | columns].
    bins
        Bins of the segments.
    folds
        Fold of each row.
    free
        Number of leading columns that are (almost) not penalised. The ridge penalty of the others is chosen
        by cross-validation within the training data.
    """
    first = np.flatnonzero(np.r_[True, np.diff(bins.segment) > 0])
    outer, inner = folds[first], time_blocks(bins)[first]
    errors = np.empty(len(grams))
    for fold in np.unique(outer):
        held_out = outer == fold
        training_folds = np.unique(outer[~held_out])
        parts = outer if len(training_folds) > 1 else inner
        ridge = _RIDGES[0]
        if grams.shape[1] > 1 + free:
            scores = np.zeros(len(_RIDGES))
            for part in np.unique(parts[~held_out]):
                validation = ~held_out & (parts == part)
                fit_gram = grams[~held_out & ~validation].sum(0)
                validation_gram = grams[validation].sum(0)
                if fit_gram[0, 0] == 0.0:
                    continue
                scores += [_error(validation_gram, _ridge(fit_gram, r, free)) for r in _RIDGES]
            ridge = _RIDGES[int(scores.argmin())]
        slope = _ridge(grams[~held_out].sum(0), ridge, free)
        errors[held_out] = [_error(gram, slope) for gram in grams[held_out]]
    return errors


def _ridge(gram: np.ndarray, ridge: float, free: int) -> np.ndarray:
    """Return the coefficients (regressors,) of ridge regression.

    ridge: penalty as a share of the mean square of the columns. free: leading columns with a penalty of 1e-6.
    """
    A, b = gram[1:, 1:], gram[1:, 0]
    scale = float(np.trace(A)) / len(A)
    penalty = np.full(len(A), ridge * scale)
    penalty[:free] = 1e-6 * scale
    return np.linalg.solve(A + np.diag(penalty), b)


def _error(gram: np.ndarray, slope: np.ndarray) -> float:
    """Return the squared error of the coefficients `slope` (regressors,) on the data of a Gram."""
    return float(gram[0, 0] - 2.0 * gram[0, 1:] @ slope + slope @ gram[1:, 1:] @ slope)


def pieces_of(bins: Bins) -> Annotated[np.ndarray, "segments"]:
    """Return the bootstrap piece of each segment.

    A piece covers the same RUN_S of a reference in all of its flights.
    """
    first = np.flatnonzero(np.r_[True, np.diff(bins.segment) > 0])
    piece = np.floor(bins.t_s[first] / RUN_S).astype(int)
    _, number = np.unique(np.column_stack([bins.reference[first], piece]), axis=0, return_inverse=True)
    return number.reshape(-1)


def skill_of_group(
    channel: Channel,
    group: str,
    errors: Annotated[np.ndarray, "segments"],
    baseline: Annotated[np.ndarray, "segments"],
    bins: Bins,
    piece: Annotated[np.ndarray, "segments"],
) -> Skill:
    """Return the skill of a group, with a bootstrap interval.

    Parameters
    ----------
    channel, group
        Channel and group that the skill is of.
    errors, baseline
        Held-out squared errors of segments with the group, and without it.
    bins
        Bins of the segments.
    piece
        Bootstrap piece of each segment.
    """
    sums = np.column_stack([np.bincount(piece, errors), np.bincount(piece, baseline)])
    rng = np.random.default_rng(0)
    drawn = sums[rng.integers(len(sums), size=(_DRAWS, len(sums)))].sum(1)
    skills = 1.0 - drawn[:, 0] / np.maximum(drawn[:, 1], 1e-300)
    low, high = np.quantile(skills, [0.025, 0.975])
    skill = 1.0 - float(errors.sum()) / max(float(baseline.sum()), 1e-300)
    rms = float(np.sqrt(max(float(baseline.sum() - errors.sum()), 0.0) / len(bins.w)))
    return Skill(
        group=group,
        skill=skill,
        low=float(low),
        high=float(high),
        rms=rms,
        counts=bool(low > 0.0 and skill > RULES.min_skill and rms > FLOORS[channel]),
    )
