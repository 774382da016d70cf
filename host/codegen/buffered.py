"""A CasADi function on arrays that stay where they are: no copies, no objects made in a call."""

from __future__ import annotations

import casadi
import numpy as np


class Buffered:
    """A CasADi function on fixed arrays: write `inputs`, call, read `outputs`, all (columns, rows).

    A sparse input or output is one column of its nonzeros.
    """

    def __init__(self, function: casadi.Function) -> None:
        self.function = function
        # The function, its buffer and the arrays must outlive the trigger: it holds their addresses.
        self._buffer, self._trigger = function.buffer()
        self.inputs: dict[str, np.ndarray] = {}
        self.outputs: dict[str, np.ndarray] = {}
        for i in range(function.n_in()):
            array = _room(function.sparsity_in(i))
            self._buffer.set_arg(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.inputs[function.name_in(i)] = array
        for i in range(function.n_out()):
            array = _room(function.sparsity_out(i))
            self._buffer.set_res(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.outputs[function.name_out(i)] = array

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._trigger()


def _room(pattern: casadi.Sparsity) -> np.ndarray:
    shape = (pattern.size2(), pattern.size1()) if pattern.is_dense() else (1, pattern.nnz())
    return np.zeros(shape)
