"""Adam with a cosine decay of its step (Kingma and Ba 2014, algorithm 1)."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-8


class Adam:
    """A minimiser over `x` by gradients; the step size goes from `rate` to `last` times `rate` in `steps`."""

    def __init__(
        self, x: Annotated[np.ndarray, "values"], *, rate: float, steps: int, last: float = 0.01
    ) -> None:
        if not (rate > 0.0 and steps > 0 and 0.0 < last <= 1.0):
            raise ValueError(f"need rate > 0, steps > 0, 0 < last <= 1, got {rate}, {steps}, {last}")
        self.x = np.array(x, dtype=float)
        self.rate, self.steps, self.last = rate, steps, last
        self._count = 0
        self._mean = np.zeros_like(self.x)
        self._square = np.zeros_like(self.x)

    def step(self, gradient: Annotated[np.ndarray, "values"]) -> None:
        """Move `x` by one step against the gradient."""
        phase = min(self._count / self.steps, 1.0)
        rate = self.rate * (self.last + (1.0 - self.last) * 0.5 * (1.0 + math.cos(math.pi * phase)))
        self._count += 1
        self._mean += (1.0 - _BETA1) * (gradient - self._mean)
        self._square += (1.0 - _BETA2) * (gradient * gradient - self._square)
        mean = self._mean / (1.0 - _BETA1**self._count)
        square = self._square / (1.0 - _BETA2**self._count)
        self.x -= rate * mean / (np.sqrt(square) + _EPSILON)
