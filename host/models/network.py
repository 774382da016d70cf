"""The learned residual: a small tanh network from [v_ned, Theta] to an acceleration (paper IV-A).

The acceleration is in the world, NED. The weights are one flat vector xi: layer by layer, the matrix row by
row, then its bias. The same network runs on scalars in `ops` style, as CasADi matrix products and on numpy
lanes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from firmware_model.law.ops import Ops

INPUTS = 6
OUTPUTS = 3


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The shape of a network: widths of the hidden layers between 6 inputs and 3 outputs."""

    hidden: tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.hidden or any(width < 1 for width in self.hidden):
            raise ValueError(f"hidden widths must be one or more positive numbers, got {self.hidden}")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Width of every layer, inputs and outputs included."""
        return (INPUTS, *self.hidden, OUTPUTS)

    @property
    def size(self) -> int:
        """Number of weights."""
        return sum((rows + 1) * columns for rows, columns in zip(self.sizes, self.sizes[1:], strict=False))

    def initial(self, rng: np.random.Generator) -> np.ndarray:
        """A flat start vector: normal over the square root of the fan-in, the last layer a tenth of it.

        Biases are 0. The small last layer starts the residual near zero, so that early roll-outs stay near
        the nominal model.
        """
        xi = np.zeros(self.size)
        last = len(self.sizes) - 2
        for index, (matrix, _, rows, columns) in enumerate(self._slices()):
            scale = (0.1 if index == last else 1.0) / math.sqrt(columns)
            xi[matrix] = scale * rng.standard_normal(rows * columns)
        return xi

    def scalars(self, ops: Ops, xi: Sequence[Any], inputs: Sequence[Any]) -> list[Any]:
        """The 3 outputs for 6 scalar inputs."""
        values = list(inputs)
        last = len(self.sizes) - 2
        for index, (matrix, bias, rows, columns) in enumerate(self._slices()):
            sums = []
            for row in range(rows):
                total = xi[bias.start + row]
                for column in range(columns):
                    total = total + xi[matrix.start + row * columns + column] * values[column]
                sums.append(total)
            values = sums if index == last else [ops.tanh(total) for total in sums]
        return values

    def matrices(self, xi: Any, inputs: Any) -> Any:
        """Outputs (3, n) for inputs (6, n) as CasADi matrix products; `xi` and `inputs` are MX or SX."""
        values = inputs
        last = len(self.sizes) - 2
        ones = casadi.DM.ones(1, inputs.shape[1])
        for index, (matrix, bias, rows, columns) in enumerate(self._slices()):
            weight = casadi.reshape(xi[matrix], columns, rows).T  # CasADi stores columns first
            values = casadi.mtimes(weight, values) + casadi.mtimes(xi[bias], ones)
            if index != last:
                values = casadi.tanh(values)
        return values

    def arrays(self, xi: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Outputs (3, n) for inputs (6, n) on numpy."""
        values = inputs
        last = len(self.sizes) - 2
        for index, (matrix, bias, rows, columns) in enumerate(self._slices()):
            values = xi[matrix].reshape(rows, columns) @ values + xi[bias, None]
            if index != last:
                values = np.tanh(values)
        return values

    def _slices(self) -> Iterator[tuple[slice, slice, int, int]]:
        """Layer by layer: where the matrix and the bias are in xi, rows, columns."""
        start = 0
        for columns, rows in zip(self.sizes, self.sizes[1:], strict=False):
            middle = start + rows * columns
            yield slice(start, middle), slice(middle, middle + rows), rows, columns
            start = middle + rows


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """A layout with its weights, (layout.size,) finite numbers; read-only."""

    layout: Layout
    xi: np.ndarray

    def __post_init__(self) -> None:
        xi = np.array(self.xi, dtype=float)
        if xi.shape != (self.layout.size,):
            raise ValueError(f"a network {self.layout.sizes} has {self.layout.size} weights, got {xi.shape}")
        if not np.isfinite(xi).all():
            raise ValueError("network weights must be finite")
        xi.setflags(write=False)
        object.__setattr__(self, "xi", xi)

    def acceleration_ned(self, v_ned: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """The residual acceleration (3, n), m/s^2 NED, for velocities and Euler angles (3, n)."""
        return self.layout.arrays(self.xi, np.concatenate([v_ned, theta]))
