"""A CasADi function on fixed arrays: a call copies nothing and creates no objects."""

from __future__ import annotations

import casadi
import numpy as np


class Buffered:
    """A CasADi function on fixed arrays: write `inputs`, call, read `outputs`, all (columns, rows).

    A sparse input or output is one column of its nonzeros.
    """

    def __init__(self, function: casadi.Function) -> None:
        self.function = function
        # The trigger holds the addresses of the function, its buffer and the arrays: keep them all.
        self._buffer, self._trigger = function.buffer()
        self.inputs: dict[str, np.ndarray] = {}
        self.outputs: dict[str, np.ndarray] = {}
        for i in range(function.n_in()):
            array = _zeros(function.sparsity_in(i))
            self._buffer.set_arg(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.inputs[function.name_in(i)] = array
        for i in range(function.n_out()):
            array = _zeros(function.sparsity_out(i))
            self._buffer.set_res(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.outputs[function.name_out(i)] = array

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._trigger()


def _zeros(pattern: casadi.Sparsity) -> np.ndarray:
    shape = (pattern.size2(), pattern.size1()) if pattern.is_dense() else (1, pattern.nnz())
    return np.zeros(shape)
