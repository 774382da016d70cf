"""The vehicle's check of a reference with all samples in arrays: the law's equations, and its bits.

`trimtab.firmware_model.law.scan` and `smoothness` hold the equations. Sums and products of arrays have the
bits of floats; the elementary functions are those of the floats, value by value (`LIBM`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from trimtab.firmware_model.law.checks import Evaluator
from trimtab.firmware_model.law.scan import REASONS, Bounds, Part, curves, sample_us
from trimtab.firmware_model.law.smoothness import Neighbours, deviations
from trimtab.host.codegen.ops import LIBM


def _least_margins(parts: Sequence[Part], bounds: Bounds) -> tuple[dict[str, float], tuple[Part, int] | None]:
    """Return the least margins over all samples, and the first sample that violates a limit."""
    columns = _columns(parts)
    sizes = np.array([part.count + 1 for part in parts])
    part_of = np.repeat(np.arange(len(parts)), sizes)
    k = np.arange(len(part_of)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    samples = Part(*(column[..., part_of] for column in columns))
    margins = bounds.margins(LIBM, curves(samples), sample_us(samples, k))
    table = np.array([margin for _, margin, *_ in margins])
    least = dict.fromkeys(REASONS, np.inf)
    for (name, *_), lowest in zip(margins, table.min(axis=1).tolist(), strict=True):
        least[name] = min(least[name], lowest)
    violated = ~(table >= 0.0).all(axis=0)
    if not violated.any():
        return least, None
    first = int(violated.argmax())
    return least, (parts[part_of[first]], int(k[first]))


def _deviations(nodes: Sequence[Neighbours]) -> Iterable[Sequence[float]]:
    """Return the deviations of each node."""
    if not nodes:
        return []
    return np.array(deviations(LIBM, Neighbours(*_columns(nodes)))).T.tolist()


def _columns(rows: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Return the fields of the rows as arrays: (rows,) of a number, (numbers, rows) of a vector."""
    return [np.array(field, dtype=float).T for field in zip(*rows, strict=True)]


ALL_AT_ONCE = Evaluator(least_margins=_least_margins, deviations=_deviations)
