"""Patterns of sparse matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


def ranks(ascending: Annotated[Index, "entries"]) -> Annotated[Index, "entries"]:
    """Return the rank of each entry among those of the same value, from 0."""
    return np.arange(len(ascending)) - np.searchsorted(ascending, ascending)


class Pattern:
    """Entries of a sparse matrix, column by column.

    rows, columns: of each nonzero. starts: the first entry of each column, and the number of entries.
    """

    def __init__(
        self,
        parts: Sequence[tuple[Annotated[Index, "entries"], Annotated[Index, "entries"]]],
        height: int,
        width: int,
    ) -> None:
        self._shape = (height, width)
        keys = np.sort(np.concatenate([columns * height + rows for rows, columns in parts]), kind="stable")
        self._keys = keys[np.append(True, keys[1:] != keys[:-1])]
        self.count = len(self._keys)
        self.columns, self.rows = np.divmod(self._keys, height)
        self.starts = np.searchsorted(self.columns, np.arange(width + 1))

    def find(
        self, rows: Annotated[Index, "entries"], columns: Annotated[Index, "entries"]
    ) -> Annotated[Index, "entries"]:
        """Return the place of each entry among the nonzeros."""
        return np.searchsorted(self._keys, columns * self._shape[0] + rows)

    def sparsity(self) -> ca.Sparsity:
        """Return the pattern as CasADi's."""
        return ca.Sparsity(*self._shape, self.starts.tolist(), self.rows.tolist())
